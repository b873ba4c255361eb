"""Dynamic window: try constant commands, simulate each for a few periods, and take the best (Fox, Burgard, Thrun 1997).

The original rates commands of a vehicle among obstacles by heading, clearance and speed; here the measure is what the
agent will know about its targets.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foveate.models.agent import Agent
from foveate.models.problem import Problem
from foveate.policies.detour import steer_to
from foveate.policies.rules import priced
from foveate.policies.tokens import STANDOFF, Tokens
from foveate.simulation.information import Future, believed_future, mean_score
from foveate.simulation.records import Observation, Policy
from foveate.types import Action, Count, Key, Scalar

PERIODS = 5
"""Control periods that each command is simulated for."""

VALUES = {1: 7, 2: 7, 3: 3}
"""Values tried on every axis by the number of axes; 2, the limits, for more: at most 49 commands, 64 for six axes."""

NETWORK_VALUES = 3
"""Most values tried for a network, which corrects them: a third of the time, and commands that steer count most."""

AFTER_PRICES = 1e6
"""More than any price [nat]."""

TIE_NAT = 1e-4
"""Commands whose results differ by less are equal: they see the same targets, except for rounding."""


class Tried(NamedTuple):
    """Commands with the information that they lead to [nat, mean over targets and periods], -inf for padding's.

    `steering` holds those that steer to each target, `constant` those of the grid; `best` is the first action of the
    best of all.
    """

    steering: Float[Array, " n"]
    constant: Float[Array, " commands"]
    best: Action


class DynamicWindow(Policy):
    """Takes the command that leads to the most information after a few periods, in the real view at the means.

    Tried are a grid of constant commands within the limits, standing still, and steering to each target up to
    `standoff_m` [m] before it. Where several see the same, as when no target can be reached, it steers as `price` does.
    The grid has at most `values` on each axis.
    """

    problem: Problem
    standoff_m: float
    values: int = eqx.field(static=True, default=max(VALUES.values()))

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """The first action of the first of the best; stand still without a target."""
        problem = self.problem.at(observation.step).of_map(observation.map_number)
        grid = commands(problem.agent, self.values)
        return tried(problem, observation, grid, self.standoff_m, observation.left).best, memory


def tried(
    problem: Problem,
    observation: Observation,
    constant: Float[Array, "commands m"],
    standoff_m: Scalar | float,
    left: Count,
) -> Tried:
    """Simulate all commands for PERIODS, or for the steps that are `left`; `problem` is that of this step and map.

    Without a target the best is the last of the `constant` commands.
    """
    future = believed_future(problem, observation, observation.known_input, PERIODS, jnp.maximum(left, 1))
    positions_world = problem.motion.position(future.state)
    steering = jax.vmap(lambda path: _steering(problem, future, path, standoff_m), in_axes=1)(positions_world)

    def found(actions: Float[Array, "K m"]) -> Scalar:
        return mean_score(problem, future, actions, None)

    by_steering = jnp.where(observation.present, jax.vmap(found)(steering), -jnp.inf)
    by_constant = jax.vmap(lambda action: found(jnp.broadcast_to(action, (PERIODS, *action.shape))))(constant)
    # Of equal ones steering to the target of the lowest price comes first, and the grid last, in its order.
    order = jnp.concatenate(
        [priced(problem, observation), AFTER_PRICES + jnp.arange(len(constant), dtype=constant.dtype)]
    )
    result = jnp.concatenate([by_steering, by_constant])
    best = jnp.argmin(jnp.where(result >= jnp.max(result) - TIE_NAT, order, jnp.inf))
    action = jnp.concatenate([steering[:, 0], constant])[best]
    return Tried(by_steering, by_constant, jnp.where(observation.present.any(), action, constant[-1]))


def commands(agent: Agent, most: int) -> Float[Array, "commands m"]:
    """The actions of the grid, with at most `most` values on each axis, and that of zero velocity."""
    count = len(agent.axes)
    values = np.linspace(-1.0, 1.0, min(VALUES.get(count, 2), most))
    grid = np.stack(np.meshgrid(*[values] * count, indexing="ij"), axis=-1).reshape(-1, count)
    still = agent.action(jnp.zeros_like(agent.lower))
    return jnp.concatenate([jnp.asarray(grid, still.dtype), still[None]])


def _steering(
    problem: Problem, future: Future, path_world: Float[Array, "K d"], standoff_m: Scalar | float
) -> Float[Array, "K m"]:
    """Actions that steer to a target where it is predicted to be [m]."""

    def step(pose, now):
        point_world, bodies = now
        action = steer_to(problem, pose, point_world, standoff_m, bodies)
        return problem.move(pose, action, bodies), action

    return jax.lax.scan(step, future.pose, (path_world, future.in_the_way(problem)))[1]


def told_window(tokens: Tokens, observation: Observation, tells_time: bool) -> Tokens:
    """The tokens with the window's action, and in front, on every token, what the window expects.

    That is how much information of all targets steering to this one loses against the best command, and how much
    steering to the best target loses [nat], on the scale of log(1 + x). As the rest of such a network, it knows of no
    obstacles.
    """
    robot = observation.robot
    assert robot is not None, "tokens_of rejects others"
    problem, present = replace(robot.problem, obstacles=None), observation.present
    left = observation.left if tells_time else jnp.asarray(PERIODS)
    grid = commands(problem.agent, NETWORK_VALUES)
    found = tried(problem, observation, grid, STANDOFF * robot.extent.ahead_m, left)
    best = jnp.maximum(jnp.max(found.steering, initial=-jnp.inf), jnp.max(found.constant))
    loss = jnp.where(present, best - found.steering, 0.0) * jnp.sum(present).astype(best.dtype)
    least = jnp.min(loss, initial=jnp.inf, where=present)
    losses = jnp.log1p(jnp.stack([loss, jnp.broadcast_to(least, loss.shape)], axis=-1))
    features = jnp.concatenate([jnp.where(present[:, None], losses, 0.0), tokens.features], axis=-1)
    return tokens._replace(features=features, window=problem.agent.on_all_axes(found.best))
