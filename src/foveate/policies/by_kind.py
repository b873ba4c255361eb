"""Policies that hold the problem of their robot, in a team of robots of different kinds."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.simulation.records import Observation, Policy
from foveate.types import Action, Count, Key


class ByKind(Policy):
    """A policy for each kind of robot, of which every robot decides by that of its own kind.

    `own` has the arrays and numbers in which the policies differ, with a leading axis of kinds, `rest` all others.
    """

    own: Policy
    rest: Policy
    kinds: int = eqx.field(static=True)

    def of_robot(self, number: Count | int) -> Policy:
        """The policy of a robot of the team."""
        kind = number % self.kinds
        return eqx.combine(jax.tree.map(lambda part: part[kind], self.own), self.rest)

    def of(self, observation: Observation) -> Policy:
        """The policy of the robot that observes. Raises InputError for a robot outside of a team."""
        if observation.team is None:
            raise InputError("observation.team = None: expected a robot of the team: its policy is `of_robot(number)`")
        return self.of_robot(observation.team.number)

    def start(self, observation: Observation) -> Any:
        """The memory of the robot's own policy."""
        return self.of(observation).start(observation)

    def claims(self, observation: Observation, memory: Any) -> Float[Array, " n"]:
        """What the robot's own policy claims."""
        return self.of(observation).claims(observation, memory)

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """The robot's own policy decides."""
        return self.of(observation)(observation, memory, key)


def by_kind(policies: Sequence[Policy]) -> Policy:
    """Policies that differ only in arrays and numbers, one for each kind of robot, as one."""
    first, *others = policies
    # What is one object in all of them, as maps are, is held once.
    is_own = jax.tree.map(lambda part, *rest: any(part is not other for other in rest), first, *others)
    parts = [eqx.filter(policy, is_own) for policy in policies]
    own = jax.tree.map(lambda *values: jnp.stack([jnp.asarray(value) for value in values]), *parts)
    return ByKind(own, eqx.filter(first, is_own, inverse=True), len(policies))
