"""Suites of scenes: the paper's table 1, and scenes of a scenario's own."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np

from foveate.models.problem import Problem
from foveate.scenario.scenes import Scene, SceneSettings
from foveate.simulation.episodes import draw, draw_size

SUITE_SEED = 2023
"""Seed of the built-in suites: the year of the paper."""


TABLE1_TARGETS = (3, 5, 7)


SUITE_SCENES_PER_CELL = 30


def suite(settings: SceneSettings, problem: Problem, seed: int, targets: int, count: int, biased: bool) -> list[Scene]:
    """`count` test scenes with that many targets from the distribution of `settings`, with its drift or without."""
    cell = replace(settings, targets_min=targets, targets_max=targets)
    if not biased:
        cell = replace(cell, drift_m_s=(0.0,) * len(cell.drift_m_s))
    rng = np.random.default_rng([seed, targets, biased])
    uniform = rng.uniform(-1.0, 1.0, (count, draw_size(cell, problem)))
    # In float64 whatever the working precision, so that a seed means the same scenes everywhere.
    with jax.enable_x64(True):
        drawn = jax.jit(jax.vmap(lambda numbers: draw(cell, problem, numbers, test=True)))(uniform)
        agents = [problem.agent.space.to_numbers(pose) for pose in drawn.pose]
        position, drift = np.asarray(drawn.position), np.asarray(drawn.drift)
    word = "biased" if biased else "unbiased"
    return [
        Scene(
            id=f"{word}-{targets}-{i:02d}",
            agent=_numbers(agents[i]),
            targets=tuple(_numbers(row) for row in position[i]),
            drift=tuple(_numbers(row) for row in drift[i]),
            horizon=cell.horizon(targets),
        )
        for i in range(count)
    ]


def table1(problem: Problem, seed: int = SUITE_SEED) -> list[Scene]:
    """The paper's test distribution, 30 scenes in each of its six cells; `table1` proper has the default seed."""
    cells = [(targets, biased) for biased in (False, True) for targets in TABLE1_TARGETS]
    return _cells(SceneSettings(), problem, seed, cells)


def own_suite(settings: SceneSettings, problem: Problem, seed: int = SUITE_SEED) -> list[Scene]:
    """30 test scenes of a scenario's own for each of the fewest, the middle and the most targets it is made for."""
    fewest, most = settings.targets_min, settings.targets_max
    counts = sorted({fewest, (fewest + most) // 2, most})
    return _cells(settings, problem, seed, [(targets, any(settings.drift_m_s)) for targets in counts])


def _cells(settings: SceneSettings, problem: Problem, seed: int, cells: list[tuple[int, bool]]) -> list[Scene]:
    return [
        scene
        for targets, biased in cells
        for scene in suite(settings, problem, seed, targets, SUITE_SCENES_PER_CELL, biased)
    ]


def _numbers(values: Any) -> tuple[float, ...]:
    """Rounded to a micrometre: a scene means the same numbers in every precision and in a file."""
    return tuple(round(float(value), 6) + 0.0 for value in values)
