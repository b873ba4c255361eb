"""Obstacles that hide targets, and that neither agent nor targets enter."""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.geometry import sight
from foveate.geometry.distance_grid import DistanceGrid
from foveate.geometry.linalg import multiply
from foveate.geometry.space import Space
from foveate.geometry.ways import Way, Ways
from foveate.models.sensor import Softness, detection_weight
from foveate.types import Count, Flag, Point, Pose, Scalar

P = TypeVar("P")

START_CELLS = 0.5
"""Room that a random start has beyond the distance at which an agent is stopped, in cells."""


class Obstacles(eqx.Module):
    """The maps of a scenario as signed distances, one of them chosen (see `scenario.obstacles`).

    Of the maps the first `training` are those of training, the rest, if any, those of test scenes. `radius` [m] is that
    of the agent's body, `freest` the place of each map that is farthest from all obstacles, `ways` has the agent's ways
    around them, and `samples` is the number of places on a line of sight at which a soft view looks. With `keep_off`
    [m] every action is shortened so that the body keeps this distance (`Problem.shortened`).
    """

    grid: DistanceGrid
    radius: Scalar
    freest: Float[Array, "maps d"]
    ways: Ways
    training: int = eqx.field(static=True)
    samples: int = eqx.field(static=True)
    targets: Literal["around", "free"] = eqx.field(static=True, default="around")
    keep_off: Scalar | None = None

    @property
    def reach(self) -> Scalar:
        """What the agent's position keeps from obstacles [m]: the radius of its body, and what that keeps off."""
        return self.radius if self.keep_off is None else self.radius + self.keep_off

    def of_map(self, number: Count) -> "Obstacles":
        """The same with another map chosen."""
        return replace(self, grid=replace(self.grid, index=number))

    def sees(self, eye: Point, points_world: Float[Array, "n d"], asked: Bool[Array, " n"]) -> Bool[Array, " n"]:
        """Points [m] that no obstacle hides from the eye, among those asked for."""
        return sight.sees(self.grid, eye, points_world, asked)

    def weight(self, eye: Point, points_world: Float[Array, "n d"], softness: Softness) -> Float[Array, " n"]:
        """Soft `sees`: 1 - Phi of the negative least distance on the line of sight, with the offset 0: 1/2 at a border.

        Of a view's offset, which flatters, there is no need here: a wall is no blurred edge of a picture.
        """
        distance = sight.least_distance(self.grid, eye, points_world, self.samples)
        return detection_weight(-distance, Softness(0.0, softness.kappa))

    def map_number(self, uniform: Scalar, test: bool) -> Count:
        """Number of a random map of training, or of a `test` scene, by a number from 0 to 1."""
        first, count = (self.training, self.grid.maps - self.training) if test else (0, self.training)
        if count == 0:
            first, count = 0, self.training
        return first + jnp.clip((uniform * count).astype(int), 0, count - 1)

    def free_place(self, places_world: Float[Array, "tries d"], radius_m: Scalar) -> Point:
        """The first place at which a body of this radius [m] is free, or that farthest from all obstacles."""
        needed = sight.margin(self.grid, radius_m) + START_CELLS * self.grid.cell
        is_free = self.grid(places_world) > needed
        return jnp.where(is_free.any(), places_world[jnp.argmax(is_free)], self.freest[self.grid.index])

    def ways_to(self, eye: Point, points_world: Float[Array, "n d"], standoff: Scalar | float) -> Way:
        """The agent's ways to points [m]; see `Ways.to`."""
        return self.ways.to(self.grid, self.reach, eye, points_world, standoff)

    def ranges(
        self, space: Space, pose: Pose, directions_body: Float[Array, "rays d"], most_m: Scalar | float
    ) -> Float[Array, " rays"]:
        """Free range [m] along rays of unit length in the agent's frame, at most `most_m`; see `sight.ranges`."""
        directions_world = multiply(directions_body, space.rotation(pose).T)
        return sight.ranges(self.grid, space.position(pose), directions_world, most_m)

    def first_contact(self, way: Callable[[P, Scalar], Point], parameters: P, length_m: Scalar) -> tuple[Point, Flag]:
        """Where the agent's body gets on a way (see `sight.share_free`), and true if an obstacle ends it."""
        share, touches = sight.share_free(self.grid, way, parameters, length_m, self.radius)
        return way(parameters, share), touches

    def go_around(self, before: Point, after: Point, *derivatives: Point) -> tuple[Point, ...]:
        """Position of a target after a step, which slides along the obstacle that it meets, and its derivatives.

        What is left of the step at the contact loses its part into the obstacle; of the derivatives (velocity, ..) that
        part is reversed.
        """

        def way(ends: tuple[Point, Point], share: Scalar) -> Point:
            return ends[0] + share * (ends[1] - ends[0])

        def go(start: Point, end: Point) -> tuple[Point, Array]:
            length, ends = jnp.linalg.norm(end - start), (start, end)
            share, touches = sight.share_free(self.grid, way, ends, length, jnp.zeros_like(length))
            return jnp.where(touches, way(ends, share), end), touches

        contact, touches = go(before, after)
        slope = jax.grad(self.grid)(contact)
        normal = slope / jnp.maximum(jnp.linalg.norm(slope), 1e-6)

        def along(vector: Point, factor: float) -> Point:
            return vector - factor * jnp.minimum(vector @ normal, 0.0) * normal

        slid, _ = go(contact, contact + along(after - contact, 1.0))
        turned = (jnp.where(touches, along(each, 2.0), each) for each in derivatives)
        return jnp.where(touches, slid, after), *turned
