"""What one episode, or many, say of a method and of its filter: shares seen, errors, and whether the filter is honest.

An error is honest where the filter claims it: NEES, e^T Y e, is then chi-square with as many degrees of freedom as the
state has numbers (Bar-Shalom, Li & Kirubarajan 2001, section 5.4).
"""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from foveate.models.belief import entropy
from foveate.models.problem import Problem
from foveate.scenario.scenes import Scene
from foveate.simulation.records import Trace

Z95 = 1.959963984540054


SPLITS = ("rmse_seen_m", "rmse_unseen_m", "nees_seen", "nees_unseen")
"""Errors of the targets that were measured at least once, and of the others."""


def measures(
    problem: Problem, trace: Trace, truth: Float[np.ndarray, "instants n n_y"], scene: Scene
) -> dict[str, Any]:
    """The measures of an `evaluation.Row` of one episode, padded or not."""
    n, K, n_y = len(scene.targets), scene.horizon, problem.motion.state_size
    if n == 0:
        nothing = dict.fromkeys(("seen_fraction", "seen_step_fraction", "longest_unseen_s", "rmse_m", "nees"), 0.0)
        return {"score": None, "entropy": None, **nothing, **dict.fromkeys(SPLITS)}
    visible, log_det = np.asarray(trace.visible[:K, :n]), np.asarray(trace.log_det[K - 1, :n], float)
    seen = np.any(visible, axis=0)
    error = np.asarray(trace.mean[K, :n], float) - np.asarray(truth[K, :n], float)
    square = ((error @ np.asarray(problem.motion.Z, float).T) ** 2).sum(axis=1)
    nees = np.einsum("ni,nij,nj->n", error, trace.information[K, :n].astype(float), error)
    return {
        "score": float(log_det.mean()),
        "entropy": float(np.mean(entropy(jnp.asarray(log_det), n_y))),
        "seen_fraction": float(seen.mean()),
        "seen_step_fraction": float(visible.mean()),
        "longest_unseen_s": float(longest_run(~visible, problem.step_lengths_s(K)).max()),
        "rmse_m": float(np.sqrt(square.mean())),
        "nees": float(nees.mean()),
        **splits(square, nees, np.asarray(seen)),
    }


def splits(
    square_error: Float[np.ndarray, " values"], nees: Float[np.ndarray, " values"], seen: Bool[np.ndarray, " values"]
) -> dict[str, float | None]:
    """RMSE [m] and mean NEES of the values of targets that were seen, and of the others; None where there are none."""

    def of(group: Bool[np.ndarray, " values"]) -> tuple[float | None, float | None]:
        if not group.any():
            return None, None
        return float(np.sqrt(square_error[group].mean())), float(nees[group].mean())

    (rmse_seen, nees_seen), (rmse_unseen, nees_unseen) = of(seen), of(~seen)
    return dict(zip(SPLITS, (rmse_seen, rmse_unseen, nees_seen, nees_unseen), strict=True))


def longest_run(flags: Bool[np.ndarray, "K n"], lengths: Float[np.ndarray, " K"]) -> Float[np.ndarray, " n"]:
    """The longest run of true values in each column; each row is as long as `lengths` says."""
    longest = current = np.zeros(flags.shape[1])
    for row, length in zip(flags, lengths, strict=True):
        current = np.where(row, current + length, 0.0)
        longest = np.maximum(longest, current)
    return longest


def chi_square_band(dof: int, count: float | int) -> tuple[float, float]:
    """The interval that holds 95 % of means of `count` chi-square variables (Wilson and Hilferty 1931)."""
    total = dof * count
    spread = 2.0 / (9.0 * total)
    low, high = (dof * max(0.0, 1.0 - spread + sign * Z95 * math.sqrt(spread)) ** 3 for sign in (-1.0, 1.0))
    return low, high
