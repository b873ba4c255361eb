"""Metrics of one episode or of many: score, shares seen, errors, and the consistency of the filter.

The errors of a consistent filter are as large as it claims: NEES, e^T Y e, is then chi-square with the state's length
as degrees of freedom (Bar-Shalom, Li & Kirubarajan 2001, section 5.4).
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from foveate.models.belief import entropy
from foveate.models.problem import Problem
from foveate.names import Objective
from foveate.scenario.scenes import Scene
from foveate.simulation.records import Trace

Z95 = 1.959963984540054

MEANINGS: dict[Objective, str] = {
    "terminal": "log det at the end [nat per target]",
    "mean": "mean log det over the steps [nat per target]",
    "seen": "share of time in view",
    "gospa": "minus the mean GOSPA over the steps [m]",
}
"""Scores by the objectives of a training, in words."""
DIGITS: dict[Objective, int] = {"terminal": 2, "mean": 2, "seen": 3, "gospa": 2}
"""Digits after the point to show them with."""


def measures(
    problem: Problem,
    trace: Trace,
    truth: Float[np.ndarray, "rows instants n n_y"],
    scenes: Sequence[Scene],
    objective: Objective | None = None,
) -> list[dict[str, Any]]:
    """Measure episodes, padded or not, each of its own scene, for their rows of an evaluation."""
    counts = np.array([len(scene.targets) for scene in scenes])
    horizons = np.array([scene.horizon for scene in scenes])
    episodes, last = np.arange(len(scenes)), horizons[:, None]
    steps, n = trace.visible.shape[1:]
    counted = (np.arange(steps) < last)[..., None] & (np.arange(n) < counts[:, None])[:, None]
    visible = np.asarray(trace.visible) & counted
    unseen_s = longest_run(np.moveaxis(counted & ~visible, 1, 0), problem.step_lengths_s(steps)).max(axis=-1)
    seen, looks = np.asarray(visible.any(axis=1)), visible.sum(axis=(1, 2))
    error = np.asarray(trace.mean[episodes, horizons], float) - np.asarray(truth[episodes, horizons], float)
    # Float32 would lose digits of e^T Y e: a well-seen target has an information of 1e3 and more.
    consistency = nees(error, np.asarray(trace.information[episodes, horizons], float))
    squared_error = squared_position_error(error, np.asarray(problem.motion.Z, float))
    log_det, n_y = np.asarray(trace.log_det[episodes, horizons - 1], float), problem.motion.state_size

    def row(i: int) -> dict[str, Any]:
        own = slice(counts[i])
        score = float(log_det[i, own].mean()) if counts[i] else None
        in_view = float(looks[i] / max(1, counts[i] * horizons[i]))
        over_steps = np.asarray(trace.log_det[i, : horizons[i], own], float)
        return {
            "score": score,
            "entropy": None if score is None else entropy(score, n_y),
            "seen_fraction": mean_or_zero(seen[i, own]),
            "seen_step_fraction": in_view,
            "longest_unseen_s": float(unseen_s[i]),
            **error_measures(squared_error[i, own], consistency[i, own], seen[i, own]),
            "objective": None if score is None else by_objective(objective, score, over_steps, in_view),
            "contacts": None if trace.contacts is None else int(trace.contacts[i, horizons[i] - 1]),
        }

    return [row(i) for i in range(len(scenes))]


def by_objective(
    objective: Objective | None, score: float, log_det: Float[np.ndarray, "K n"], in_view: float
) -> float | None:
    """Score by the objective of a training [nat per target, or share of time in view]."""
    if objective == "mean":
        return float(log_det.mean())
    return {"terminal": score, "seen": in_view}.get(objective or "")


def mean_or_zero(values: Float[np.ndarray, "*m"] | Bool[np.ndarray, "*m"]) -> float:
    """Mean, or share of true values; 0 for an empty array."""
    return float(values.sum() / max(1, values.size))


def mean_or_none(values: Float[np.ndarray, "*m"]) -> float | None:
    """Mean; None for an empty array."""
    return mean_or_zero(values) if values.size else None


def mean_log_det(log_det: Float[np.ndarray, "*m n"], present: Bool[np.ndarray, "*m n"]) -> Float[np.ndarray, "*m"]:
    """Mean log det of the information of the targets present [nat], the score so far; NaN without targets."""
    count = present.sum(axis=-1)
    total = np.where(present, log_det, 0.0).sum(axis=-1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def squared_position_error(
    error: Float[np.ndarray, "*m n_y"], Z: Float[np.ndarray, "d n_y"]
) -> Float[np.ndarray, "*m"]:
    """|Z e|^2 of errors e of states [m^2]."""
    return ((error @ Z.T) ** 2).sum(axis=-1)


def nees(error: Float[np.ndarray, "*m n_y"], information: Float[np.ndarray, "*m n_y n_y"]) -> Float[np.ndarray, "*m"]:
    """Normalised estimation error squared e^T Y e."""
    return np.einsum("...i,...ij,...j->...", error, information, error)


def error_measures(
    squared_error: Float[np.ndarray, " values"], nees: Float[np.ndarray, " values"], seen: Bool[np.ndarray, " values"]
) -> dict[str, Any]:
    """RMSE [m] and mean NEES of all values (0 without values), and of targets seen and never seen (None without)."""
    measures: dict[str, Any] = {"rmse_m": math.sqrt(mean_or_zero(squared_error)), "nees": mean_or_zero(nees)}
    for name, group in (("seen", seen), ("unseen", ~seen)):
        exists = bool(group.any())
        measures[f"rmse_{name}_m"] = math.sqrt(mean_or_zero(squared_error[group])) if exists else None
        measures[f"nees_{name}"] = mean_or_zero(nees[group]) if exists else None
    return measures


def longest_run(flags: Bool[np.ndarray, "K *n"], lengths: Float[np.ndarray, " K"]) -> Float[np.ndarray, "*n"]:
    """The longest run of true values in each column, with the `lengths` of the rows."""
    longest = current = np.zeros(flags.shape[1:])
    for row, length in zip(flags, lengths, strict=True):
        current = np.where(row, current + length, 0.0)
        longest = np.maximum(longest, current)
    return longest


def effective_count(weights: Float[np.ndarray, " n"] | Int[np.ndarray, " n"]) -> float:
    """Effective sample size of a mean with these weights, (sum w)^2 / sum w^2 (Kish 1965); 1 without weights."""
    return max(1.0, float(weights.sum())) ** 2 / max(1.0, float(np.square(weights).sum()))


def chi_square_band(dof: int, count: float | int) -> tuple[float, float]:
    """Interval that holds 95 % of means of `count` chi-square variables (Wilson and Hilferty 1931)."""
    total = dof * count
    variance = 2.0 / (9.0 * total)
    low, high = (dof * max(0.0, 1.0 - variance + sign * Z95 * math.sqrt(variance)) ** 3 for sign in (-1.0, 1.0))
    return low, high
