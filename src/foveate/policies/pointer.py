"""Pointer policy: proposes a few actions for every target, and takes the one of the largest weight.

A network with a single action answers two equally good targets with the mean of both, which leads to neither. This one
is a mixture (Vinyals 2015, "Pointer Networks"; Bishop 1994, "Mixture Density Networks") on targets encoded as a set
(Zaheer 2017, Lee 2019). A learner samples among its modes, and so explores which target comes next.
"""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.space import Space
from foveate.io.validate import positive, require
from foveate.models.problem import Problem
from foveate.policies.inputs import pointer_feature_count, pointer_features
from foveate.policies.layers import Layers, apply_relu, fresh_layers, masked_softmax
from foveate.simulation.records import Observation, Policy
from foveate.types import Action, Key

PADDING_LOG_WEIGHT = -1e9
"""Log weight of the modes of padding: probability 0, but finite, so that derivatives are finite."""


@dataclass(frozen=True, kw_only=True)
class PointerSettings:
    """Settings of a pointer network.

    `heads` is the number of attention queries that pool the targets into the context, `modes` the number of actions
    proposed for each target. Positions enter in units of `length_m`.
    """

    kind: Literal["pointer"]
    target_widths: tuple[int, ...] = (64, 64, 64)
    """Layers on each target."""
    heads: int = 4
    context_widths: tuple[int, ...] = (64, 64)
    """Layers on the context."""
    mode_widths: tuple[int, ...] = (64,)
    """Layers before the modes."""
    modes: int = 2
    length_m: float = 5.0

    def __post_init__(self) -> None:
        for name in ("target_widths", "context_widths", "mode_widths"):
            widths = getattr(self, name)
            require(min(widths, default=0) >= 1, name, widths, "expected at least one width, each >= 1")
        for name in ("heads", "modes"):
            require(getattr(self, name) >= 1, name, getattr(self, name), "expected >= 1")
        positive(self, "length_m")

    def policy(self, problem: Problem, key: Key) -> "PointerPolicy":
        """A network with random weights, sized for the problem's space, targets and actuated axes."""
        axes, embedding, context = len(problem.agent.axes), self.target_widths[-1], self.context_widths[-1]
        widths = (
            (pointer_feature_count(problem), *self.target_widths),
            (embedding, self.heads),
            (self.heads * embedding, *self.context_widths),
            (embedding + context, *self.mode_widths, self.modes * (1 + axes)),
            (context, 1 + axes),
        )
        target, query, context_layers, mode, idle = fresh_layers(widths, key)
        encoder = SetEncoder(target, query, problem.agent.space, self.length_m)
        return PointerPolicy(encoder, context_layers, mode, idle, self.modes)


class SetEncoder(eqx.Module):
    """Layers on every target, pooled by attention: one mean over the targets per query, weighted by its softmax."""

    target_layers: Layers
    query_layers: Layers
    space: Space = eqx.field(static=True)
    length_m: float = eqx.field(static=True)

    def __call__(self, observation: Observation) -> tuple[Float[Array, "n embedding"], Float[Array, " pooled"]]:
        """The embedding of each target, and the pooled one of all, zero where none is present."""
        targets = apply_relu(self.target_layers, pointer_features(observation, self.space, self.length_m))
        (query,) = self.query_layers
        weights = jax.vmap(masked_softmax, (1, None))(jax.vmap(query)(targets), observation.present)
        return targets, (weights @ targets).ravel()


class Modes(NamedTuple):
    """A mixture: log weight of each mode, not normalised, and its action in [-1, 1]."""

    log_weight: Float[Array, " modes"]
    action: Float[Array, "modes m"]


class PointerPolicy(Policy):
    """Modes of every target from its embedding and the context, and an idle mode from the context alone."""

    encoder: SetEncoder
    context_layers: Layers
    mode_layers: Layers
    idle_layers: Layers
    per_target: int = eqx.field(static=True)

    def modes(self, observation: Observation) -> Modes:
        """The mixture of n per_target + 1 modes; those of padding have no weight."""
        targets, context = self.encoder(observation)
        context = apply_relu(self.context_layers, context)
        both = jnp.concatenate([targets, jnp.broadcast_to(context, (len(targets), len(context)))], axis=-1)
        hidden = apply_relu(self.mode_layers[:-1], both)
        numbers = jax.vmap(self.mode_layers[-1])(hidden).reshape(len(targets), self.per_target, -1)
        (idle,) = self.idle_layers
        log_weight = jnp.where(observation.present[:, None], numbers[..., 0], PADDING_LOG_WEIGHT)
        raw, last = numbers[..., 1:].reshape(log_weight.size, -1), idle(context)
        action = jnp.tanh(jnp.concatenate([raw, last[None, 1:]]))
        return Modes(jnp.append(log_weight.ravel(), last[0]), action)

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """Deterministic: the action of the mode with the largest weight."""
        modes = self.modes(observation)
        return modes.action[jnp.argmax(modes.log_weight)], memory
