"""What "looked there and saw nothing" says of a target: its Gaussian belief, given that it is outside of the view.

The Kalman filter as published learns only from measurements. But a target is not measured because it is outside of the
view, and a belief that reaches into the view then claims too much. What is left of the Gaussian is no Gaussian; the one
with the same mean and covariance takes its place (moment matching, as in assumed-density filtering).
"""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.special import ndtri

from foveate.linalg import cholesky_spd, inverse_spd, multiply, symmetrise
from foveate.models.belief import Belief
from foveate.types import Point

IsInside = Callable[[Float[Array, "points d"]], Bool[Array, " points"]]
POINTS = 256
"""Positions that stand for a belief."""
LEAST_OUTSIDE = 0.02
"""Where less of a belief than that is outside of the view, the belief itself was wrong: it stays as it is."""


def standard_points(dimension: int, count: int = POINTS) -> Float[np.ndarray, "count d"]:
    """Points that stand for N(0, I), spread evenly; their mean is 0 and their covariance I, to rounding.

    The additive recurrence on the powers of the generalised golden ratio, g^(d + 1) = g + 1 (Roberts 2018), through the
    inverse of the normal distribution function, and then whitened.
    """
    ratio = max(np.roots([1.0, *[0.0] * (dimension - 1), -1.0, -1.0]).real)
    steps = ratio ** -np.arange(1.0, dimension + 1)
    points = ndtri((0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0)
    points -= points.mean(axis=0)
    return np.linalg.solve(np.linalg.cholesky(points.T @ points / count), points.T).T


def given_unseen(belief: Belief, Z: Float[Array, "d n_y"], is_inside: IsInside) -> Belief:
    """The Gaussian with mean and covariance of N(mu, C) given that the position Z y is not inside, as `is_inside` says
    of positions in the world [m].

    Position p = Z y has mean m = Z mu and covariance S = Z C Z^T, on which the rest of the state depends by
    G = C Z^T S^-1. With the moments m', S' of p outside, mu' = mu + G (m' - m) and C' = C + G (S' - S) G^T.
    """
    covariance = inverse_spd(belief.information)
    cross = multiply(covariance, Z.T)
    spread = symmetrise(multiply(Z, cross))
    middle = Z @ belief.mean
    points: Float[Array, "points d"] = middle + jnp.asarray(standard_points(len(Z)), float) @ cholesky_spd(spread).T
    outside = ~is_inside(points)
    share = jnp.mean(outside)
    says_something = (share < 1.0) & (share >= LEAST_OUTSIDE)
    moved, left = _moments(points, outside)
    gain = multiply(cross, inverse_spd(spread))
    shrunk = covariance + multiply(multiply(gain, left - spread), gain.T)
    safe = symmetrise(jnp.where(says_something, shrunk, covariance))
    return Belief(
        mean=jnp.where(says_something, belief.mean + gain @ (moved - middle), belief.mean),
        information=jnp.where(says_something, inverse_spd(safe), belief.information),
    )


def _moments(points: Float[Array, "points d"], chosen: Bool[Array, " points"]) -> tuple[Point, Float[Array, "d d"]]:
    """Mean and covariance of the chosen points; of none, zeros."""
    weights = chosen / jnp.maximum(jnp.sum(chosen), 1)
    mean = weights @ points
    apart = points - mean
    return mean, multiply(apart.T, weights[:, None] * apart)
