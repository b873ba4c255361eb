"""Marginal probabilities of association by loopy belief propagation (Williams & Lau 2014).

Each track has produced at most one detection of a scan, each detection comes from one track or from none. The sum over
all ways to assign them grows exponentially; messages between tracks and detections give its marginals to about 1e-2,
and exactly where the graph of possible pairs has no loops.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

ITERATIONS = 20
"""Number of exchanges of messages: fixed, so that the program can be batched and differentiated."""
LEAST = 1e-12
"""Least weight of a missed detection, and of a detection without a track: 0 would have no finite message."""


class Association(NamedTuple):
    """Marginal probabilities: track i missed, track i and detection j of one target, detection j of no track."""

    missed: Float[Array, " n"]
    pair: Float[Array, "n m"]
    unclaimed: Float[Array, " m"]


def associate(
    missed: Float[Array, " n"],
    pair: Float[Array, "n m"],
    unclaimed: Float[Array, " m"],
    iterations: int = ITERATIONS,
) -> Association:
    """Marginals of all assignments, whose probability is proportional to the product of the weights of their parts.

    Messages mu_ij = w_ij / (w_i0 + sum_{j' != j} w_ij' nu_ij') and nu_ij = 1 / (e_j + sum_{i' != i} mu_i'j); then
    p_i0 ~ w_i0, p_ij ~ w_ij nu_ij, and detection j is of no track with probability e_j / (e_j + sum_i mu_ij).

    Args:
        missed: w_i0 of every track.
        pair: w_ij [density of a detection].
        unclaimed: e_j of every detection, false alarm or new target [density of a detection].
        iterations: Number of exchanges.
    """
    # In units of a detection's own weight, so that all messages are of order 1 whatever the unit of its density.
    unit = unclaimed + jnp.sum(pair, axis=0)
    unit = jnp.where(unit > 0, unit, 1.0)
    w, e, w0 = pair / unit, jnp.maximum(unclaimed / unit, LEAST), jnp.maximum(missed, LEAST)[:, None]

    def to_detections(nu: Float[Array, "n m"]) -> Float[Array, "n m"]:
        weighed = w * nu
        return w / (w0 + jnp.maximum(jnp.sum(weighed, axis=1, keepdims=True) - weighed, 0.0))

    def to_tracks(mu: Float[Array, "n m"]) -> Float[Array, "n m"]:
        return 1.0 / (e + jnp.maximum(jnp.sum(mu, axis=0) - mu, 0.0))

    def exchange(nu: Float[Array, "n m"], _: None) -> tuple[Float[Array, "n m"], None]:
        return to_tracks(to_detections(nu)), None

    nu, _ = jax.lax.scan(exchange, jnp.ones_like(w), None, length=iterations)
    weighed = w * nu
    total = w0[:, 0] + jnp.sum(weighed, axis=1)
    free = e / (e + jnp.sum(to_detections(nu), axis=0))
    return Association(w0[:, 0] / total, weighed / total[:, None], free)
