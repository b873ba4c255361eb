"""Score an episode from a value of each target after every step."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.simulation.records import Episode, per_target
from foveate.types import Scalar


def step_scores(values: Float[Array, "K n"], episode: Episode) -> Float[Array, " K"]:
    """Mean of the targets' values after every step."""
    arrivals = episode.arrivals
    # A target that appears in this step is not measured yet.
    present = episode.present if arrivals is None else arrivals.present[1:] & arrivals.present[:-1]
    return per_target(values, jnp.broadcast_to(present, values.shape))


def episode_score(values: Float[Array, "K n"], episode: Episode, terminal: bool) -> Scalar:
    """Mean of the targets' values after the last step (`terminal`), or over all steps."""
    score = step_scores(values, episode)
    if terminal:
        return score[episode.horizon - 1]
    return jnp.mean(score, where=jnp.arange(len(score)) < episode.horizon)
