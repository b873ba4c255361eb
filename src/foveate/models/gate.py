"""Chi-square gate: rejects measurements that contradict a belief, up to several in a row.

The squared Mahalanobis distance of a correct measurement to its prediction is chi-square with as many degrees of
freedom as it has numbers (Bar-Shalom, Li & Kirubarajan 2001, section 5.4).
"""

import jax.numpy as jnp
from jaxtyping import Array, Float
from scipy.special import gammaincinv

from foveate.geometry.linalg import inverse_spd, multiply, symmetrise
from foveate.io.validate import require
from foveate.models.belief import Belief
from foveate.types import Information

RESTART_AFTER = 5
"""After this number of rejections in a row the target must have jumped: the belief restarts from the last one."""


def gate_limit(probability: float | None, size: int) -> float | None:
    """Largest squared distance that passes, for measurements of `size` numbers; None where all pass.

    Raises InputError unless `probability` is between 0 and 1, or None.
    """
    if probability is None:
        return None
    require(0 < probability < 1, "gate", probability, "expected a probability between 0 and 1, or None")
    # The quantile of chi-square; scipy.stats, which has it by name, takes half a second to import.
    return 2.0 * float(gammaincinv(size / 2.0, probability))


def squared_distance(
    prediction: Belief, measurement: Float[Array, " n_z"], H: Float[Array, "n_z n_y"], V: Float[Array, "n_z n_z"]
) -> Float[Array, ""]:
    """(z - H p)^T (H P^-1 H^T + V)^-1 (z - H p), P the predicted information."""
    innovation = measurement - H @ prediction.mean
    innovation_covariance = symmetrise(multiply(H, multiply(inverse_spd(prediction.information), H.T)) + V)
    return innovation @ inverse_spd(innovation_covariance) @ innovation


def one_point(
    first_information: Information,
    measurement: Float[Array, " n_z"],
    H: Float[Array, "n_z n_y"],
    V: Float[Array, "n_z n_z"],
) -> Belief:
    """Belief from one measurement: N(z, V) in the measured part of the state, the initial belief (about 0) in the rest.

    Mean H^+ z, covariance H^+ V H^+T + N Y_0^-1 N^T with N = I - H^+ H.
    """
    back = jnp.linalg.pinv(H)
    rest = jnp.eye(H.shape[1], dtype=H.dtype) - multiply(back, H)
    covariance = multiply(multiply(back, V), back.T) + multiply(multiply(rest, inverse_spd(first_information)), rest.T)
    return Belief(back @ measurement, inverse_spd(symmetrise(covariance)))
