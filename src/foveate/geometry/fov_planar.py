"""Fields of view in the plane: convex polygons and annular sectors."""

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from foveate.geometry.fov import Extent, FieldOfView, Number, arc, closed
from foveate.geometry.safe import clipped, larger, length
from foveate.io.validate import require
from foveate.types import Scalar


def height_and_overshoot(
    point: Float[Array, "... 2"],
    start: Float[Array, "... 2"],
    end: Float[Array, "... 2"],
    tangent: Float[Array, "... 2"],
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Height of a point to the right of a segment's line, and the distance of its foot beyond the ends, else 0 [m].

    Both are measured from the nearer end: near a sharp corner, whose sides are almost equal, their rounding errors are
    in proportion to their own size, not to the segment's.
    """
    t_x, t_y = tangent[..., 0], tangent[..., 1]
    from_start, from_end = point - start, point - end
    along = t_x * from_start[..., 0] + t_y * from_start[..., 1]
    past = t_x * from_end[..., 0] + t_y * from_end[..., 1]
    nearer = jnp.where((along + past > 0)[..., None], from_end, from_start)
    height = t_y * nearer[..., 0] - t_x * nearer[..., 1]
    return height, jnp.where(along < 0, along, jnp.where(past > 0, past, 0.0))


class ConvexPolygon(FieldOfView):
    """A convex polygon of the plane: vertices [m] counter-clockwise, none repeated."""

    vertices: Float[Array, "v 2"]

    @property
    def depth(self) -> Scalar:
        """Distance of the farthest vertex from the origin [m]."""
        return jnp.sqrt(jnp.max(jnp.sum(self.vertices**2, axis=-1)))

    @property
    def extent(self) -> Extent:
        """Where the axis ahead leaves the polygon, and the largest bearing of a vertex; pi about an agent inside."""
        start, end = self.vertices, jnp.roll(self.vertices, -1, axis=0)
        rise = end[:, 1] - start[:, 1]
        crosses = (jnp.minimum(start[:, 1], end[:, 1]) <= 0) & (jnp.maximum(start[:, 1], end[:, 1]) >= 0) & (rise != 0)
        at = start[:, 0] - start[:, 1] * (end[:, 0] - start[:, 0]) / jnp.where(rise == 0, 1.0, rise)
        ahead = jnp.max(jnp.where(crosses, at, 0.0), initial=0.0)
        # The rounding of an apex at the agent is not a view to all sides.
        encloses = self.signed_distance(jnp.zeros_like(self.vertices[0])) < -1e-4 * self.depth
        near = jnp.sum(self.vertices**2, axis=-1) <= (1e-4 * self.depth) ** 2
        bearing = jnp.where(near, 0.0, jnp.abs(jnp.arctan2(self.vertices[:, 1], self.vertices[:, 0])))
        return Extent(ahead, jnp.where(encloses, jnp.pi, jnp.max(bearing)), jnp.asarray(jnp.pi))

    def signed_distance(self, point_body: Float[Array, "... 2"]) -> Float[Array, "..."]:
        """Distance to the nearest edge, negative where the point is left of all edges [m].

        d = +-sqrt(h^2 + e^2), h the height over the nearest edge's line, e the distance of the point's foot beyond the
        edge's ends. The choice of the edge has no derivative: only the nearest edge is differentiated. Beside a sharp
        corner both of its sides may be nearest, up to rounding: the one that the point is right of counts.
        """
        ends, tangents = self._edges
        still = jax.lax.stop_gradient(point_body)[..., None, :]
        heights, beyond = height_and_overshoot(still, self.vertices, ends, tangents)
        square = heights**2 + beyond**2
        tied = square <= (1 + 16 * jnp.finfo(square.dtype).eps) * jnp.min(square, axis=-1, keepdims=True)
        nearest = jnp.argmax(jnp.where(tied, heights, -jnp.inf), axis=-1)
        inside = jnp.all(heights <= 0, axis=-1)

        height, overshoot = height_and_overshoot(point_body, self.vertices[nearest], ends[nearest], tangents[nearest])
        corner = length(height, overshoot)
        return jnp.where(overshoot == 0, height, jnp.where(inside, -corner, corner))

    def contains(self, point_body: Float[Array, "... 2"]) -> Bool[Array, "..."]:
        """True where the point [m] is left of all edges, or on them."""
        ends, tangents = self._edges
        heights, _ = height_and_overshoot(point_body[..., None, :], self.vertices, ends, tangents)
        return jnp.all(heights <= 0, axis=-1)

    @property
    def _edges(self) -> tuple[Float[Array, "v 2"], Float[Array, "v 2"]]:
        """Ends of the edges that begin at the vertices [m], and their unit vectors."""
        ends = jnp.roll(self.vertices, -1, axis=0)
        edges = ends - self.vertices
        return ends, edges / jnp.sqrt(jnp.sum(edges**2, axis=-1, keepdims=True))

    def outline(self, reach: float = 10.0) -> np.ndarray:
        """The vertices and the first again, (v + 1, 2) [m]."""
        return closed(np.asarray(self.vertices))


def triangle_vertices(depth: Scalar | Number, angle: Scalar | Number) -> Float[Array, "3 2"]:
    """Vertices (0, 0), (depth, -+depth tan(angle / 2)) [m], counter-clockwise; unchecked, may be traced."""
    depth = jnp.asarray(depth, float)
    half_width = depth * jnp.tan(jnp.asarray(angle, float) / 2)
    ahead = jnp.stack([jnp.zeros_like(depth), depth, depth])
    return jnp.stack([ahead, jnp.stack([jnp.zeros_like(depth), -half_width, half_width])], axis=-1)


def triangle(depth: Number, angle: Number) -> ConvexPolygon:
    """The paper's field of view: apex at the agent, full `angle` in (0, pi) [rad] about +x, far edge at `depth` [m]."""
    require(0 < depth < math.inf, "depth", depth, "expected a finite number > 0 [m]")
    require(0 < angle < math.pi, "angle", angle, "expected a number in (0, pi) [rad]")
    return ConvexPolygon(triangle_vertices(depth, angle))


def polygon(vertices: np.ndarray | Sequence[Sequence[Number]]) -> ConvexPolygon:
    """The convex polygon through `vertices` (v, 2) [m], listed in order around it, in either sense.

    Convex up to 1e-6 rad: no turns of both signs, and one turn in all.
    """
    points = np.asarray(vertices, jnp.result_type(float)).astype(float)  # rounded as it will be stored
    ok = points.ndim == 2 and points.shape[0] >= 3 and points.shape[1] == 2
    require(ok, "shape of vertices", points.shape, "expected (v, 2) with v >= 3")
    given = points.tolist()
    require(np.isfinite(points).all(), "vertices", given, "expected finite numbers [m]")
    edges = np.roll(points, -1, axis=0) - points
    require(edges.any(axis=-1).all(), "vertices", given, "expected no vertex repeated")
    centred = points - points.mean(axis=0)
    area = np.sum(centred[:, 0] * edges[:, 1] - centred[:, 1] * edges[:, 0]) / 2
    require(abs(area) > 1e-9 * np.max(np.ptp(points, axis=0)) ** 2, "vertices", given, "expected a non-zero area")
    following = np.roll(edges, -1, axis=0)
    cross = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    turns = np.sign(area) * np.arctan2(cross, np.sum(edges * following, axis=-1))
    convex = np.all(turns > -1e-6) and abs(np.sum(turns) - 2 * math.pi) < 1
    require(convex, "vertices", given, "expected the corners of a convex polygon, in order around it")
    return ConvexPolygon(jnp.asarray(points if area > 0 else points[::-1], float))


def annular_sector_distance(
    ahead: Float[Array, "..."], aside: Float[Array, "..."], near: Scalar, far: Scalar, half_angle: Scalar
) -> Float[Array, "..."]:
    """Signed distance [m] of (ahead, aside >= 0) to {near <= r <= far, |bearing| <= half_angle}.

    Within the angle the nearest boundary is a circle (along the ray through the point) or a straight side; beyond the
    angle it is the straight side that is, by reflection in the axis, on the point's own side.
    """
    full = half_angle >= math.pi
    u_x, u_y = jnp.cos(half_angle), jnp.sin(half_angle)
    height, along = u_x * aside - u_y * ahead, u_x * ahead + u_y * aside
    beyond = along - clipped(along, near, far)
    corner = length(height, beyond)
    side = jnp.where(beyond == 0, height, jnp.where(height > 0, corner, -corner))
    side = jnp.where(full, -jnp.inf, side)
    radius = length(ahead, aside)
    radial = larger(radius - far, jnp.where(near > 0, near - radius, -jnp.inf))
    return jnp.where(side > 0, side, larger(radial, side))


def annular_sector_outline(near: float, far: float, half_angle: float) -> np.ndarray:
    """Closed boundary (M, 2) [m] of an annular sector; a cut joins a full ring to its hole, a full disc is a circle."""
    unit = arc(-half_angle, half_angle)
    inner = near * unit[::-1] if near > 0 else np.zeros((int(half_angle < math.pi), 2))
    return closed(np.concatenate([far * unit, inner]))


class Sector(FieldOfView):
    """A circular sector about +x with its apex at the origin: near <= r <= radius [m], full angle [rad]."""

    radius: Scalar
    angle: Scalar
    near: Scalar

    @property
    def depth(self) -> Scalar:
        """`radius` [m]."""
        return self.radius

    @property
    def extent(self) -> Extent:
        """`radius`, and half the angle."""
        return Extent(self.radius, self.angle / 2, jnp.asarray(jnp.pi))

    def signed_distance(self, point_body: Float[Array, "... 2"]) -> Float[Array, "..."]:
        """Distance to the sector, folded onto its axis of symmetry [m]."""
        x, y = point_body[..., 0], jnp.abs(point_body[..., 1])
        return annular_sector_distance(x, y, self.near, self.radius, self.angle / 2)

    def contains(self, point_body: Float[Array, "... 2"]) -> Bool[Array, "..."]:
        """True where range and bearing of the point [m] are within theirs."""
        x, y = point_body[..., 0], jnp.abs(point_body[..., 1])
        square, half_angle = x**2 + y**2, self.angle / 2
        beside = (jnp.cos(half_angle) * y <= jnp.sin(half_angle) * x) | (half_angle >= math.pi)
        return beside & (square <= self.radius**2) & (square >= self.near**2)

    def outline(self, reach: float = 10.0) -> np.ndarray:
        """The closed boundary (M, 2) [m]."""
        return annular_sector_outline(float(self.near), float(self.radius), float(self.angle) / 2)


def sector(radius: Number, angle: Number, near: Number = 0.0) -> Sector:
    """The sector about +x (at 2 pi the full disc or ring) between the ranges `near` >= 0 and `radius` [m]."""
    require(0 < radius < math.inf, "radius", radius, "expected a finite number > 0 [m]")
    require(0 < angle <= 2 * math.pi, "angle", angle, "expected a number in (0, 2 pi] [rad]")
    require(0 <= near < radius, "near", near, f"expected a number in [0, radius = {radius}) [m]")
    return Sector(*(jnp.asarray(value, float) for value in (radius, angle, near)))
