"""Strata of a batch: as many episodes of each number of targets as their distribution says, in few shapes.

Padding to the most targets and steps would nearly double the work; a program for every number of targets would take
as many times as long to compile.
"""

import functools
import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from foveate.scenario.scenes import SceneSettings

MAX_SHAPES = 4
"""Most shapes of a batch, each of which is compiled."""

SHAPE_TARGETS = 384
"""Targets of a batch, with padding, for which another shape pays."""


class Stratum(NamedTuple):
    """Episodes of one shape: scenes of as many targets at most, and each one's number of targets (0: to be drawn)."""

    scenes: SceneSettings
    targets: Int[np.ndarray, " episodes"]

    @property
    def cost(self) -> float:
        """Steps of targets in an episode, with padding."""
        return float(self.scenes.targets_max * self.scenes.horizon(self.scenes.targets_max))


def strata(scenes: SceneSettings, episodes: int) -> list[Stratum]:
    """Divide a batch by its numbers of targets; the episodes that are left over are drawn, in the largest shape."""
    numbers = range(scenes.targets_min, scenes.targets_max + 1)
    each, left = divmod(episodes, len(numbers))
    shapes = min(MAX_SHAPES, -(-episodes * scenes.targets_max // SHAPE_TARGETS), len(numbers)) if each else 1
    found, low = [], scenes.targets_min
    for high in _largest(scenes, shapes):
        targets = np.repeat(np.arange(low, high + 1), each)
        if high == scenes.targets_max:
            found.append(Stratum(scenes, np.append(targets, np.zeros(left, int))))
        else:
            found.append(Stratum(replace(scenes, targets_max=high), targets))
        low = high + 1
    return found


@functools.cache
def _largest(scenes: SceneSettings, shapes: int) -> tuple[int, ...]:
    """The largest number of targets of each shape, so that the shape with most work has as little as possible."""
    numbers = range(scenes.targets_min, scenes.targets_max + 1)

    def work(inner: tuple[int, ...]) -> list[int]:
        ends = (numbers[0] - 1, *inner, numbers[-1])
        return sorted(
            ((high - low) * high * scenes.horizon(high) for low, high in itertools.pairwise(ends)), reverse=True
        )

    return (*min(itertools.combinations(numbers[:-1], shapes - 1), key=work), numbers[-1])
