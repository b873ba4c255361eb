"""The Kalman filter of one target in information form (paper, section 2), batched over targets by `vmap`."""

import math
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from foveate.geometry.linalg import inverse_spd, inverse_upper, multiply, root_semidefinite, symmetrise
from foveate.models.target import LinearGaussian
from foveate.types import Information, Mean


class Belief(eqx.Module):
    """A Gaussian over one target's state: its mean and its *information* matrix, the inverse of the covariance."""

    mean: Mean
    information: Information


def predict_information(information: Information, motion: LinearGaussian) -> Information:
    """P' = (A Y^-1 A^T + W)^-1; exact for singular A too, as long as A Y^-1 A^T + W is not singular."""
    return _predict(motion.is_reversible, information, motion.A, motion.W)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _predict(
    is_reversible: bool, information: Information, A: Float[Array, "n_y n_y"], W: Float[Array, "n_y n_y"]
) -> Information:
    return (_predict_by_reversal if is_reversible else _predict_by_inverses)(information, A, W)[0]


def _predict_by_inverses(information, A, W):
    """P' and G = P' A Y^-1."""
    product = multiply(A, inverse_spd(information))
    prediction = symmetrise(inverse_spd(symmetrise(multiply(product, A.T) + W)))
    return prediction, multiply(prediction, product)


def _predict_by_reversal(information, A, W):
    """P' = M - N (I + R^T M R)^-1 N^T with M = A^-T Y A^-1, N = M R and R R^T = W (Woodbury), and G = P' A Y^-1.

    No inverse of the information: of a target that was measured once, and whose velocity is unknown, that has lost most
    digits of float32, and the inverse of the covariance loses them again at every step.
    """
    n_y, inverse_A, root_W = len(A), inverse_upper(A), root_semidefinite(W)
    # M, N and R^T M R as blocks of one congruence: two large products for all beliefs, where small ones, which XLA
    # fuses and so repeats for every element that reads them, take up to ten times as long.
    both = jnp.concatenate([inverse_A, multiply(inverse_A, root_W)], axis=1)
    half = jnp.matmul(information, both, precision="highest")
    blocks = jnp.matmul(half.T, both, precision="highest")
    moved, noisy, spread = blocks[:n_y, :n_y], blocks[:n_y, n_y:], blocks[n_y:, n_y:]
    gain = multiply(noisy, inverse_spd(symmetrise(spread) + jnp.eye(n_y, dtype=A.dtype)))
    prediction = symmetrise(moved - multiply(gain, noisy.T))
    return prediction, inverse_A.T - multiply(gain, multiply(inverse_A, root_W).T)


def _predict_jvp(is_reversible, primals, tangents):
    """dP' = G dY G^T with G = P' A Y^-1, and -(2 sym(P' dA G^T) + P' dW P') where the motion is differentiated too.

    Two products where the chain rule through both inverses needs six.
    """
    prediction, gain = (_predict_by_reversal if is_reversible else _predict_by_inverses)(*primals)
    d_information, d_A, d_W = tangents
    change = jnp.zeros_like(prediction)
    if not isinstance(d_information, SymbolicZero):
        change += multiply(jax.lax.optimization_barrier(multiply(gain, d_information)), gain.T)
    if not isinstance(d_A, SymbolicZero):
        moved = multiply(multiply(prediction, d_A), gain.T)
        change -= moved + moved.T
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
