"""Fields of view of space (range-limited cone, camera frustum, upright prism), and what several shapes share."""

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foveate.geometry.fov import (
    FieldOfView,
    Number,
    annular_sector_distance,
    annular_sector_outline,
    arc,
    closed,
    require,
    safe_sqrt,
)
from foveate.types import Scalar


class Cone(FieldOfView):
    """A cone about +x of full `angle` [rad], of slant range near <= |p| <= far [m]: spherical caps."""

    near: Scalar
    far: Scalar
    angle: Scalar

    @property
    def dimension(self) -> int:
        return 3

    @property
    def depth(self) -> Scalar:
        return self.far

    def signed_distance(self, point_body: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """That of the annular sector in the half-plane (x, rho) through the point: a solid of revolution."""
        rho = safe_sqrt(point_body[..., 1] ** 2 + point_body[..., 2] ** 2)
        return annular_sector_distance(point_body[..., 0], rho, self.near, self.far, self.angle / 2)

    def outline(self, reach: float = 10.0) -> list[np.ndarray]:
        """The section in the planes z = 0 and y = 0, and the rims."""
        near, far, half = float(self.near), float(self.far), float(self.angle) / 2
        section = annular_sector_outline(near, far, half)
        rim = np.insert(math.sin(half) * arc(0.0, 2 * math.pi), 0, math.cos(half), axis=1)
        rims = [radius * rim for radius in (near, far) if radius > 0 and half < math.pi]
        return [np.insert(section, 2, 0.0, axis=1), np.insert(section, 1, 0.0, axis=1), *rims]


def cone(near: Number, far: Number, angle: Number) -> Cone:
    """The cone of full angle (0, 2 pi] [rad] about +x between the slant ranges near >= 0 and far [m].

    At 2 pi it is the full ball or shell. Raises ValueError where a parameter is out of range.
    """
    require(0 < far < math.inf, "far", far, "a finite number > 0 [m]")
    require(0 <= near < far, "near", near, f"in [0, far = {far}) [m]")
    require(0 < angle <= 2 * math.pi, "angle", angle, "in (0, 2 pi] [rad]")
    return Cone(*(jnp.asarray(value, float) for value in (near, far, angle)))


class Frustum(FieldOfView):
    """What a camera looking along +x sees between the planes x = near and x = far [m].

    |y| <= x tan(width_angle / 2) and |z| <= x tan(height_angle / 2), full angles [rad].
    """

    near: Scalar
    far: Scalar
    width_angle: Scalar
    height_angle: Scalar

    @property
    def dimension(self) -> int:
        return 3

    @property
    def depth(self) -> Scalar:
        wide, high = jnp.tan(self.width_angle / 2), jnp.tan(self.height_angle / 2)
        return self.far * jnp.sqrt(1 + wide**2 + high**2)

    def signed_distance(self, point_body: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Inside the largest height over a face, outside the distance to the nearest point [m].

        Folded to y, z >= 0, the squared distance to the cross-section at x = s is (x - s)^2 + (y - a s)_+^2 +
        (z - b s)_+^2: convex, C^1 and piecewise quadratic in s, so that its minimum over near <= s <= far is
        the clipped minimiser of one of four quadratics, by which of the two side planes hold with equality.
        """
        x, y, z = point_body[..., 0], jnp.abs(point_body[..., 1]), jnp.abs(point_body[..., 2])
        near, far = self.near, self.far
        a, b = jnp.tan(self.width_angle / 2), jnp.tan(self.height_angle / 2)
        beside, to_side = _side_plane(x, y, near, far, self.width_angle / 2)
        above, to_top = _side_plane(x, z, near, far, self.height_angle / 2)

        s = jnp.clip(x, near, far)
        square = (x - s) ** 2 + _positive(y - a * s) ** 2 + _positive(z - b * s) ** 2
        s, residual = to_side
        square = jnp.minimum(square, residual + _positive(z - b * s) ** 2)
        s, residual = to_top
        square = jnp.minimum(square, residual + _positive(y - a * s) ** 2)
        s = jnp.clip((x + a * y + b * z) / (1 + a**2 + b**2), near, far)
        square = jnp.minimum(square, (x - s) ** 2 + (y - a * s) ** 2 + (z - b * s) ** 2)

        height = jnp.maximum(jnp.maximum(near - x, x - far), jnp.maximum(beside, above))
        return jnp.where(height > 0, safe_sqrt(square), height)

    def outline(self, reach: float = 10.0) -> list[np.ndarray]:
        """The near and far rectangles and the four slanted edges."""
        wide, high = math.tan(float(self.width_angle) / 2), math.tan(float(self.height_angle) / 2)
        corners = np.array([[1, -wide, -high], [1, wide, -high], [1, wide, high], [1, -wide, high]])
        near, far = float(self.near) * corners, float(self.far) * corners
        return [closed(near), closed(far), *np.stack([near, far], axis=1)]


def _positive(value: Float[Array, "..."]) -> Float[Array, "..."]:
    return jnp.maximum(value, 0.0)


def _side_plane(
    x: Float[Array, "..."], y: Float[Array, "..."], near: Scalar, far: Scalar, half_angle: Scalar
) -> tuple[Float[Array, "..."], tuple[Float[Array, "..."], Float[Array, "..."]]]:
    """In the plane (x, y): height over the line y = x tan(half_angle) [m], and its part between near and far.

    Of that part, the x of the point nearest to (x, y) [m] and the squared distance [m^2].
    """
    cos, sin = jnp.cos(half_angle), jnp.sin(half_angle)
    height, along = cos * y - sin * x, cos * x + sin * y
    foot = jnp.clip(along, near / cos, far / cos)
    return height, (cos * foot, height**2 + (along - foot) ** 2)


def frustum(near: Number, far: Number, width_angle: Number, height_angle: Number) -> Frustum:
    """The camera's view between the planes x = near >= 0 and x = far [m], full angles in (0, pi) [rad].

    Raises ValueError where a parameter is out of range.
    """
    require(0 < far < math.inf, "far", far, "a finite number > 0 [m]")
    require(0 <= near < far, "near", near, f"in [0, far = {far}) [m]")
    require(0 < width_angle < math.pi, "width_angle", width_angle, "in (0, pi) [rad]")
    require(0 < height_angle < math.pi, "height_angle", height_angle, "in (0, pi) [rad]")
    return Frustum(*(jnp.asarray(value, float) for value in (near, far, width_angle, height_angle)))


class Prism(FieldOfView):
    """A shape of the plane, extended without end along z: a planar agent's view, in space."""

    base: FieldOfView

    @property
    def dimension(self) -> int:
        return 3

    @property
    def depth(self) -> Scalar:
        return jnp.full_like(self.base.depth, jnp.inf)

    def signed_distance(self, point_body: Float[Array, "... 3"]) -> Float[Array, "..."]:
        return self.base.signed_distance(point_body[..., :2])

    def outline(self, reach: float = 10.0) -> list[np.ndarray]:
        """The base's outline at z = -+reach, and up to 8 uprights."""
        line = np.asarray(self.base.outline(reach))
        ends = np.stack([np.insert(line, 2, height, axis=1) for height in (-reach, reach)])
        return [*ends, *np.swapaxes(ends, 0, 1)[: -1 : math.ceil((len(line) - 1) / 8)]]


def prism(base: FieldOfView) -> Prism:
    """The prism over a shape of the plane; ValueError for one of space."""
    require(base.dimension == 2, "dimension of the prism's base", base.dimension, "2")
    return Prism(base)


class Intersection(FieldOfView):
    """What all of several shapes see."""

    shapes: tuple[FieldOfView, ...]

    @property
    def dimension(self) -> int:
        return self.shapes[0].dimension

    @property
    def depth(self) -> Scalar:
        """An upper bound of the depth: the least of the members'."""
        return jnp.min(jnp.stack([shape.depth for shape in self.shapes]))

    def signed_distance(self, point_body: Float[Array, "... d"]) -> Float[Array, "..."]:
        """The largest of the members' signed distances [m]: exact inside, outside a lower bound.

        The complement of an intersection is the union of complements, and the distance to a union is the
        least of the distances; outside, each member's distance is at most that to the smaller intersection.
        """
        return jnp.max(jnp.stack([shape.signed_distance(point_body) for shape in self.shapes]), axis=0)

    def outline(self, reach: float = 10.0) -> np.ndarray | list[np.ndarray]:
        """The parts of the members' outlines within all the others; in the plane for convex members only."""
        depth = float(self.depth)
        reach = 1.01 * depth if math.isfinite(depth) else reach
        pieces = []
        for shape in self.shapes:
            lines = shape.outline(reach)
            for line in lines if isinstance(lines, list) else [lines]:
                fine = np.linspace(line[:-1], line[1:], max(2, 2000 // len(line)), axis=1)
                fine = fine.reshape(-1, self.dimension)
                seen = np.asarray(self.signed_distance(jnp.asarray(fine))) <= 1e-5 * reach
                runs = np.split(np.arange(len(fine)), np.flatnonzero(np.diff(seen)) + 1)
                pieces += [fine[run] for run in runs if seen[run[0]]]
        if self.dimension == 3 or not pieces:
            return pieces
        points = np.concatenate(pieces)
        from_middle = points - points.mean(axis=0)
        return closed(points[np.argsort(np.arctan2(from_middle[:, 1], from_middle[:, 0]))])


def intersection(*shapes: FieldOfView) -> Intersection:
    """What all `shapes` see; ValueError for none, or for members of different dimensions."""
    dimensions = [shape.dimension for shape in shapes]
    require(len(set(dimensions)) == 1, "dimensions of the shapes", dimensions, "equal, of at least one shape")
    return Intersection(shapes)
