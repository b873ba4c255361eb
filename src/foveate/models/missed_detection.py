"""Missed detections as negative information: the Gaussian belief about a target, given that it is outside of the view.

The published Kalman filter learns only from measurements. But a target that is not measured is outside of the view, and
a belief that reaches into the view claims too much. The rest of the Gaussian is no Gaussian; the one with the same mean
and covariance takes its place (moment matching, as in assumed-density filtering).

That puts mass back into the view. The next look must not cut it out again: the same information would count as often
as there are looks, and the belief would shrink without bound. So a look cuts only ground that the previous look did
not show without a detection; what a target may have entered meanwhile is left to the process noise.
"""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.special import ndtri

from foveate.geometry.linalg import cholesky_spd, inverse_spd, multiply, symmetrise
from foveate.models.belief import Belief
from foveate.types import Point

IsInside = Callable[[Float[Array, "points d"]], Bool[Array, " points"]]

POINTS = 256
"""Number of positions that represent a belief."""

PROPOSAL_STD = 1.5
"""Standard deviation of these points, in those of the belief: after a miss, what remains of it lies in its tails."""

MIN_OUTSIDE = 0.05
"""With a smaller probability of being outside of the view, the belief itself must be wrong, and is kept."""


def standard_points(
    dimension: int, count: int = POINTS
) -> tuple[Float[np.ndarray, "count d"], Float[np.ndarray, " count"]]:
    """Points and weights that represent N(0, I); their weights sum to 1, their mean is 0 and their covariance I.

    The additive recurrence on the powers of the generalised golden ratio, g^(d + 1) = g + 1 (Roberts 2018), through the
    inverse of the normal distribution function, with standard deviation `PROPOSAL_STD`, weighed by the
    ratio of the densities (importance sampling), then whitened.
    """
    ratio = max(np.roots([1.0, *[0.0] * (dimension - 1), -1.0, -1.0]).real)
    steps = ratio ** -np.arange(1.0, dimension + 1)
    normal = ndtri((0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0)
    weights = np.exp((1.0 - PROPOSAL_STD**2) / 2.0 * np.sum(normal**2, axis=1))
    weights /= weights.sum()
    points = normal - weights @ normal
    return np.linalg.solve(np.linalg.cholesky(points.T @ (weights[:, None] * points)), points.T).T, weights


def condition_on_missed_detection(belief: Belief, Z: Float[Array, "d n_y"], is_inside: IsInside) -> Belief:
    """The Gaussian with the mean and covariance of N(mu, C) given that the position Z y is outside of the view.

    `is_inside` tests world positions [m]. Position p = Z y has mean m = Z mu and covariance S = Z C Z^T; the rest of
    the state depends on it by G = C Z^T S^-1. With the moments m', S' of p outside, mu' = mu + G (m' - m) and
    C' = C + G (S' - S) G^T.
    """
    covariance = inverse_spd(belief.information)
    cross = multiply(covariance, Z.T)
    position_covariance = symmetrise(multiply(Z, cross))
    # An axis along which the position is known for certain, as the height of a target on the floor: the points do not
    # spread along it, and a variance of 1 in place of 0 only makes the inverse below exist.
    certain = jnp.diagonal(position_covariance) <= 0.0
    middle = Z @ belief.mean
    standard, weights = (jnp.asarray(numbers, float) for numbers in standard_points(len(Z)))
    points: Float[Array, "points d"] = middle + standard @ cholesky_spd(position_covariance).T
    inside = is_inside(points)
    weights = jnp.where(inside, 0.0, weights)
    # No point inside: nothing was learned. Nearly all inside: the few points left would be a poor sample.
    is_informative = jnp.any(inside) & (jnp.sum(weights) >= MIN_OUTSIDE)
    moved, left = _moments(points, weights)
    gain = multiply(cross, inverse_spd(position_covariance + jnp.diag(certain.astype(cross.dtype))))
    shrunk = covariance + multiply(multiply(gain, left - position_covariance), gain.T)
    safe = symmetrise(jnp.where(is_informative, shrunk, covariance))
    return Belief(
        mean=jnp.where(is_informative, belief.mean + gain @ (moved - middle), belief.mean),
        information=jnp.where(is_informative, inverse_spd(safe), belief.information),
    )


def _moments(points: Float[Array, "points d"], weights: Float[Array, " points"]) -> tuple[Point, Float[Array, "d d"]]:
    """Weighted mean and covariance of the points; zeros if all weights are 0."""
    total = jnp.sum(weights)
    shares = weights / jnp.where(total > 0, total, 1.0)
    mean = shares @ points
    apart = points - mean
    return mean, multiply(apart.T, shares[:, None] * apart)
