"""Dynamic window: try constant commands, simulate each for a few periods, and take the best (Fox, Burgard, Thrun 1997).

The original rates commands of a vehicle among obstacles by heading, clearance and speed; here the measure is what the
agent will know about its targets.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foveate.models.agent import Agent
from foveate.models.problem import Problem
from foveate.planning.information import Future, mean_score
from foveate.planning.receding import believed_future
from foveate.policies.detour import steer_to
from foveate.policies.rules import priced
from foveate.simulation.records import Observation, Policy
from foveate.types import Action, Key, Scalar

PERIODS = 5
"""Control periods that each command is simulated for."""

VALUES = {1: 7, 2: 7, 3: 3}
"""Values tried on every axis by the number of axes; 2, the limits, for more: at most 49 commands, 64 for six axes."""

AFTER_PRICES = 1e6
"""More than any price [nat]."""

TIE_NAT = 1e-4
"""Commands whose results differ by less are equal: they see the same targets, except for rounding."""


class DynamicWindow(Policy):
    """Takes the command that leads to the most information after a few periods, in the real view at the means.

    Tried are a grid of constant commands within the limits, standing still, and steering to each target up to
    `standoff_m` [m] before it. Where several see the same, as when no target can be reached, it steers as `price` does.
    """

    problem: Problem
    standoff_m: float = eqx.field(static=True)

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """The first action of the first of the best; stand still without a target."""
        problem, present = self.problem.at(observation.step).of_map(observation.map_number), observation.present
        left = jnp.maximum(observation.left, 1)
        future = believed_future(problem, observation, observation.known_input, PERIODS, left)
        positions_world = problem.motion.position(future.state)
        steering = jax.vmap(lambda path: _steering(problem, future, path, self.standoff_m), in_axes=1)(positions_world)
        constant = commands(problem.agent)

        def found(actions: Float[Array, "K m"]) -> Scalar:
            return mean_score(problem, future, actions, None)

        by_steering = jnp.where(present, jax.vmap(found)(steering), -jnp.inf)
        by_constant = jax.vmap(lambda action: found(jnp.broadcast_to(action, (PERIODS, *action.shape))))(constant)
        result = jnp.concatenate([by_steering, by_constant])
        # Of equal ones steering to the target of the lowest price comes first, and the grid last, in its order.
        later = AFTER_PRICES + jnp.arange(len(constant), dtype=constant.dtype)
        order = jnp.concatenate([priced(problem, observation), later])
        best = jnp.argmin(jnp.where(result >= jnp.max(result) - TIE_NAT, order, jnp.inf))
        action = jnp.concatenate([steering[:, 0], constant])[best]
        return jnp.where(present.any(), action, problem.agent.action(jnp.zeros_like(problem.agent.lower))), memory


def commands(agent: Agent) -> Float[Array, "commands m"]:
    """The actions of the grid, and that of zero velocity."""
    count = len(agent.axes)
    values = np.linspace(-1.0, 1.0, VALUES.get(count, 2))
    grid = np.stack(np.meshgrid(*[values] * count, indexing="ij"), axis=-1).reshape(-1, count)
    still = agent.action(jnp.zeros_like(agent.lower))
    return jnp.concatenate([jnp.asarray(grid, still.dtype), still[None]])


def _steering(
    problem: Problem, future: Future, path_world: Float[Array, "K d"], standoff_m: Scalar | float
) -> Float[Array, "K m"]:
    """Actions that steer to a target where it is predicted to be [m]."""

    def step(pose, now):
        state, point_world = now
        action = steer_to(problem, pose, point_world, standoff_m)
        obstacles = None if problem.keep_off_m is None else problem.motion.position(state)
        return problem.move(pose, action, obstacles, future.present), action

    return jax.lax.scan(step, future.pose, (future.state, path_world))[1]
