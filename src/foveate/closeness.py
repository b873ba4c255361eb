"""Where scores lie between the two ends of the yardstick, cell by cell."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from foveate.evaluation import Row, Suite
from foveate.files import cache_folder
from foveate.planning.shooting import OMNISCIENT
from foveate.problem import Problem
from foveate.scenes import Scene
from foveate.summary import Summary
from foveate.yardstick import closeness, floor, omniscient, omniscient_rows

Cell = tuple[str, int]
"""Motion, number of targets."""


def ceiling_rows(suite: Suite, protocol: str, report: Callable[[int], None] = lambda done: None) -> list[Row]:
    """The rows of the best plans with all known; taken from the user's cache folder where they were made before.

    `report` is called with the number of episodes that are done.
    """
    plans = omniscient(suite, protocol, OMNISCIENT[protocol], cache_folder("plans"), report)
    return omniscient_rows(suite, protocol, plans)


def floors(problem: Problem, scenes: Sequence[Scene]) -> dict[Cell, float]:
    """The mean score of one who never sees anything [nat per target], for every cell of the scenes.

    Raises ValueError for a filter that learns from looking in vain: there this is no floor, and plans are no ceiling.
    """
    if problem.sensor.uses_absence:
        raise ValueError(
            "sensor.absence = 'used': closeness is of a filter that learns from measurements alone: expected none"
        )
    values: dict[Cell, list[float]] = {}
    for scene, value in zip(scenes, floor(problem, [scene.horizon for scene in scenes]), strict=True):
        values.setdefault((scene.motion, len(scene.targets)), []).append(float(value))
    return {cell: float(np.mean(found)) for cell, found in values.items()}


def with_closeness(
    summary: Sequence[Summary], ceiling: Sequence[Summary], floors: Mapping[Cell, float]
) -> list[Summary]:
    """The summaries with their closeness to the omniscient planner's; null where that has no rows, or sees nothing."""
    best = {(cell.protocol, cell.motion, cell.targets): cell.mean for cell in ceiling}

    def judged(cell: Summary) -> Summary:
        lowest = floors[cell.motion, cell.targets]
        highest = best.get((cell.protocol, cell.motion, cell.targets), lowest)
        # A nat in ten thousand is what rounding makes of nothing.
        value = closeness(cell.mean, lowest, highest) if highest - lowest > 1e-4 else None
        return replace(cell, closeness=value)

    return [judged(cell) for cell in summary]
