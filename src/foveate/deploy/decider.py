"""A policy's decisions one after another, outside of the simulation, with its memory between them."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foveate.models.agent import Agent
from foveate.simulation.records import Observation, Policy


class Decider:
    """Runs a policy for one robot: counts the steps, and keeps the policy's memory.

    Step k has the random key that `rollout` has at step k with the key of `seed`.
    """

    def __init__(self, policy: Policy, agent: Agent, seed: int = 0) -> None:
        self._policy, self._agent, self._seed = policy, agent, seed
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next decision is the first of an episode."""
        self._step, self._size, self._memory = 0, -1, None

    def command(self, observed: Observation) -> Float[np.ndarray, " m"]:
        """Decide on a command [m/s, rad/s]; the step is the decider's own count.

        A memory with a row a target begins again where the number of rows changes. A command that is not finite leaves
        no trace: the memory is that before it.
        """
        observed = replace(observed, step=jnp.asarray(self._step, int))
        memory, size = self._memory, len(observed.present)
        if size != self._size:
            fresh = _start(self._policy, observed)
            memory = memory if self._size >= 0 and _shapes(memory) == _shapes(fresh) else fresh
        control, memory = _decide(self._policy, self._agent, observed, memory, self._seed)
        command = np.array(control)
        if np.isfinite(command).all():
            self._step, self._size, self._memory = self._step + 1, size, memory
        return command


def _shapes(memory: Any) -> tuple[list[tuple[int, ...]], Any]:
    """Shapes of the arrays of a memory, and its structure."""
    return [np.shape(leaf) for leaf in jax.tree.leaves(memory)], jax.tree.structure(memory)


@eqx.filter_jit
def _start(policy: Policy, observed: Observation) -> Any:
    return policy.start(observed)


@eqx.filter_jit
def _decide(
    policy: Policy, agent: Agent, observed: Observation, memory: Any, seed: int
) -> tuple[Float[Array, " m"], Any]:
    key = jax.random.fold_in(jax.random.key(seed), observed.step)
    action, memory = policy(observed, memory, key)
    return agent.control(action), memory
