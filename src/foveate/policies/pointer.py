"""Pointer policy: proposes a few actions for every target, and takes the one of the largest weight.

A network with a single action answers two equally good targets with the mean of both, which leads to neither. This one
is a mixture (Vinyals 2015, "Pointer Networks"; Bishop 1994, "Mixture Density Networks") on targets encoded as a set
(Zaheer 2017, Lee 2019). A learner samples among its modes, and so explores which target comes next.

Aiming is given, deciding is learned: the first mode of a target is the steering law towards it plus a learned
correction, and the first weights are those of a heuristic. So the untrained policy is that heuristic.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from foveate.names import Objective
from foveate.policies.layers import Layers, SetEncoder, apply_relu
from foveate.policies.places import with_places
from foveate.policies.tokens import Tokens, tokens_of
from foveate.policies.window import told_window
from foveate.simulation.records import Observation, Policy
from foveate.types import Action, Key

PADDING_LOG_WEIGHT = -1e9
"""Log weight of the modes of padding: probability 0, but finite, so that derivatives are finite."""

FREE_LOG_WEIGHT = -4.0
"""First log weight of modes that do not aim, relative to the best that does: explored, but rarely."""

PREFERENCE = (1.0, 0.5)
"""First preference: log weight lost for each nat of log det, and for each step until the target is in view."""

LARGEST_CORRECTION = 2.0
"""Largest correction of an aimed action: the whole range of an axis."""

NO_LIMIT = 1e6
"""More than any feature, and finite, as norms of all weights are to be."""


class Modes(NamedTuple):
    """A mixture: log weight of each mode, not normalised, and its action on every axis of the twist.

    Beyond [-1, 1] the agent's limits hold.
    """

    log_weight: Float[Array, " modes"]
    action: Float[Array, "modes n_u"]


class PointerPolicy(Policy):
    """Modes of every target from its embedding and the context, and an idle mode from the context alone."""

    encoder: SetEncoder
    context_layers: Layers
    by_target: eqx.nn.Linear
    by_context: eqx.nn.Linear
    mode_layer: eqx.nn.Linear
    idle_layer: eqx.nn.Linear
    preference: Float[Array, " measures"]
    per_target: int = eqx.field(static=True)
    objective: Objective = eqx.field(static=True)
    tells_time: bool = eqx.field(static=True)
    tells_team: bool = eqx.field(static=True, default=False)
    rays: int = eqx.field(static=True, default=0)
    searches: bool = eqx.field(static=True, default=False)
    window_log_weight: Float[Array, " 1"] | None = None
    feature_range: Float[Array, "2 features"] | None = None

    def start(self, observation: Observation) -> Any:
        """The robot's claims: none for any target; without a team nothing."""
        return jnp.zeros_like(observation.mean[:, 0]) if self.claims_in(observation) else ()

    def claims_in(self, observation: Observation) -> bool:
        """True for a robot of a team: alone, as on a robot of its own, it has no claims."""
        return self.tells_team and observation.team is not None

    def claims(self, observation: Observation, memory: Any) -> Float[Array, " n"]:
        """1 for the target that the robot goes for."""
        return memory if self.claims_in(observation) else super().claims(observation, memory)

    def shown(self, observation: Observation, memory: Any) -> tuple[Observation, Any]:
        """What of an observation it decides on, and its memory of that: here all."""
        return observation, memory

    def claimed(self, observation: Observation, memory: Any, mode: Int[Array, ""]) -> Any:
        """The memory after a decision for a mode on what was `shown`."""
        del memory
        if not self.claims_in(observation):
            return ()
        targets = jnp.arange(observation.mean.shape[0])
        return (mode // self.per_target == targets).astype(observation.mean.dtype)

    def tokens(self, observation: Observation) -> Tokens:
        """What the network is told of an observation."""
        tokens = self._tokens(observation)
        if self.feature_range is None:
            return tokens
        features = jnp.clip(tokens.features, *jax.lax.stop_gradient(self.feature_range))
        return tokens._replace(features=jnp.where(tokens.present[:, None], features, 0.0))

    def _tokens(self, observation: Observation) -> Tokens:
        if not self.searches:
            tokens = tokens_of(observation, self.objective, self.tells_time, self.tells_team, self.rays)
            return tokens if self.window_log_weight is None else told_window(tokens, observation, self.tells_time)
        searched = with_places(observation)
        told = self.objective, self.tells_time, self.tells_team, self.rays
        # All the way, as the look-ahead goes: there may be nothing to keep in view.
        return searched.told(tokens_of(searched.observation, *told, standoff=0.0))

    def modes(self, tokens: Tokens) -> Modes:
        """The mixture of n per_target + 1 modes, or one more with the window; those of padding have no weight."""
        targets, context = self.encoder(tokens)
        context = apply_relu(self.context_layers, context)
        # A layer on [target, context] is the sum of one on each: that of the context is computed once.
        hidden = jax.nn.relu(jax.vmap(self.by_target)(targets) + self.by_context(context))
        # Sizes by name: there may be no target at all.
        axes = len(tokens.unit)
        numbers = jax.vmap(self.mode_layer)(hidden).reshape(targets.shape[0], self.per_target, 1 + axes)
        idle = self.idle_layer(context)

        first = -tokens.urgency @ self.preference
        best = jnp.max(first, initial=-jnp.inf, where=tokens.present)
        first = first - jnp.where(jnp.isfinite(best), best, 0.0)
        free = jnp.full((first.shape[0], self.per_target - 1), FREE_LOG_WEIGHT)
        log_weight = numbers[..., 0] + jnp.concatenate([first[:, None], free], axis=-1)
        log_weight = jnp.where(tokens.present[:, None], log_weight, PADDING_LOG_WEIGHT)
        # Corrections in units of the view, added after the law's own limits so that none is lost at them.
        aimed = tokens.aim + LARGEST_CORRECTION * jnp.tanh(numbers[:, 0, 1:] * tokens.unit)
        actuated = tokens.unit > 0
        free, rest = (jnp.where(actuated, jnp.tanh(x), 0.0) for x in (numbers[:, 1:, 1:], idle[None, 1 : 1 + axes]))
        action = jnp.concatenate([aimed[:, None], free], axis=1).reshape(log_weight.size, axes)
        log_weights = jnp.append(log_weight.ravel(), idle[0] + FREE_LOG_WEIGHT)
        modes = Modes(log_weights, jnp.concatenate([action, rest]))
        if self.window_log_weight is None or tokens.window is None:
            return modes
        weight, correction = idle[1 + axes] + self.window_log_weight[0], idle[2 + axes :]
        proposed = tokens.window + LARGEST_CORRECTION * jnp.tanh(correction * tokens.unit)
        return Modes(jnp.append(modes.log_weight, weight), jnp.concatenate([modes.action, proposed[None]]))

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """Deterministic: the action of the mode with the largest weight."""
        observation, memory = self.shown(observation, memory)
        modes = self.modes(self.tokens(observation))
        mode = jnp.argmax(modes.log_weight)
        return command(observation, modes.action[mode]), self.claimed(observation, memory, mode)


def command(observation: Observation, action: Float[Array, " n_u"]) -> Action:
    """The action on the robot's own axes, within [-1, 1]."""
    assert observation.robot is not None, "tokens_of rejects others"
    return jnp.clip(jnp.stack([action[axis] for axis in observation.robot.problem.agent.axes]), -1.0, 1.0)
