"""Suites of scenes (the paper's table 1 and a scenario's own), and episodes from scenes and a seed."""

import zlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from foveate.errors import InputError
from foveate.models.problem import Problem
from foveate.scenario.scenes import Scene, SceneSettings
from foveate.simulation.episodes import Drawn, Noise, draw, draw_size, episode_of
from foveate.simulation.records import Episode

SUITE_SEED = 2023
"""Seed of the built-in suites: the year of the paper."""
TABLE1_TARGETS = (3, 5, 7)
SUITE_SCENES_PER_CELL = 30


def suite(settings: SceneSettings, problem: Problem, seed: int, targets: int, count: int, biased: bool) -> list[Scene]:
    """`count` random test scenes of `settings` with this number of targets, with its drift (`biased`) or without."""
    cell = replace(settings, targets_min=targets, targets_max=targets)
    if not biased:
        cell = replace(cell, drift_m_s=(0.0,) * len(cell.drift_m_s))
    rng = np.random.default_rng([seed, targets, biased])
    uniform = rng.uniform(-1.0, 1.0, (count, draw_size(cell, problem)))
    # Always in float64, so that a seed means the same scenes at every working precision.
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
    """The paper's test distribution, 30 scenes in each of its six cells; `table1` proper has the default seed.

    Args:
        problem: Models of agent, sensor and targets.
        seed: Seed of the scenes.
    """
    cells = [(targets, biased) for biased in (False, True) for targets in TABLE1_TARGETS]
    return _cells(SceneSettings(), problem, seed, cells)


def own_suite(settings: SceneSettings, problem: Problem, seed: int = SUITE_SEED) -> list[Scene]:
    """Test scenes of a scenario: 30 each with its smallest, middle and largest number of targets.

    Args:
        settings: Scene settings of the scenario.
        problem: Models of agent, sensor and targets.
        seed: Seed of the scenes.
    """
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
    """Round to a micrometre: a scene has the same numbers in every precision and in a file."""
    return tuple(round(float(value), 6) + 0.0 for value in values)


def scene_noise(problem: Problem, scene: Scene, seed: int, episode: int) -> dict[str, np.ndarray]:
    """All random numbers of one episode of a scene, from (seed, scene id, episode) alone: the same for every method.

    numpy draws them at the scene's true size, so that neither padding nor precision changes a number.
    """
    d, n_y, n_z = problem.agent.space.dimension, problem.motion.state_size, problem.sensor.H.shape[0]
    steps, n = scene.horizon, len(scene.targets)
    rng = np.random.default_rng([seed, zlib.crc32(scene.id.encode()), episode])
    return {
        "jitter": rng.uniform(-1.0, 1.0, (steps, n, d)),
        "process": rng.standard_normal((steps, n, n_y)),
        "measurement": rng.standard_normal((steps, n, n_z)),
        "first": rng.standard_normal((n, n_y)),
    }


def scene_episodes(
    problem: Problem, settings: SceneSettings, scenes: Sequence[Scene], seed: int, episodes: int
) -> Episode:
    """Episodes 0 .. `episodes`-1 of every scene, padded to a common size and stacked, scene by scene.

    Shapes: a leading axis of len(scenes) * episodes; n and K are the largest of any scene (n at least 1).
    """
    if not problem.motion.takes_drift and (moving := [scene.id for scene in scenes if scene.motion == "biased"]):
        raise InputError(f"scene {moving[0]!r}: drift: expected 0, as the scenario's targets have no place for it")
    n = max(1, *(len(scene.targets) for scene in scenes))
    steps, d = max(scene.horizon for scene in scenes), problem.agent.space.dimension
    rows = []
    for scene in scenes:
        shape = (len(scene.targets), d)
        drawn = {
            "pose": problem.agent.space.from_numbers(scene.agent),
            "position": _padded(np.reshape(scene.targets, shape), (n,)),
            "drift": _padded(np.reshape(scene.drift, shape), (n,)),
            "present": np.arange(n) < len(scene.targets),
            "horizon": scene.horizon,
        }
        for k in range(episodes):
            noise = scene_noise(problem, scene, seed, k)
            rows.append((drawn, {name: _padded(x, (steps, n)[3 - x.ndim :]) for name, x in noise.items()}))
    drawn, noise = jax.tree.map(lambda *parts: np.stack(parts), *rows)
    make = jax.vmap(lambda scene, noise: episode_of(problem, settings, Drawn(**scene), Noise(**noise)))
    return jax.jit(make)(drawn, noise)


def _padded(values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """`values` with zeros behind them, so that their first axes have this shape."""
    return np.pad(values, [(0, size - have) for size, have in zip(shape, values.shape, strict=False)] + [(0, 0)])
