"""Intervals of means and paired comparisons of independent values (scenes, not episodes)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import stdtrit

LEVEL = 0.95

Values = Sequence[float] | Float[np.ndarray, " values"]


@dataclass(frozen=True, kw_only=True)
class Paired:
    """The mean of paired differences, its 95 % interval, and the two-sided p value of a signed-rank test."""

    mean: float
    ci95: tuple[float, float]
    p: float


def mean_interval(values: Values) -> tuple[float, float]:
    """Student's 95 % interval of the mean of independent values; a single value is its own interval."""
    data = np.asarray(values, float)
    count, mean = len(data), float(np.mean(data))
    if count < 2:
        return mean, mean
    half = float(stdtrit(count - 1, 0.5 + LEVEL / 2)) * float(data.std(ddof=1)) / math.sqrt(count)
    return mean - half, mean + half


def paired(first: Values, second: Values) -> Paired:
    """Compare `first` minus `second`, pair by pair.

    The test is Wilcoxon's signed-rank test: scores of scenes are skewed (one target that is never seen costs many
    nats), which a test of ranks tolerates better than one of the mean.
    """
    from scipy.stats import wilcoxon  # half a second to import

    difference = np.asarray(first, float) - np.asarray(second, float)
    test: Any = wilcoxon
    p = float(test(difference).pvalue) if np.any(difference) else 1.0
    return Paired(mean=float(difference.mean()), ci95=mean_interval(difference), p=p)


def holm(p_values: Values) -> list[float]:
    """Adjust the p values of a family of tests, so that they bound the chance of any false alarm (Holm 1979)."""
    p = np.asarray(p_values, float)
    order = np.argsort(p, kind="stable")
    raised = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(raised, 1.0)
    return adjusted.tolist()
