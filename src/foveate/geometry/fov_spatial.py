"""Fields of view of space (range-limited cone, camera frustum, prism), and intersections of any shapes."""

import math
from functools import reduce

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from foveate.geometry.fov import Extent, FieldOfView, Number, arc, closed
from foveate.geometry.fov_planar import annular_sector_distance, annular_sector_outline
from foveate.geometry.safe import larger, length
from foveate.io.validate import require
from foveate.types import Scalar


class Cone(FieldOfView):
    """A cone about +x of full `angle` [rad], of slant range near <= |p| <= far [m]: spherical caps."""

    near: Scalar
    far: Scalar
    angle: Scalar

    _dimension = 3

    @property
    def depth(self) -> Scalar:
        """`far` [m]."""
        return self.far

    @property
    def extent(self) -> Extent:
        """`far`, and half the angle all round."""
        return Extent(self.far, self.angle / 2, self.angle / 2)

    def signed_distance(self, point_body: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Distance [m] to the annular sector in the half-plane (x, rho) through the point: a solid of revolution."""
        rho = length(point_body[..., 1], point_body[..., 2])
        return annular_sector_distance(point_body[..., 0], rho, self.near, self.far, self.angle / 2)

    def outline(self, reach: float = 10.0) -> list[np.ndarray]:
        """The section in the planes z = 0 and y = 0, and the rims."""
        near, far, half = float(self.near), float(self.far), float(self.angle) / 2
        section = annular_sector_outline(near, far, half)
        rim = np.insert(math.sin(half) * arc(0.0, 2 * math.pi), 0, math.cos(half), axis=1)
        rims = [radius * rim for radius in (near, far) if radius > 0 and half < math.pi]
        return [np.insert(section, 2, 0.0, axis=1), np.insert(section, 1, 0.0, axis=1), *rims]


def cone(near: Number, far: Number, angle: Number) -> Cone:
    """The cone about +x (at 2 pi the full ball or shell) between the slant ranges `near` >= 0 and `far` [m]."""
    _check_ranges(near, far)
    require(0 < angle <= 2 * math.pi, "angle", angle, "expected a number in (0, 2 pi] [rad]")
    return Cone(*(jnp.asarray(value, float) for value in (near, far, angle)))


def _check_ranges(near: Number, far: Number) -> None:
    require(0 < far < math.inf, "far", far, "expected a finite number > 0 [m]")
    require(0 <= near < far, "near", near, f"expected a number in [0, far = {far}) [m]")


class Frustum(FieldOfView):
    """View of a camera along +x between the planes x = near and x = far [m].

    |y| <= x tan(width_angle / 2) and |z| <= x tan(height_angle / 2), full angles [rad].
    """

    near: Scalar
    far: Scalar
    width_angle: Scalar
    height_angle: Scalar

    _dimension = 3

    @property
    def depth(self) -> Scalar:
        """Distance of the far corners from the origin [m]."""
        wide, high = jnp.tan(self.width_angle / 2), jnp.tan(self.height_angle / 2)
        return self.far * jnp.sqrt(1 + wide**2 + high**2)

    @property
    def extent(self) -> Extent:
        """`far`, and half the angles."""
        return Extent(self.far, self.width_angle / 2, self.height_angle / 2)

    def signed_distance(self, point_body: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Inside and before a face the largest height over a face, else the distance to the nearest edge [m].

        Folded to y, z >= 0, the nearest point of the wedge between the two sides comes first: the point itself, its
        foot on a side or on the edge between them. The squared distance to the wedge's cross-section at s is convex in
        s, so that the frustum's nearest point is at that section, clipped to near and far. The choice of face or edge
        has no derivative; each distance is written in coordinates across it, so that its gradient has norm 1 at any
        distance.
        """
        x, y, z = point_body[..., 0], jnp.abs(point_body[..., 1]), jnp.abs(point_body[..., 2])
        half_width, half_height = self.width_angle / 2, self.height_angle / 2
        a, b = jnp.tan(half_width), jnp.tan(half_height)
        cos, sin, sin_up = jnp.cos(half_width), jnp.sin(half_width), jnp.sin(half_height)
        beside, above = cos * y - sin * x, jnp.cos(half_height) * z - sin_up * x
        height = larger(larger(self.near - x, x - self.far), larger(beside, above))

        overlap = sin * sin_up  # of the two sides' normals
        by_edge = (beside > overlap * above) & (above > overlap * beside)
        ahead = jnp.maximum(jnp.where(beside > above, sin * beside, sin_up * above), 0.0)
        section = jnp.where(by_edge, (x + a * y + b * z) / (1 + a**2 + b**2), x + ahead)
        at_end = (section < self.near) | (section > self.far)
        end = jnp.where(section < self.near, self.near, self.far)
        over_y, over_z = jnp.where(y > a * end, y - a * end, 0.0), jnp.where(z > b * end, z - b * end, 0.0)
        # A slanted edge runs along (1, a, b); `beside` and `across` are coordinates orthogonal to it and each other.
        across = (z / cos - b * cos * (x + a * y)) / jnp.sqrt(1 + a**2 + b**2)
        edge = jnp.where(at_end, length(x - end, over_y, over_z), length(beside, across))
        return jnp.where(jnp.where(at_end, (over_y > 0) | (over_z > 0), by_edge), edge, height)

    def contains(self, point_body: Float[Array, "... 3"]) -> Bool[Array, "..."]:
        """True where no coordinate of the point [m] is beyond a face."""
        x, y, z = point_body[..., 0], jnp.abs(point_body[..., 1]), jnp.abs(point_body[..., 2])
        half_width, half_height = self.width_angle / 2, self.height_angle / 2
        beside = jnp.cos(half_width) * y <= jnp.sin(half_width) * x
        above = jnp.cos(half_height) * z <= jnp.sin(half_height) * x
        return beside & above & (x >= self.near) & (x <= self.far)

    def outline(self, reach: float = 10.0) -> list[np.ndarray]:
        """The near and far rectangles and the four slanted edges."""
        wide, high = math.tan(float(self.width_angle) / 2), math.tan(float(self.height_angle) / 2)
        corners = np.array([[1, -wide, -high], [1, wide, -high], [1, wide, high], [1, -wide, high]])
        near, far = float(self.near) * corners, float(self.far) * corners
        return [closed(near), closed(far), *np.stack([near, far], axis=1)]


def frustum(near: Number, far: Number, width_angle: Number, height_angle: Number) -> Frustum:
    """The camera's view between the planes x = near >= 0 and x = far [m], full angles in (0, pi) [rad]."""
    _check_ranges(near, far)
    require(0 < width_angle < math.pi, "width_angle", width_angle, "expected a number in (0, pi) [rad]")
    require(0 < height_angle < math.pi, "height_angle", height_angle, "expected a number in (0, pi) [rad]")
    return Frustum(*(jnp.asarray(value, float) for value in (near, far, width_angle, height_angle)))


class Prism(FieldOfView):
    """A planar shape, unbounded along z: a planar agent's view in space."""

    base: FieldOfView

    _dimension = 3

    @property
    def extent(self) -> Extent:
        """That of the base."""
        return self.base.extent

    def signed_distance(self, point_body: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Distance of the point's foot in the plane to the base [m]."""
        return self.base.signed_distance(point_body[..., :2])

    def contains(self, point_body: Float[Array, "... 3"]) -> Bool[Array, "..."]:
        """True where the point's foot in the plane [m] lies in the base."""
        return self.base.contains(point_body[..., :2])

    def outline(self, reach: float = 10.0) -> list[np.ndarray]:
        """The base's outline at z = -+reach, and up to 8 uprights."""
        line = np.asarray(self.base.outline(reach))
        ends = np.stack([np.insert(line, 2, height, axis=1) for height in (-reach, reach)])
        return [*ends, *np.swapaxes(ends, 0, 1)[: -1 : math.ceil((len(line) - 1) / 8)]]


def prism(base: FieldOfView) -> Prism:
    """The prism over a planar shape."""
    require(base.dimension == 2, "dimension of the prism's base", base.dimension, "expected 2")
    return Prism(base)


class Intersection(FieldOfView):
    """Intersection of several shapes of one dimension."""

    shapes: tuple[FieldOfView, ...]

    @property
    def dimension(self) -> int:
        """Dimension of the members."""
        return self.shapes[0].dimension

    @property
    def depth(self) -> Scalar:
        """An upper bound of the depth: the least of the members'."""
        return jnp.min(jnp.stack([shape.depth for shape in self.shapes]))

    @property
    def extent(self) -> Extent:
        """An upper bound: the least of the members'."""
        return Extent(
            *(reduce(jnp.minimum, sizes) for sizes in zip(*(shape.extent for shape in self.shapes), strict=True))
        )

    def signed_distance(self, point_body: Float[Array, "... d"]) -> Float[Array, "..."]:
        """The largest of the members' signed distances [m]: exact inside, a lower bound outside.

        The complement of an intersection is the union of complements, and the distance to a union is the least of the
        distances; outside, each member's distance is at most that to the smaller intersection.
        """
        return reduce(larger, [shape.signed_distance(point_body) for shape in self.shapes])

    def contains(self, point_body: Float[Array, "... d"]) -> Bool[Array, "..."]:
        """True where the point [m] lies in every member."""
        return reduce(jnp.logical_and, [shape.contains(point_body) for shape in self.shapes])

    def outline(self, reach: float = 10.0) -> np.ndarray | list[np.ndarray]:
        """The parts of the members' outlines within all the others; in the plane for convex members only."""
        depth = float(self.depth)
        reach = 1.01 * depth if math.isfinite(depth) else reach
        lines = []
        for shape in self.shapes:
            outline = shape.outline(reach)
            for line in outline if isinstance(outline, list) else [outline]:
                fine = np.linspace(line[:-1], line[1:], max(2, 2000 // len(line)), axis=1)
                lines.append(fine.reshape(-1, self.dimension))
        inside = np.asarray(eqx.filter_jit(self.signed_distance)(jnp.asarray(np.concatenate(lines)))) <= 1e-5 * reach
        pieces = []
        for line, kept in zip(lines, np.split(inside, np.cumsum([len(line) for line in lines])[:-1]), strict=True):
            runs = np.split(np.arange(len(line)), np.flatnonzero(np.diff(kept)) + 1)
            pieces += [line[run] for run in runs if kept[run[0]]]
        if self.dimension == 3:
            return pieces
        points = np.concatenate([np.zeros((0, 2)), *pieces])
        from_middle = points - np.sum(points, axis=0) / max(1, len(points))
        return closed(points[np.argsort(np.arctan2(from_middle[:, 1], from_middle[:, 0]))])


def intersection(*shapes: FieldOfView) -> Intersection:
    """Intersection of at least one shape, all of one dimension."""
    dimensions, equal = [shape.dimension for shape in shapes], "expected equal ones, of at least one shape"
    require(len(set(dimensions)) == 1, "dimensions of the shapes", dimensions, equal)
    return Intersection(shapes)
