"""Heuristics that weigh uncertainty against the way to it, or that stay at one place."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.linalg import log_det_spd
from foveate.models.problem import Problem
from foveate.policies.detour import reachable, steer_to, unfolded
from foveate.policies.heuristics import Steering, box_of, here
from foveate.policies.steering import steps_to_view, twist_towards
from foveate.simulation.bodies import bodies_of
from foveate.simulation.records import Observation, Policy
from foveate.types import Action, Flag, Key, Point

NATS_PER_STEP = 0.5
"""Price of a step of the way to a target, in log det of its information."""

ARRIVED = 0.1
"""An agent within this share of the view's depth of its post is there."""


def priced(problem: Problem, observation: Observation) -> Float[Array, " n"]:
    """log det of the predicted information of each target, plus the price of the way to it [nat]; inf in padding."""
    agent, step = problem.agent, problem.at(observation.step)
    way = unfolded(
        step.of_map(observation.map_number), observation.pose, problem.motion.position(observation.mean), 0.0
    )
    points_body = way.points_body
    extent = step.sensor.view.extent
    steps = jax.vmap(lambda point: steps_to_view(agent, step.tau, extent, point))(points_body)
    cost = log_det_spd(observation.information) + NATS_PER_STEP * jnp.sum(steps, axis=-1)
    return jnp.where(observation.present, cost, jnp.inf)


class Price(Steering):
    """Follows the most uncertain target, less a price for each step of turning and driving until it is in view."""

    def goal(self, observation: Observation, memory: Any) -> tuple[Point, Flag, Any]:
        """The predicted mean with the least sum of information and price."""
        choice = jnp.argmin(priced(self.problem, observation))
        return self.problem.motion.position(observation.mean)[choice], observation.present.any(), memory


class Post(Policy):
    """Drives to the place from which it can look at the most targets, and stays there, turning from one to another.

    The place is midway between two of the first means, or a view's half depth before one of them, in `box_world` (low,
    high corner [m]) if given: that with the most first means within `depth_m` [m], the nearest of equals. There the
    agent turns to the least certain target within `depth_m`, or to the nearest if none is. An agent that cannot drive
    turns only. The memory is the place [m].
    """

    problem: Problem
    depth_m: float
    box_world: Float[Array, "2 d"] | None = None

    def start(self, observation: Observation) -> Point:
        """The place; without targets the middle of the box, or where the agent is."""
        agent_world = self.problem.agent.space.position(observation.pose)
        low, high = box_of(self.problem, observation, self.box_world)
        position, present = self.problem.motion.position(observation.mean), observation.present
        toward = agent_world - position
        before = toward * (0.5 * self.depth_m / jnp.maximum(jnp.linalg.norm(toward, axis=-1, keepdims=True), 1e-6))
        alone = jnp.eye(len(present), dtype=bool)[..., None]
        places = jnp.clip(jnp.where(alone, position + before, 0.5 * (position[:, None] + position)), low, high)

        def in_reach(row):
            return jnp.sum((jnp.linalg.norm(row[:, None] - position, axis=-1) <= self.depth_m) & present, axis=-1)

        # Row by row: the cube of many targets would not fit into memory.
        count = jnp.where(present[:, None] & present, jax.lax.map(in_reach, places), -1)
        distance_m = jnp.linalg.norm(places - agent_world, axis=-1)
        best = jnp.argmin(jnp.where(count == jnp.max(count), distance_m, jnp.inf))
        place = jnp.where(present.any(), places.reshape(-1, len(low))[best], 0.5 * (low + high))
        return reachable(here(self.problem, observation), place[None])[0]

    def __call__(self, observation: Observation, memory: Point, key: Key) -> tuple[Action, Point]:
        """Drive to the place, or turn to a target from there; stop if there is none."""
        agent, tau = self.problem.agent, self.problem.at(observation.step).tau
        space, still = agent.space, agent.action(jnp.zeros_like(agent.lower))
        points_body = space.to_body(observation.pose, self.problem.motion.position(observation.mean))
        range_m = jnp.linalg.norm(points_body, axis=-1)
        in_reach = observation.present & (range_m <= self.depth_m)
        uncertain = jnp.where(in_reach, log_det_spd(observation.information), jnp.inf)
        cost = jnp.where(in_reach.any(), uncertain, jnp.where(observation.present, range_m, jnp.inf))
        twist = twist_towards(agent, tau, points_body[jnp.argmin(cost)], 0.0).at[: space.dimension].set(0.0)
        turn = jnp.where(observation.present.any(), agent.action(twist[jnp.array(agent.axes)]), still)
        if min(agent.axes) >= space.dimension:  # no axis to drive
            return turn, memory
        place_body = space.to_body(observation.pose, memory)
        away = jnp.linalg.norm(place_body) > ARRIVED * self.depth_m
        bodies = bodies_of(self.problem, observation)
        action = steer_to(here(self.problem, observation), observation.pose, memory, 0.0, bodies)
        return jnp.where(away, action, turn), memory
