"""A policy that weighs where to go next: several actions for every target, and how much each is worth choosing.

A plain network answers with one action, and between two targets that are as good as each other its answer is their
mean, which leads to neither. This one proposes (Vinyals 2015, "Pointer Networks"; Bishop 1994, "Mixture Density
Networks"): the targets are encoded as a set (Zaheer 2017, Lee 2019), and each gets a few modes, an action and a weight
each. It does the action of the largest weight; a learner lets it try the others, so that which target comes next is
explored as such.
"""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.geometry.space import Space
from foveate.models.problem import Problem
from foveate.policies.inputs import rich_inputs, rich_numbers
from foveate.policies.layers import Layers, fresh_layers, masked_softmax
from foveate.simulation.records import Observation, Policy
from foveate.types import Action, Key

NEVER = -1e9
"""The log weight of the modes of padding: finite, so that derivatives are."""


@dataclass(frozen=True, kw_only=True)
class PointerSettings:
    """Widths of the layers on each target, after gathering and before the modes; how many queries (`heads`) gather,
    and how many `modes` a target has. Positions enter in units of `length_m`.
    """

    kind: Literal["pointer"]
    target_widths: tuple[int, ...] = (64, 64, 64)
    """Layers on each target."""
    heads: int = 4
    context_widths: tuple[int, ...] = (64, 64)
    """Layers on what was gathered."""
    mode_widths: tuple[int, ...] = (64,)
    """Layers before the modes."""
    modes: int = 2
    length_m: float = 5.0

    def __post_init__(self) -> None:
        for name in ("target_widths", "context_widths", "mode_widths"):
            widths = getattr(self, name)
            if not widths or min(widths) < 1:
                raise InputError(f"{name} = {widths}: expected at least one width, each >= 1")
        for name in ("heads", "modes"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} = {getattr(self, name)}: expected >= 1")
        if self.length_m <= 0:
            raise InputError(f"length_m = {self.length_m}: expected > 0")

    def policy(self, problem: Problem, key: Key) -> "PointerPolicy":
        """A network with fresh weights, fit for the problem's space, targets and actuated axes."""
        numbers, axes = rich_numbers(problem, self.kind), len(problem.agent.axes)
        embedding, context = self.target_widths[-1], self.context_widths[-1]
        target, query, gathered, mode, idle = fresh_layers(
            (
                (numbers, *self.target_widths),
                (embedding, self.heads),
                (self.heads * embedding, *self.context_widths),
                (embedding + context, *self.mode_widths, self.modes * (1 + axes)),
                (context, 1 + axes),
            ),
            key,
        )
        encoder = SetEncoder(target, query, problem.agent.space, self.length_m)
        return PointerPolicy(encoder, gathered, mode, idle, self.modes)


class SetEncoder(eqx.Module):
    """Layers on every target; each query's softmax over the targets weighs their mean."""

    target_layers: Layers
    query_layers: Layers
    space: Space = eqx.field(static=True)
    length_m: float = eqx.field(static=True)

    def __call__(self, observation: Observation) -> tuple[Float[Array, "n embedding"], Float[Array, " gathered"]]:
        """Every target by itself, and all of them together; the latter zero where none is present."""
        targets = rich_inputs(observation, self.space, self.length_m)
        for layer in self.target_layers:
            targets = jax.nn.relu(jax.vmap(layer)(targets))
        (query,) = self.query_layers
        weights = jax.vmap(masked_softmax, (1, None))(jax.vmap(query)(targets), observation.present)
        return targets, (weights @ targets).ravel()


class Modes(NamedTuple):
    """A mixture: each mode's log weight, not normalised, and its normalised action."""

    log_weight: Float[Array, " modes"]
    action: Float[Array, "modes m"]


class PointerPolicy(Policy):
    """Modes of every target from its encoding and that of all, and one, idle, from that of all alone."""

    encoder: SetEncoder
    context_layers: Layers
    mode_layers: Layers
    idle_layers: Layers
    per_target: int = eqx.field(static=True)

    def modes(self, observation: Observation) -> Modes:
        """What could be done, n per_target + 1 modes; those of padding have no weight."""
        targets, context = self.encoder(observation)
        for layer in self.context_layers:
            context = jax.nn.relu(layer(context))
        both = jnp.concatenate([targets, jnp.broadcast_to(context, (len(targets), len(context)))], axis=-1)
        for layer in self.mode_layers[:-1]:
            both = jax.nn.relu(jax.vmap(layer)(both))
        numbers = jax.vmap(self.mode_layers[-1])(both).reshape(len(targets), self.per_target, -1)
        (idle,) = self.idle_layers
        weight = jnp.where(observation.present[:, None], numbers[..., 0], NEVER)
        flat = numbers[..., 1:].reshape(weight.size, -1)
        last = idle(context)
        return Modes(
            log_weight=jnp.append(weight.ravel(), last[0]),
            action=jnp.tanh(jnp.concatenate([flat, last[None, 1:]])),
        )

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """Deterministic: the action of the mode with the largest weight."""
        del key
        modes = self.modes(observation)
        return modes.action[jnp.argmax(modes.log_weight)], memory
