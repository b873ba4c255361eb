"""Heuristics that look for targets never detected: of worlds whose detections have no ids.

What a look is worth is counted in targets: the expected number of undetected ones that it would find, or of tracks that
it would save, a share E min(d^2, c^2) / c^2 of a track with the error d. The price of the way is a factor 1 / (1 +
steps until the place is in view).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.linalg import inverse_spd, multiply
from foveate.models.detections.expectation import position_loss
from foveate.models.detections.grid import Grid
from foveate.models.detections.records import DetectionModel
from foveate.models.problem import Problem
from foveate.policies.heuristics import Steering
from foveate.policies.steering import steps_to_view
from foveate.simulation.records import Observation
from foveate.types import Flag, Point

PLACES = {2: 16, 3: 6}
"""Most places along each axis, by the dimension of space."""


class Undetected(NamedTuple):
    """Expected numbers of undetected targets at coarse places: the middles of cells of a coarser `grid`."""

    number: Float[Array, " places"]
    position_world: Float[Array, "places d"]
    grid: Grid


def undetected_of(model: DetectionModel, cells: Float[Array, "*cells"], most: int | None = None) -> Undetected:
    """The intensity of undetected targets on a grid of at most `most` cells along each axis."""
    most = PLACES[len(model.grid.shape)] if most is None else most
    coarse = Grid(model.grid.low, model.grid.high, tuple(min(most, count) for count in model.grid.shape))
    number = cells
    for axis, (fine, count) in enumerate(zip(model.grid.shape, coarse.shape, strict=True)):
        into = jax.nn.one_hot(jnp.arange(fine) * count // fine, count, dtype=cells.dtype)
        number = jnp.moveaxis(jnp.tensordot(number, into, axes=((axis,), (0,)), precision="highest"), -1, axis)
    return Undetected(number.reshape(-1), coarse.centres().reshape(-1, len(coarse.shape)), coarse)


def detections_of(problem: Problem, observation: Observation) -> tuple[DetectionModel, Float[Array, "*cells"]]:
    """The model of detections, and the intensity of undetected targets of an observation."""
    assert problem.detections is not None, "for problems with detections"
    assert observation.undetected is not None, "observations of such problems have it"
    return problem.detections, observation.undetected


def track_errors(problem: Problem, observation: Observation) -> Float[Array, " n"]:
    """Mean squared error of the position that each track claims [m^2]."""
    Z = problem.motion.Z
    covariance = multiply(multiply(Z, inverse_spd(observation.information)), Z.T)
    return jnp.trace(covariance, axis1=-2, axis2=-1)


class Explore(Steering):
    """Goes where most undetected targets are expected within half the depth of the view, less for a longer way."""

    def goal(self, observation: Observation, memory: Any) -> tuple[Point, Flag, Any]:
        """The best of coarse places."""
        _, worth, position_world = self.places(observation)
        return position_world[jnp.argmax(worth)], jnp.array(True), memory

    def places(
        self, observation: Observation
    ) -> tuple[Float[Array, " places"], Float[Array, " places"], Float[Array, "places d"]]:
        """Coarse places: the number of targets expected near each, the same with the price of the way, and where."""
        found = undetected_of(*detections_of(self.problem, observation))
        square_m2 = jnp.sum((found.position_world[:, None] - found.position_world) ** 2, axis=-1)
        reach_m = 0.5 * self.problem.sensor.view.extent.ahead_m
        number = jnp.matmul((square_m2 <= reach_m**2).astype(found.number.dtype), found.number, precision="highest")
        return number, number * self.nearness(observation, found.position_world), found.position_world

    def nearness(self, observation: Observation, position_world: Float[Array, "places d"]) -> Float[Array, " places"]:
        """1 / (1 + steps until each place is in view)."""
        agent, step = self.problem.agent, self.problem.at(observation.step)
        points_body = agent.space.to_body(observation.pose, position_world)
        extent = step.sensor.view.extent
        steps = jax.vmap(lambda point: jnp.sum(steps_to_view(agent, step.tau, extent, point)))(points_body)
        return 1.0 / (1.0 + steps)


class Alternate(Explore):
    """Goes to the track that a look would save the most of, unless it is worth more to explore."""

    def goal(self, observation: Observation, memory: Any) -> tuple[Point, Flag, Any]:
        """The best of tracks and coarse places."""
        _, worth, position_world = self.places(observation)
        goals = jnp.concatenate([self.problem.motion.position(observation.mean), position_world])
        best = jnp.argmax(jnp.concatenate([self.saved(observation), worth]))
        return goals[best], jnp.array(True), memory

    def saved(self, observation: Observation) -> Float[Array, " n"]:
        """The worth of a look at each track [targets], with the price of the way; 0 for padding."""
        model, _ = detections_of(self.problem, observation)
        assert observation.existence is not None, "observations of such problems have it"
        lost = position_loss(track_errors(self.problem, observation), model.cutoff)
        means = self.problem.motion.position(observation.mean)
        return jnp.where(observation.present, observation.existence * lost, 0.0) * self.nearness(observation, means)
