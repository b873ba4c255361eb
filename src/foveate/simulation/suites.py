"""Suites of scenes (the paper's table 1 and a scenario's own), and episodes from scenes and a seed."""

import functools
import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from foveate.errors import InputError
from foveate.io.jax_settings import quick_compilation
from foveate.io.validate import require
from foveate.models.problem import Problem
from foveate.scenario.scenes import Scene, SceneSettings
from foveate.simulation.episodes import Drawn, Noise, draw, draw_shapes, draw_size, episode_of
from foveate.simulation.population import noise_shapes
from foveate.simulation.records import Episode
from foveate.simulation.starts import check_free
from foveate.simulation.team.mate_scans import mate_scan_shapes
from foveate.simulation.team.starts import other_poses, scene_mate_noise

SUITE_SEED = 2023
"""Seed of the built-in suites: the year of the paper."""
TABLE1_TARGETS = (3, 5, 7)
SUITE_SCENES_PER_CELL = 30
ROUNDING_M = 1e-6
"""Rounding of the numbers of a scene."""


class Cell(NamedTuple):
    """A number of targets, with the drift of the scenario (`biased`) or without."""

    targets: int
    biased: bool


def suite(
    settings: SceneSettings, problem: Problem, seed: int, cells: Sequence[Cell], count: int = SUITE_SCENES_PER_CELL
) -> list[Scene]:
    """`count` random test scenes of `settings` in each of the cells."""
    most = max(cell.targets for cell in cells)
    largest = replace(settings, targets_min=most, targets_max=most)
    uniform = np.concatenate([_uniform(settings, largest, problem, seed, cell, count) for cell in cells])
    targets = np.repeat([cell.targets for cell in cells], count)

    # Always in float64, so that a seed means the same scenes at every working precision.
    with jax.enable_x64(True):
        drawn = map(np.asarray, _scene_program(_constant(problem), largest)(uniform, targets, problem.obstacles))
        agent, position, drift, *rest = drawn
    numbers, others = rest[: problem.obstacles is not None], rest[problem.obstacles is not None :]
    scenes = []
    for i, n in enumerate(targets.tolist()):
        cell = cells[i // count]
        scenes.append(
            Scene(
                id=f"{'biased' if cell.biased else 'unbiased'}-{n}-{i % count:02d}",
                agent=_numbers(agent[i]),
                targets=tuple(_numbers(row) for row in position[i, :n]),
                drift=tuple(_numbers(row) for row in drift[i, :n] * cell.biased),
                horizon=settings.horizon(n),
                map=int(numbers[0][i]) if numbers else 0,
                others=tuple(_numbers(row) for row in others[0][i]) if others else (),
            )
        )
    return scenes


def _uniform(
    settings: SceneSettings, largest: SceneSettings, problem: Problem, seed: int, cell: Cell, count: int
) -> Float[np.ndarray, "count size"]:
    """Random numbers of the scenes of a cell, drawn at its own size and padded to that of the `largest`."""
    own = replace(settings, targets_min=cell.targets, targets_max=cell.targets)
    rng = np.random.default_rng([seed, cell.targets, cell.biased])
    drawn = rng.uniform(-1.0, 1.0, (count, draw_size(own, problem)))
    shapes = draw_shapes(own, problem)
    parts = np.split(drawn, np.cumsum([math.prod(shape) for shape in shapes])[:-1], axis=1)
    padded = [
        np.pad(part, ((0, 0), (0, math.prod(shape) - part.shape[1])))
        for part, shape in zip(parts, draw_shapes(largest, problem), strict=True)
    ]
    return np.concatenate(padded, axis=1)


def table1(problem: Problem, seed: int = SUITE_SEED) -> list[Scene]:
    """The paper's test distribution, 30 scenes in each of its six cells; `table1` proper has the default seed.

    Args:
        problem: Models of agent, sensor and targets.
        seed: Seed of the scenes.
    """
    cells = [Cell(targets, biased) for biased in (False, True) for targets in TABLE1_TARGETS]
    return suite(SceneSettings(), problem, seed, cells)


def own_suite(settings: SceneSettings, problem: Problem, seed: int = SUITE_SEED) -> list[Scene]:
    """Test scenes of a scenario: 30 each with its smallest, middle and largest number of targets.

    Args:
        settings: Scene settings of the scenario.
        problem: Models of agent, sensor and targets.
        seed: Seed of the scenes.
    """
    fewest, most = settings.targets_min, settings.targets_max
    counts = sorted({fewest, (fewest + most) // 2, most})
    return suite(settings, problem, seed, [Cell(targets, any(settings.drift_m_s)) for targets in counts])


def _numbers(values: Any) -> tuple[float, ...]:
    """Round to ROUNDING_M: a scene has the same numbers in every precision and in a file."""
    return tuple(round(float(value), 6) + 0.0 for value in values)


def scene_noise(problem: Problem, scene: Scene, seed: int, episode: int) -> dict[str, np.ndarray]:
    """All random numbers of one episode of a scene, from (seed, scene id, episode) alone: the same for every method.

    numpy draws them at the scene's true size, so that neither padding nor precision changes a number.
    """
    d, n_y, n_z = problem.agent.space.dimension, problem.motion.state_size, problem.sensor.size
    steps, n = scene.horizon, len(scene.targets)
    rng = np.random.default_rng([seed, zlib.crc32(scene.id.encode()), episode])
    drawn = {
        "jitter": rng.uniform(-1.0, 1.0, (steps, n, d)),
        "process": rng.standard_normal((steps, n, n_y)),
        "measurement": rng.standard_normal((steps, n, n_z)),
        "first": rng.standard_normal((n, n_y)),
    }
    if problem.detections is None:
        return drawn
    return drawn | {name: rng.uniform(size=shape) for name, shape in noise_shapes(problem, steps, n).items()}


def scene_episodes(
    problem: Problem, settings: SceneSettings, scenes: Sequence[Scene], seed: int, episodes: int
) -> Episode:
    """Episodes 0 .. `episodes`-1 of every scene, padded to a common size and stacked, scene by scene.

    Shapes: a leading axis of len(scenes) * episodes; n and K are the largest of any scene (n at least 1).
    """
    if not problem.motion.takes_drift and (moving := [scene.id for scene in scenes if scene.motion == "biased"]):
        raise InputError(f"scene {moving[0]!r}: drift: expected 0, as the scenario's targets have no place for it")
    _check_inside(problem, scenes)
    check_free(problem, scenes)
    n = max(1, *(len(scene.targets) for scene in scenes))
    steps, d = max(scene.horizon for scene in scenes), problem.agent.space.dimension
    drawn = {
        "pose": np.stack([problem.agent.space.numpy_pose(scene.agent) for scene in scenes]),
        "position": _padded([np.reshape(scene.targets, (-1, d)) for scene in scenes], (n, d)),
        "drift": _padded([np.reshape(scene.drift, (-1, d)) for scene in scenes], (n, d)),
        "present": np.arange(n) < np.array([[len(scene.targets)] for scene in scenes]),
        "horizon": np.array([scene.horizon for scene in scenes]),
    }
    if problem.obstacles is not None:
        drawn["map_number"] = np.array([scene.map for scene in scenes])
    rows = [scene_noise(problem, scene, seed, k) for scene in scenes for k in range(episodes)]
    most = scene_noise(problem, replace(scenes[0], targets=((0.0,) * d,) * n, horizon=steps), seed, 0)
    noise = {name: _padded([row[name] for row in rows], largest.shape) for name, largest in most.items()}
    if problem.team is not None:
        drawn["others"] = other_poses(problem, scenes)
        more = [scene_mate_noise(problem, scene, seed, k) for scene in scenes for k in range(episodes)]
        agents = problem.team.agents
        shapes = {"mates": (steps, agents - 1, n, problem.sensor.size), "radio": (steps, agents, agents)}
        shapes |= mate_scan_shapes(problem, steps, n)
        noise |= {name: _padded([row[name] for row in more], shape) for name, shape in shapes.items()}
    scenes_of_rows = {name: np.repeat(values, episodes, axis=0) for name, values in drawn.items()}
    return _episode_program(_constant(problem), settings)(scenes_of_rows, noise, problem.obstacles)


def _constant(problem: Problem) -> "Constant":
    """The problem without its obstacles, which are an argument: as a constant, maps would take a minute to compile."""
    return Constant(problem if problem.obstacles is None else replace(problem, obstacles=None))


class Constant:
    """A problem that compiled programs have as a constant, hashable by its content.

    As an argument it would round differently, and so make other episodes of the same seed.
    """

    def __init__(self, problem: Problem) -> None:
        leaves, structure = jax.tree.flatten(problem)
        arrays = [np.asarray(leaf) for leaf in leaves]
        self.problem = problem
        self.content = structure, tuple((array.dtype.str, array.shape, array.tobytes()) for array in arrays)

    def __hash__(self) -> int:
        return hash(self.content)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Constant) and self.content == other.content


@functools.lru_cache(maxsize=16)
def _scene_program(constant: Constant, settings: SceneSettings) -> Callable[..., tuple[jax.Array, ...]]:
    """Numbers of the agent's pose, positions and drifts of test scenes."""
    problem = constant.problem

    def make(numbers, targets, obstacles):
        drawn = draw(settings, replace(problem, obstacles=obstacles), numbers, test=True, targets=targets)
        parts = problem.agent.space.numbers_of(drawn.pose), drawn.position, drawn.drift
        parts = parts if drawn.map_number is None else (*parts, drawn.map_number)
        return parts if drawn.others is None else (*parts, jax.vmap(problem.agent.space.numbers_of)(drawn.others))

    return jax.jit(jax.vmap(make, (0, 0, None)), compiler_options=quick_compilation())


@functools.lru_cache(maxsize=16)
def _episode_program(constant: Constant, settings: SceneSettings) -> Callable[..., Episode]:
    """Episodes of scenes and noise, as dicts of the fields of `Drawn` and `Noise`."""
    problem = constant.problem

    def make(scene, noise, obstacles):
        return episode_of(replace(problem, obstacles=obstacles), settings, Drawn(**scene), Noise(**noise))

    return jax.jit(jax.vmap(make, (0, 0, None)), compiler_options=quick_compilation())


def _check_inside(problem: Problem, scenes: Sequence[Scene]) -> None:
    """Raise InputError unless all targets start inside of borders that they keep, except for a scene's rounding."""
    region = problem.region
    if region is None or not problem.bounds_targets:
        return
    low, high = np.asarray(region.low, float) - ROUNDING_M, np.asarray(region.high, float) + ROUNDING_M
    for scene in scenes:
        for target in scene.targets:
            inside = bool(np.all((low <= target) & (target <= high)))
            require(inside, f"scene {scene.id!r}: target", target, "expected inside of the scenario's region")


def _padded(parts: Sequence[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    """Stack arrays, each with zeros behind it up to a common shape."""
    stack = np.zeros((len(parts), *shape))
    for row, part in zip(stack, parts, strict=True):
        row[tuple(map(slice, part.shape))] = part
    return stack
