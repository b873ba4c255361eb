"""GOSPA: one number for errors of position, missed targets and false tracks (Rahmathullah et al. 2017), with its parts.

With p = 2 and alpha = 2, GOSPA^2 = min over pairings of the sum of d^2 over pairs nearer than c, and c^2 / 2 for every
target and every track without a partner. It is not divided by any number of targets.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment


class Gospa(NamedTuple):
    """GOSPA and its parts [m], each after the root: gospa^2 = localisation^2 + missed^2 + false^2."""

    gospa: float
    localisation: float
    missed: float
    false: float


def gospa(estimates: Float[np.ndarray, "e d"], targets: Float[np.ndarray, "t d"], c_m: float) -> Gospa:
    """GOSPA with p = 2 and alpha = 2 between estimated and true positions [m], at the distance c [m]."""
    rows, columns = pairs(estimates, targets, c_m)
    near = ((estimates[rows] - targets[columns]) ** 2).sum()
    alone = 0.5 * c_m**2 * (len(targets) - len(rows)), 0.5 * c_m**2 * (len(estimates) - len(rows))
    parts = near, *alone
    return Gospa(*np.sqrt([sum(parts), *parts]).tolist())


def pairs(
    estimates: Float[np.ndarray, "e d"], targets: Float[np.ndarray, "t d"], c_m: float
) -> tuple[Int[np.ndarray, " pairs"], Int[np.ndarray, " pairs"]]:
    """Estimates and targets, by their numbers, that GOSPA pairs: nearer to each other than c [m]."""
    apart = ((estimates[:, None] - targets) ** 2).sum(axis=-1)
    rows, columns = linear_sum_assignment(np.minimum(apart, c_m**2))
    near = apart[rows, columns] < c_m**2
    return rows[near], columns[near]


def mean_gospa(
    position: Float[np.ndarray, "K n d"],
    is_reported: Bool[np.ndarray, "K n"],
    target: Float[np.ndarray, "K t d"],
    is_alive: Bool[np.ndarray, "K t"],
    c_m: float,
) -> Gospa:
    """Means over the steps of GOSPA and of each of its parts [m]; padding is neither reported nor alive."""
    steps = zip(position, is_reported, target, is_alive, strict=True)
    each = [gospa(estimate[reported], truth[alive], c_m) for estimate, reported, truth, alive in steps]
    return Gospa(*np.mean(each, axis=0).tolist())
