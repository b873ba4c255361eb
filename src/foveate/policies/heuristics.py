"""Policies made by hand: what a learned policy has to beat."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.geometry.linalg import log_det_spd
from foveate.models.problem import Problem
from foveate.simulation.records import Observation, Policy
from foveate.types import Action, Flag, Key, Point, Scalar

LANES = 6
"""Lanes of the lawnmower; an even number, so that the sweep ends where it can begin again."""


class Random(Policy):
    """A new action every step, uniform within the limits."""

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


class Steering(Policy):
    """Turns to a goal and drives until it stands `standoff_m` before it; a subclass chooses the goal."""

    problem: Problem
    standoff_m: float = eqx.field(static=True)

    @abc.abstractmethod
    def goal(self, observation: Observation, memory: Any) -> tuple[Point, Flag, Any]:
        """Position of the goal in the world [m], whether there is one, and the memory for the next step."""

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """Heading first: the speed ahead falls with the cosine of the angle that is still to turn."""
        goal_world, exists, memory = self.goal(observation, memory)
        agent = self.problem.agent
        point = agent.space.to_body(observation.pose, goal_world)
        tau = self.problem.at(observation.step).tau
        there = agent.action(twist_towards(point, self.standoff_m, tau)[jnp.array(agent.axes)])
        rest = agent.action(jnp.zeros_like(agent.lower))
        return jnp.where(exists, there, rest), memory


def twist_towards(point_body: Point, standoff_m: float | Scalar, tau: Float[Array, ""]) -> Float[Array, " n_u"]:
    """The twist that would face a body-frame point, and end `standoff_m` before it, after one period."""
    across = jnp.hypot(point_body[0], point_body[1])
    bearing = jnp.arctan2(point_body[1], point_body[0])
    ahead = jnp.maximum(jnp.cos(bearing), 0.0) * (across - standoff_m)
    zero = jnp.zeros_like(ahead)
    if len(point_body) == 2:
        return jnp.stack([ahead, zero, bearing]) / tau
    elevation = jnp.arctan2(point_body[2], across)
    return jnp.stack([ahead, zero, point_body[2], zero, -elevation, bearing]) / tau


class Nearest(Steering):
    """Goes after the target whose predicted position is nearest."""

    def goal(self, observation: Observation, memory: Any) -> tuple[Point, Flag, Any]:
        """The nearest predicted mean."""
        position = self.problem.motion.position(observation.mean)
        away = jnp.sum((position - self.problem.agent.space.position(observation.pose)) ** 2, axis=-1)
        choice = jnp.argmin(jnp.where(observation.present, away, jnp.inf))
        return position[choice], observation.present.any(), memory


class Uncertain(Steering):
    """Goes after the target that it knows least about: the smallest log det of the predicted information."""

    def goal(self, observation: Observation, memory: Any) -> tuple[Point, Flag, Any]:
        """The predicted mean with the least information; the nearer of equals."""
        position = self.problem.motion.position(observation.mean)
        away = jnp.linalg.norm(position - self.problem.agent.space.position(observation.pose), axis=-1)
        known = log_det_spd(observation.information) + 1e-3 * away
        choice = jnp.argmin(jnp.where(observation.present, known, jnp.inf))
        return position[choice], observation.present.any(), memory


class Lawnmower(Steering):
    """Sweeps a box in six parallel lanes, again and again: `box_world` (2, d), or that of the first beliefs.

    Its memory is the lanes' corners and which of them comes next.
    """

    box_world: Float[Array, "2 d"] | None = None

    def start(self, observation: Observation) -> Any:
        """The corners of the lanes, shape (2 LANES, d), beginning at the one nearest the agent."""
        position = self.problem.motion.position(observation.mean)
        mask = observation.present[:, None]
        here = self.problem.agent.space.position(observation.pose)
        if self.box_world is None:
            nobody = ~observation.present.any()
            low = jnp.where(nobody, here, jnp.min(jnp.where(mask, position, jnp.inf), axis=0))
            high = jnp.where(nobody, here, jnp.max(jnp.where(mask, position, -jnp.inf), axis=0))
        else:
            low, high = self.box_world
        across = jnp.repeat((jnp.arange(LANES, dtype=low.dtype) + 0.5) / LANES, 2)
        along = jnp.tile(jnp.array([0.0, 1.0, 1.0, 0.0], low.dtype), LANES // 2)
        middle = jnp.full((2 * LANES, low.shape[0] - 2), 0.5, low.dtype)
        corners = low + (high - low) * jnp.concatenate([along[:, None], across[:, None], middle], axis=1)
        return corners, jnp.argmin(jnp.linalg.norm(corners - here, axis=-1))

    def goal(self, observation: Observation, memory: Any) -> tuple[Point, Flag, Any]:
        """The next corner; the one after it once the agent is within reach of one step."""
        corners, turn = memory
        agent = self.problem.agent
        linear = jnp.array([i for i, axis in enumerate(agent.axes) if axis < agent.space.dimension], int)
        speed = jnp.max(jnp.maximum(-agent.lower, agent.upper)[linear], initial=0.0)
        reach = jnp.maximum(0.5 * speed * self.problem.at(observation.step).tau, self.standoff_m)
        away = jnp.linalg.norm(corners[turn] - agent.space.position(observation.pose))
        turn = jnp.where(away < reach, (turn + 1) % len(corners), turn)
        return corners[turn], jnp.array(True), (corners, turn)


HEURISTICS = ("random", "still", "nearest", "uncertain", "lawnmower")


def heuristic(name: str, problem: Problem, depth_m: float, box_world: Float[Array, "2 d"] | None = None) -> Policy:
    """The hand-made policy of that name, standing off by half the depth [m] of the view; the box is the lawnmower's."""
    policies = {
        "random": lambda: Random(problem),
        "still": lambda: Still(problem),
        "nearest": lambda: Nearest(problem, 0.5 * depth_m),
        "uncertain": lambda: Uncertain(problem, 0.5 * depth_m),
        "lawnmower": lambda: Lawnmower(problem, 0.0, box_world),
    }
    if name not in policies:
        raise InputError(f"method {name!r}: expected one of {', '.join(HEURISTICS)}")
    return policies[name]()
