"""Heuristic policies: baselines for learned ones."""

import abc
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.linalg import log_det_spd
from foveate.models.problem import Problem
from foveate.policies.detour import reachable, steer_to, unfolded
from foveate.simulation.bodies import bodies_of
from foveate.simulation.records import Observation, Policy
from foveate.types import Action, Flag, Key, Point

LANES = 6
"""Lanes of the lawnmower: an even number, so that the sweep ends where it can begin again."""


class Random(Policy):
    """Takes a random action at every step, uniform within the limits."""

    problem: Problem

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """Uniform in [-1, 1] per axis."""
        return jax.random.uniform(key, self.problem.agent.lower.shape, minval=-1.0), memory


class Still(Policy):
    """Stands as still as its limits allow."""

    problem: Problem

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """The action of zero velocity."""
        return self.problem.agent.action(jnp.zeros_like(self.problem.agent.lower)), memory


def here(problem: Problem, observation: Observation) -> Problem:
    """The problem of the observation's step and map."""
    return problem.at(observation.step).of_map(observation.map_number)


class Steering(Policy):
    """Turns to a goal and stops `standoff_m` [m] before it; subclasses choose the goal.

    Among obstacles it drives around them, on the shortest way of the agent's body, and past bodies that it keeps off.
    """

    problem: Problem
    standoff_m: float

    @abc.abstractmethod
    def goal(self, observation: Observation, memory: Any) -> tuple[Point, Flag, Any]:
        """Position of the goal in the world [m], whether one exists, and the memory for the next step."""

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """Steer to the goal; stop if none exists."""
        goal_world, exists, memory = self.goal(observation, memory)
        problem, agent = here(self.problem, observation), self.problem.agent
        bodies = bodies_of(problem, observation)
        action = steer_to(problem, observation.pose, goal_world, self.standoff_m, bodies)
        return jnp.where(exists, action, agent.action(jnp.zeros_like(agent.lower))), memory


class Nearest(Steering):
    """Follows the target whose predicted position is nearest, among obstacles by the way to it."""

    def goal(self, observation: Observation, memory: Any) -> tuple[Point, Flag, Any]:
        """The nearest predicted mean."""
        position = self.problem.motion.position(observation.mean)
        if self.problem.obstacles is None:
            square_m2 = jnp.sum((position - self.problem.agent.space.position(observation.pose)) ** 2, axis=-1)
        else:
            way = unfolded(here(self.problem, observation), observation.pose, position, self.standoff_m)
            square_m2 = jnp.sum(way.points_body**2, axis=-1)
        choice = jnp.argmin(jnp.where(observation.present, square_m2, jnp.inf))
        return position[choice], observation.present.any(), memory


class Uncertain(Steering):
    """Follows the target with the smallest log det of its predicted information."""

    def goal(self, observation: Observation, memory: Any) -> tuple[Point, Flag, Any]:
        """The predicted mean with the least information; the nearest of equals."""
        position = self.problem.motion.position(observation.mean)
        distance_m = jnp.linalg.norm(position - self.problem.agent.space.position(observation.pose), axis=-1)
        # Targets that were never seen have equal beliefs: a millinat per metre decides among them only.
        cost = log_det_spd(observation.information) + 1e-3 * distance_m
        choice = jnp.argmin(jnp.where(observation.present, cost, jnp.inf))
        return position[choice], observation.present.any(), memory


def box_of(problem: Problem, observation: Observation, given: Float[Array, "2 d"] | None) -> tuple[Point, Point]:
    """Low and high corner [m] of the given box, or else of that of the means; the agent's place without any."""
    if given is not None:
        return given[0], given[1]
    position, mask = problem.motion.position(observation.mean), observation.present[:, None]
    agent_world, empty = problem.agent.space.position(observation.pose), ~observation.present.any()
    low = jnp.where(empty, agent_world, jnp.min(position, axis=0, initial=jnp.inf, where=mask))
    return low, jnp.where(empty, agent_world, jnp.max(position, axis=0, initial=-jnp.inf, where=mask))


class Lawnmower(Steering):
    """Sweeps a box in parallel lanes, repeatedly: `box_world` (low, high corner [m]), or that of the initial beliefs.

    Its memory is the lanes' corners and the index of the next corner.
    """

    box_world: Float[Array, "2 d"] | None = None

    def start(self, observation: Observation) -> Any:
        """The corners of the lanes, shape (2 LANES, d), and the index of the one nearest the agent."""
        agent_world = self.problem.agent.space.position(observation.pose)
        low, high = box_of(self.problem, observation, self.box_world)
        across = jnp.repeat((jnp.arange(LANES, dtype=low.dtype) + 0.5) / LANES, 2)
        along = jnp.tile(jnp.array([0.0, 1.0, 1.0, 0.0], low.dtype), LANES // 2)
        middle = jnp.full((2 * LANES, low.shape[0] - 2), 0.5, low.dtype)
        corners = low + (high - low) * jnp.concatenate([along[:, None], across[:, None], middle], axis=1)
        corners = reachable(here(self.problem, observation), corners)
        return corners, jnp.argmin(jnp.linalg.norm(corners - agent_world, axis=-1))

    def goal(self, observation: Observation, memory: Any) -> tuple[Point, Flag, Any]:
        """The next corner, or the one after it if the agent is within half a step of it."""
        corners, index = memory
        agent = self.problem.agent
        linear = jnp.array([i for i, axis in enumerate(agent.axes) if axis < agent.space.dimension], int)
        speed = jnp.max(jnp.maximum(-agent.lower, agent.upper)[linear], initial=0.0)
        reach = jnp.maximum(0.5 * speed * self.problem.at(observation.step).tau, self.standoff_m)
        distance_m = jnp.linalg.norm(corners[index] - agent.space.position(observation.pose))
        index = jnp.where(distance_m < reach, (index + 1) % len(corners), index)
        return corners[index], jnp.array(True), (corners, index)
