"""The Kalman filter of one target in information form (paper, section 2), batched over targets by `vmap`."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from foveate.geometry.linalg import inverse_spd, multiply, symmetrise
from foveate.models.target import LinearGaussian
from foveate.types import Information, Mean


class Belief(eqx.Module):
    """A Gaussian over one target's state: its mean and its *information* matrix, the inverse of the covariance."""

    mean: Mean
    information: Information


def predict_information(information: Information, motion: LinearGaussian) -> Information:
    """P' = (A Y^-1 A^T + W)^-1; exact for singular A too, as long as A Y^-1 A^T + W is not singular."""
    return _predict(information, motion.A, motion.W)


@jax.custom_jvp
def _predict(information: Information, A: Float[Array, "n_y n_y"], W: Float[Array, "n_y n_y"]) -> Information:
    return _predicted(information, A, W)[0]


def _predicted(information, A, W):
    """P' and A Y^-1."""
    product = multiply(A, inverse_spd(information))
    return symmetrise(inverse_spd(symmetrise(multiply(product, A.T) + W))), product


def _predict_jvp(primals, tangents):
    """dP' = G dY G^T with G = P' A Y^-1, and -P' (2 sym(dA Y^-1 A^T) + dW) P' where the motion is differentiated too.

    Two products where the chain rule through both inverses needs six.
    """
    prediction, product = _predicted(*primals)
    d_information, d_A, d_W = tangents
    change = jnp.zeros_like(prediction)
    if not isinstance(d_information, SymbolicZero):
        gain = multiply(prediction, product)
        change += multiply(jax.lax.optimization_barrier(multiply(gain, d_information)), gain.T)
    if not isinstance(d_A, SymbolicZero):
        moved = multiply(d_A, product.T)
        change -= multiply(multiply(prediction, moved + moved.T), prediction)
    if not isinstance(d_W, SymbolicZero):
        change -= multiply(multiply(prediction, d_W), prediction)
    return prediction, symmetrise(change)


_predict.defjvp(_predict_jvp, symbolic_zeros=True)


def update_information(prediction: Information, gain: Information, weight: Float[Array, ""]) -> Information:
    """Y = P + weight `gain`, `gain` = H^T V^-1 H; weight 1 or 0 for a real sensor, between them for a soft one."""
    return prediction + weight * gain


def correct_mean(
    prediction: Belief, measurement: Float[Array, " n_z"], H: Float[Array, "n_z n_y"], V: Float[Array, "n_z n_z"]
) -> Mean:
    """mu = p + K (z - H p), K = P^-1 H^T (H P^-1 H^T + V)^-1, P the *predicted* information."""
    cross = multiply(inverse_spd(prediction.information), H.T)
    innovation = symmetrise(multiply(H, cross) + V)
    gain = multiply(cross, inverse_spd(innovation))
    return prediction.mean + gain @ (measurement - H @ prediction.mean)


def entropy(log_det: float, state_size: int) -> float:
    """Differential entropy [nat] of a Gaussian, from its information's log det: n_y/2 log(2 pi e) - log det / 2."""
    return 0.5 * (state_size * math.log(2 * math.pi * math.e) - log_det)
