"""Fields of view: regions of the body frame with an exact signed distance; half-spaces and balls.

More shapes are in `fov_planar` and `fov_spatial`. The lower-case function of a shape's name makes it from plain
numbers, and raises InputError where one is out of range. The classes check nothing, so that their parameters may be
traced: `jax.vmap(lambda d, a: ConvexPolygon(triangle_vertices(d, a)))`. Products of coordinates are summed elementwise,
never by matmul, which accelerators round to fewer bits.
"""

import abc
import math
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from foveate.geometry.safe import length
from foveate.io.validate import require
from foveate.types import Point, Scalar

Number = float | int


class Extent(NamedTuple):
    """Size of a field of view about the axis ahead: how far [m], and how far to either side and up and down [rad].

    A law that turns until a target is in view needs no more. `half_height_rad` is pi in the plane.
    """

    ahead_m: Scalar
    half_width_rad: Scalar
    half_height_rad: Scalar


class FieldOfView(eqx.Module):
    """A closed region F of the body frame (x ahead, y to the left, z up), lengths in metres."""

    _dimension: ClassVar[int] = 2

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return self._dimension

    @property
    def depth(self) -> Scalar:
        """Largest distance from the origin of the body frame to a point of F [m], inf if F is unbounded."""
        return jnp.asarray(jnp.inf)  # weakly typed: takes the dtype of its context

    @property
    @abc.abstractmethod
    def extent(self) -> Extent:
        """How far F reaches along the axis ahead, and to its sides; inf and pi where it is unbounded."""

    @abc.abstractmethod
    def signed_distance(self, point_body: Float[Array, "... d"]) -> Float[Array, "..."]:
        """Euclidean distance to the boundary of F [m], < 0 inside, > 0 outside.

        Its gradient has norm 1 almost everywhere, and is finite where it is not unique.
        """

    @abc.abstractmethod
    def outline(self, reach: float = 10.0) -> np.ndarray | list[np.ndarray]:
        """Lines to draw [m]: one closed (M, 2) polyline in the plane, a list of (M, 3) polylines in space.

        An unbounded shape is drawn up to `reach` [m] from the origin.
        """

    def contains(self, point_body: Float[Array, "... d"]) -> Bool[Array, "..."]:
        """True where the point [m] lies in F, boundary included.

        Shapes for which that is less work than the distance say so: simulations and filters ask it most.
        """
        return self.signed_distance(point_body) <= 0


def arc(start: float, stop: float, count: int = 65) -> np.ndarray:
    """Points (count, 2) of the unit circle between two angles [rad]."""
    angle = np.linspace(start, stop, count)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def closed(points: np.ndarray) -> np.ndarray:
    """The polyline (M + 1, d) through `points` (M, d) and back to the first."""
    return np.concatenate([points, points[:1]])


class HalfSpace(FieldOfView):
    """All p with normal . p <= offset [m], `normal` a unit vector, in the plane or in space."""

    normal: Point
    offset: Scalar

    @property
    def dimension(self) -> int:
        """2 or 3, the length of the normal."""
        return self.normal.shape[-1]

    @property
    def extent(self) -> Extent:
        """As far as the plane, if it is ahead; in every direction."""
        ahead = self.normal[0] > 0
        far = jnp.where(ahead, self.offset / jnp.where(ahead, self.normal[0], 1.0), jnp.inf)
        return Extent(far, jnp.asarray(jnp.pi), jnp.asarray(jnp.pi))

    def signed_distance(self, point_body: Float[Array, "... d"]) -> Float[Array, "..."]:
        """normal . p - offset [m]."""
        return jnp.sum(self.normal * point_body, axis=-1) - self.offset

    def outline(self, reach: float = 10.0) -> np.ndarray | list[np.ndarray]:
        """A rectangle cut off at least `reach` from the origin; in space a square of its plane."""
        normal, offset = np.asarray(self.normal), float(self.offset)
        across = np.linalg.svd(normal[None])[2][1:] * reach
        if self.dimension == 2:
            top, bottom = normal * offset, normal * min(-reach, offset - reach)
            return closed(np.stack([top - across[0], top + across[0], bottom + across[0], bottom - across[0]]))
        signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        return [closed(normal * offset + signs @ across)]


