"""References of every score: never seeing anything, a lower bound, and the omniscient planner.

The planner's plan is a local optimum, so its score is a reference and no upper bound: annealing gains 0.06 nat per
target, the best plans known 0.17 (0.2 with 7 targets), and a normalised score above 1 is possible. Normalised scores of
different numbers of targets differ by 0.01 to 0.02 from that alone.

normalised_score = (score - lower bound) / (omniscient - lower bound).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from foveate.errors import InputError
from foveate.evaluation.summary import Summary
from foveate.geometry.linalg import log_det_spd
from foveate.io.grouping import group_by
from foveate.models import belief
from foveate.models.problem import Problem
from foveate.scenario.scenes import Scene

MIN_RANGE = 1e-4
"""Least distance of the oracle from the lower bound [nat]: below it, rounding errors dominate the quotient."""

Cell = tuple[str, int]
"""Motion, number of targets."""


def unseen_scores(problem: Problem, horizons: Sequence[int]) -> Float[np.ndarray, " episodes"]:
    """Score of an agent that never sees anything [nat per target], for episodes of these numbers of steps."""

    def step(Y, k):
        Y = belief.predict_information(Y, problem.at(k).motion)
        return Y, log_det_spd(Y)

    unseen = jax.jit(lambda Y: jax.lax.scan(step, Y, jnp.arange(max(horizons)))[1])(problem.prior_information)
    return np.asarray(unseen, float)[np.asarray(horizons) - 1]


def lower_bounds(problem: Problem, scenes: Sequence[Scene]) -> dict[Cell, float]:
    """Mean score of an agent that never sees anything [nat per target], for every cell of the scenes.

    Raises InputError for a filter that learns from missed detections: neither this score nor that of plans bounds it.
    """
    if problem.sensor.uses_missed_detections:
        raise InputError("sensor.missed_detections = 'used': expected none, as normalised_score has no bounds with it")
    values = zip(scenes, unseen_scores(problem, [scene.horizon for scene in scenes]), strict=True)
    cells = group_by(values, lambda pair: (pair[0].motion, len(pair[0].targets)))
    return {cell: float(np.mean([value for _, value in pairs])) for cell, pairs in cells.items()}


def normalised_score(value: float, lowest: float, highest: float) -> float:
    """Fraction of the way from the lower bound (0) to the omniscient planner (1), a reference and no upper bound."""
    return (value - lowest) / (highest - lowest)


def with_normalised_scores(
    summary: Sequence[Summary], oracle: Sequence[Summary], lowest: Mapping[Cell, float]
) -> list[Summary]:
    """Add normalised_score to summaries; None where the omniscient planner has no rows, or sees nothing itself."""
    highest = {(cell.protocol, cell.motion, cell.targets): cell.mean for cell in oracle}
    result = []
    for cell in summary:
        low = lowest[cell.motion, cell.targets]
        high = highest.get((cell.protocol, cell.motion, cell.targets), low)
        score = normalised_score(cell.mean, low, high) if high - low > MIN_RANGE else None
        result.append(replace(cell, normalised_score=score))
    return result
