"""The Kalman filter of one target in information form (paper, section 2), batched over targets by `vmap`."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.linalg import inverse_spd, multiply, symmetrise
from foveate.models.target import LinearGaussian
from foveate.types import Information, Mean


class Belief(eqx.Module):
    """A Gaussian over one target's state: its mean and its *information* matrix, the inverse of the covariance."""

    mean: Mean
    information: Information


def predict_information(information: Information, motion: LinearGaussian) -> Information:
    """P' = (A Y^-1 A^T + W)^-1; exact for singular A too, as long as A Y^-1 A^T + W is not singular."""
    covariance = multiply(multiply(motion.A, inverse_spd(information)), motion.A.T) + motion.W
    return symmetrise(inverse_spd(symmetrise(covariance)))


def update_information(prediction: Information, gain: Information, weight: Float[Array, ""]) -> Information:
    """Y = P + weight `gain`, `gain` = H^T V^-1 H; weight 1 or 0 for a real sensor, between them for a soft one."""
    return prediction + weight * gain


def correct_mean(
    prediction: Belief,
    measurement: Float[Array, " n_z"],
    H: Float[Array, "n_z n_y"],
    V: Float[Array, "n_z n_z"],
) -> Mean:
    """mu = p + K (z - H p), K = P^-1 H^T (H P^-1 H^T + V)^-1, P the *predicted* information."""
    cross = multiply(inverse_spd(prediction.information), H.T)
    innovation = symmetrise(multiply(H, cross) + V)
    gain = multiply(cross, inverse_spd(innovation))
    return prediction.mean + gain @ (measurement - H @ prediction.mean)


def entropy(log_det: Float[Array, "*b"], state_size: int) -> Float[Array, "*b"]:
    """Differential entropy [nat] of a Gaussian, from its information's log det: n_y/2 log(2 pi e) - log det / 2."""
    return 0.5 * (state_size * jnp.log(2 * jnp.pi * jnp.e) - log_det)
