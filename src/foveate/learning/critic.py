"""The critic of the actor-critic, and what it makes of trajectories: advantages, returns, samples to learn from."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.experiment.learners import ActorCriticSettings
from foveate.learning.trajectories import Trajectory, advantages
from foveate.policies.layers import Layers, SetEncoder, apply_relu, fresh_layers
from foveate.policies.tokens import Tokens, padded
from foveate.types import Key, Scalar

CRITIC_WIDTH, CRITIC_QUERIES = 64, 4
"""Size of the critic's network."""

SCALE_MEMORY = 0.95
"""Share of the critic's scale that an iteration keeps."""


class Critic(eqx.Module):
    """Value network: the expected return of what comes after an observation.

    The network's output is in units of `std` about `mean`, running statistics of the returns in each world, so that its
    learning does not depend on their scale.
    """

    encoder: SetEncoder
    value_layers: Layers
    mean: Float[Array, " worlds"]
    std: Float[Array, " worlds"]

    def normalised(self, tokens: Tokens) -> Scalar:
        """The value in units of the running deviation, about the running mean."""
        hidden = apply_relu(self.value_layers[:-1], self.encoder(tokens)[1])
        return self.value_layers[-1](hidden)[0]

    def __call__(self, tokens: Tokens, world: int = 0) -> Scalar:
        """The value of an observation in a world, by its number [nat per target, or share of time]."""
        return self.mean[world] + self.std[world] * self.normalised(tokens)


def new_critic(features: int, key: Key, worlds: int = 1) -> Critic:
    """A critic with random weights for tokens of this many features, which answers 0 until it has a scale."""
    width, pooled = CRITIC_WIDTH, CRITIC_QUERIES * CRITIC_WIDTH
    widths = ((features, width, width), (width, CRITIC_QUERIES), (pooled, width, width, 1))
    target, query, value = fresh_layers(widths, key)
    return Critic(SetEncoder(target, query), value, jnp.zeros(worlds), jnp.zeros(worlds))


class Samples(NamedTuple):
    """Steps of many episodes, in any order."""

    tokens: Tokens
    action: Float[Array, "rows n_u"]
    log_density: Float[Array, " rows"]
    advantage: Float[Array, " rows"]
    value_target: Float[Array, " rows"]
    counts: Bool[Array, " rows"]
    seen: Tokens | None = None
    """As in `Trajectory`."""


class Judged(NamedTuple):
    """Advantages and returns of all steps of a part of a batch, before they are scaled."""

    trajectory: Trajectory
    advantage: Float[Array, "episodes K"]
    target: Float[Array, "episodes K"]


def judge(
    critic: Critic, trajectory: Trajectory, settings: ActorCriticSettings, discount: float, world: int = 0
) -> Judged:
    """Estimate advantages and returns by the critic, in the world of this number."""
    seen = trajectory.tokens if trajectory.seen is None else trajectory.seen
    value = jax.vmap(jax.vmap(lambda tokens: critic(tokens, world)))(seen)
    advantage = jax.vmap(advantages, (0, 0, None, None))(trajectory, value, discount, settings.gae_lambda)
    return Judged(trajectory, advantage, advantage + value[:, :-1])


def moments(judged: Judged) -> Float[Array, "2 3"]:
    """Number, sum and sum of squares of the advantages, and of the returns, of the steps that count."""

    def of(x):
        x = jnp.where(judged.trajectory.counts, x, 0.0)
        return jnp.stack([jnp.sum(judged.trajectory.counts).astype(x.dtype), jnp.sum(x), jnp.sum(x**2)])

    return jnp.stack([of(judged.advantage), of(judged.target)])


def rescaled(critic: Critic, mean: Float[Array, " worlds"], std: Float[Array, " worlds"]) -> Critic:
    """The critic on the running scale of the returns of each world; the first returns set it."""
    kept = jnp.where(critic.std == 0.0, 0.0, SCALE_MEMORY)
    return replace(
        critic, mean=kept * critic.mean + (1 - kept) * mean, std=kept * critic.std + (1 - kept) * (std + 1e-6)
    )


def samples_of(
    judged: Judged, critic: Critic, mean: Scalar, std: Scalar, world: int = 0, targets: int | None = None
) -> Samples:
    """All steps in a world, with advantages of mean 0 and deviation 1, and returns on the critic's scale.

    Tokens are padded to this number of `targets`, if given.
    """
    trajectory = judged.trajectory
    tokens, seen = (jax.tree.map(lambda x: x[:, :-1], each) for each in (trajectory.tokens, trajectory.seen))
    samples = Samples(
        tokens if targets is None else padded(tokens, targets),
        trajectory.action,
        trajectory.log_density,
        (judged.advantage - mean) / (std + 1e-8),
        (judged.target - critic.mean[world]) / critic.std[world],
        trajectory.counts,
        seen,
    )
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), samples)
