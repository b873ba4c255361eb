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
from foveate.types import Action, Count, Key

PERIODS = 5
"""Control periods that each command is simulated for."""

VALUES = {1: 7, 2: 7, 3: 3}
"""Values tried on every axis by the number of axes; 2, the limits, for more: at most 49 commands, 64 for six axes."""

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
        future = believed_future(
            problem, observation, observation.known_input, PERIODS, jnp.maximum(observation.left, 1)
        )
        order = jnp.argsort(priced(problem, observation))
        steering = jax.vmap(lambda target: _steering(problem, future, target, self.standoff_m))(order)
        constant = commands(problem.agent)
        constant = jnp.broadcast_to(constant[:, None], (len(constant), PERIODS, constant.shape[-1]))
        tried = jnp.concatenate([steering, constant])
        found = jax.vmap(lambda action: mean_score(problem, future, action, None))(tried)
        to_padding = jnp.concatenate([~present[order], jnp.zeros(len(constant), bool)])
        found = jnp.where(to_padding, -jnp.inf, found)
        best = tried[jnp.argmax(found >= jnp.max(found) - TIE_NAT), 0]
        return jnp.where(present.any(), best, problem.agent.action(jnp.zeros_like(problem.agent.lower))), memory


def commands(agent: Agent) -> Float[Array, "commands m"]:
    """The actions of the grid, and that of zero velocity."""
    count = len(agent.axes)
    values = np.linspace(-1.0, 1.0, VALUES.get(count, 2))
    grid = np.stack(np.meshgrid(*[values] * count, indexing="ij"), axis=-1).reshape(-1, count)
    still = agent.action(jnp.zeros_like(agent.lower))
    return jnp.concatenate([jnp.asarray(grid, still.dtype), still[None]])


def _steering(problem: Problem, future: Future, target: Count, standoff_m: float) -> Float[Array, "K m"]:
    """Actions that steer to a target where it is predicted to be."""

    def step(pose, state):
        positions_world = problem.motion.position(state)
        action = steer_to(problem, pose, positions_world[target], standoff_m)
        obstacles = None if problem.keep_off_m is None else positions_world
        return problem.move(pose, action, obstacles, future.present), action

    return jax.lax.scan(step, future.pose, future.state)[1]
