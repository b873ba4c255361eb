"""Fusion of what several robots know of one target, batched over targets and robots by `vmap`.

Measurements of different robots have independent noise: their information adds up, each counted once. Beliefs that may
share information of unknown extent are fused by covariance intersection, which is never overconfident (Julier &
Uhlmann 1997).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.linalg import inverse_spd, log_det_spd, symmetrise
from foveate.models.belief import Belief
from foveate.types import Information, Mean, Scalar

WEIGHTS = 16
"""Covariance intersection tries the weights 0, 1/16, .., 1: any is consistent, and the best one's maximum is flat."""


class Evidence(NamedTuple):
    """What measurements of one step say of one target: `gain` H^T V^-1 H, and `pull` H^T V^-1 (z - H reference).

    `growth` is what each level of the protocol counts of their information; with real measurements only, `gain`.
    The `reference` is any state near the target, the same for all robots: sums about it keep their digits in float32.
    """

    gain: Float[Array, "*b n_y n_y"]
    pull: Float[Array, "*b n_y"]
    growth: Float[Array, "*b levels n_y n_y"]


def evidence_of(
    prediction: Belief,
    gain: Information,
    growth: Float[Array, "levels n_y n_y"],
    corrected: Mean,
    reference: Mean,
) -> Evidence:
    """The evidence that has led from a prediction to the mean `corrected`, about a reference.

    H^T V^-1 (z - H p) = (P + gain) (mu - p), whatever filter has found mu.
    """
    pull = (prediction.information + gain) @ (corrected - prediction.mean)
    return Evidence(gain, pull + gain @ (prediction.mean - reference), growth)


def linear_pull(
    H: Float[Array, "n_z n_y"], V: Float[Array, "n_z n_z"], measurement: Float[Array, " n_z"], reference: Mean
) -> Mean:
    """H^T V^-1 (z - H reference) of a linear measurement with the covariance V."""
    return H.T @ (inverse_spd(V) @ (measurement - H @ reference))


def corrected_by(prediction: Belief, evidence: Evidence, reference: Mean) -> Mean:
    """mu = p + (P + gain)^-1 H^T V^-1 (z - H p), the Kalman filter's mean after all this evidence."""
    pull = evidence.pull - evidence.gain @ (prediction.mean - reference)
    return prediction.mean + inverse_spd(prediction.information + evidence.gain) @ pull


def covariance_intersection(own: Belief, other: Belief) -> Belief:
    """Y = (1 - w) Y_1 + w Y_2, Y mu = (1 - w) Y_1 mu_1 + w Y_2 mu_2, with the weight of the largest det Y."""
    return weighted_intersection(own, other)[0]


def weighted_intersection(own: Belief, other: Belief) -> tuple[Belief, Scalar]:
    """`covariance_intersection`, and the weight w of the other; 0 of equal beliefs."""
    weights = jnp.linspace(0.0, 1.0, WEIGHTS + 1, dtype=own.mean.dtype)[:, None, None]
    # The other's share is added to what is equal in both, so that equal beliefs stay as they are.
    candidates = own.information + weights * (other.information - own.information)
    worth = log_det_spd(candidates)
    best = jnp.argmax(jnp.where(jnp.isfinite(worth), worth, -jnp.inf))
    information = symmetrise(candidates[best])
    step = other.information @ (other.mean - own.mean)
    weight = weights[best, 0, 0]
    return Belief(own.mean + weight * (inverse_spd(information) @ step), information), weight