def half_space(normal: np.ndarray | Sequence[Number], offset: Number) -> HalfSpace:
    """The half-space behind the plane at signed distance `offset` [m] along `normal`, of any length > 0."""
    direction = np.asarray(normal, float)
    ok = direction.shape in {(2,), (3,)} and np.isfinite(direction).all() and direction.any()
    require(ok, "normal", direction.tolist(), "expected 2 or 3 finite numbers, not all 0")
    require(math.isfinite(offset), "offset", offset, "expected a finite number [m]")
    return HalfSpace(jnp.asarray(direction / np.linalg.norm(direction), float), jnp.asarray(offset, float))


class Ball(FieldOfView):
    """A disc or ball of `radius` [m] about `center` [m]: the view of an omnidirectional sensor of limited range."""

    center: Point
    radius: Scalar

    @property
    def dimension(self) -> int:
        """2 or 3, the length of the centre."""
        return self.center.shape[-1]

    @property
    def depth(self) -> Scalar:
        """|center| + radius [m]."""
        return length(*self.center) + self.radius

    @property
    def extent(self) -> Extent:
        """Where the axis leaves the ball (0: nowhere); the largest angle in its level cut, and in its upright one."""
        ahead, aside, above = self.center[0], self.center[1], self.center[2] if self.dimension == 3 else jnp.zeros(())
        root = self.radius**2 - aside**2 - above**2
        far = jnp.where(root > 0, ahead + jnp.sqrt(jnp.maximum(root, 0.0)), 0.0)
        return Extent(
            jnp.maximum(far, 0.0), self._half_angle(ahead, aside, above), self._half_angle(ahead, above, aside)
        )

    def _half_angle(self, ahead: Scalar, aside: Scalar, off: Scalar) -> Scalar:
        """The largest angle from the axis [rad] of a point of the cut through the origin, which is a disc."""
        radius = jnp.sqrt(jnp.maximum(self.radius**2 - off**2, 0.0))
        distance = jnp.hypot(ahead, aside)
        inside = distance <= radius
        apparent = jnp.arcsin(radius / jnp.where(inside, jnp.maximum(radius, 1e-9), distance))
        half = jnp.minimum(jnp.abs(jnp.arctan2(aside, ahead)) + apparent, jnp.pi)
        return jnp.where(inside, jnp.pi, jnp.where(radius > 0, half, 0.0))

    def signed_distance(self, point_body: Float[Array, "... d"]) -> Float[Array, "..."]:
        """|p - center| - radius [m]."""
        return length(*jnp.moveaxis(point_body - self.center, -1, 0)) - self.radius

    def outline(self, reach: float = 10.0) -> np.ndarray | list[np.ndarray]:
        """The circle, or three great circles."""
        center, circle = np.asarray(self.center), float(self.radius) * arc(0.0, 2 * math.pi)
        if self.dimension == 2:
            return center + circle
        return [center + np.insert(circle, axis, 0.0, axis=1) for axis in range(3)]


def ball(center: np.ndarray | Sequence[Number], radius: Number) -> Ball:
    """Disc (2 coordinates) or ball (3) of `radius` > 0 [m]."""
    middle = np.asarray(center, float)
    ok = middle.shape in {(2,), (3,)} and np.isfinite(middle).all()
    require(ok, "center", middle.tolist(), "expected 2 or 3 finite numbers [m]")
    require(0 < radius < math.inf, "radius", radius, "expected a finite number > 0 [m]")
    return Ball(jnp.asarray(middle, float), jnp.asarray(radius, float))
