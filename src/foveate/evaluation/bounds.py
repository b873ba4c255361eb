"""The two ends of every score: the floor, nothing ever seen, and the ceiling, a planner that knows the future.

The omniscient planner knows where every target will really be and feels no noise. normalised_score = (score - floor) /
(omniscient - floor). Its plans are kept in the user's cache folder by the content of what they were made for.
"""

import hashlib
import json
import os
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foveate import __version__
from foveate.errors import InputError
from foveate.evaluation.evaluate import Row, Suite, policy_keys, rows_of
from foveate.evaluation.summary import Summary
from foveate.geometry.linalg import log_det_spd
from foveate.io.files import cache_folder
from foveate.io.npz import load_arrays, save_arrays
from foveate.models import belief
from foveate.models.belief import entropy
from foveate.models.problem import Problem, first_information
from foveate.models.sensor import PAPER_SOFTNESS, Softness
from foveate.planning.information import Future, score
from foveate.planning.receding import Given
from foveate.planning.shooting import OMNISCIENT, PlanSettings, plan
from foveate.scenario.scenes import Scene
from foveate.simulation.records import PROTOCOLS, Episode, Protocol
from foveate.simulation.rollout import rollout

LEVELS = {"surrogate": PAPER_SOFTNESS, "true": None}
"""The view of each protocol: soft, or the real one."""


KIND = "plans"


VERSION = 1
"""Of the files that keep plans; raised, too, when the planner finds other plans than before."""


TOGETHER = 4
"""Episodes of one size that a program plans side by side: more would not fit into a core's cache."""


@dataclass(frozen=True, kw_only=True)
class Plans:
    """The omniscient planner's action sequences for every episode of a suite, their scores and their cost.

    `score`: of the noise-free information recursion with every target at its true position [nat per target];
    `seconds`: wall time an episode, compiled, in the machine that planned them.
    """

    action: Float[np.ndarray, "episodes K m"]
    score: Float[np.ndarray, " episodes"]
    seconds: Float[np.ndarray, " episodes"]
    cached: bool


def floor(problem: Problem, horizons: Sequence[int]) -> Float[np.ndarray, " episodes"]:
    """The score of an agent that never sees anything [nat per target], for episodes of so many steps."""

    def step(Y, k):
        Y = belief.predict_information(Y, problem.at(k).motion)
        return Y, log_det_spd(Y)

    unseen = jax.jit(lambda Y: jax.lax.scan(step, Y, jnp.arange(max(horizons)))[1])(problem.prior_information)
    return np.asarray(unseen, float)[np.asarray(horizons) - 1]


def normalised_score(value: float, lowest: float, highest: float) -> float:
    """How far a score gets from the floor, never seeing anything (0), to the omniscient planner's (1)."""
    return (value - lowest) / (highest - lowest)


def omniscient(
    suite: Suite,
    protocol: str,
    settings: PlanSettings,
    cache: Path | None = None,
    report: Callable[[int], None] = lambda done: None,
) -> Plans:
    """Plan every episode of a suite, or take the plans from the folder `cache` if it has them.

    `report` is called with the number of episodes that are done. A file that is missing, damaged or of something
    else is made anew; scores are computed here whatever the file says.
    """
    content = _content(suite, protocol, settings)
    path = None if cache is None else cache / f"{content}.npz"
    futures = jax.jit(jax.vmap(lambda episode: _future(suite.problem, episode)))(suite.episodes)
    shape = (*futures.state.shape[:2], len(suite.problem.agent.axes))
    known = None if path is None else _known(path, content, shape)
    action, seconds = known or _solve_all(suite, futures, settings, report)
    if path is not None and known is None:
        _keep(path, content, action, seconds)
    report(len(action))
    return Plans(
        action=action,
        score=np.asarray(_worth(suite.problem, futures, jnp.asarray(action), LEVELS[protocol]), float),
        seconds=seconds,
        cached=known is not None,
    )


@eqx.filter_jit
def _worth(problem: Problem, futures: Future, action, level: Softness | None) -> Float[Array, " episodes"]:
    return jax.vmap(lambda future, one: score(problem, future, one, level))(futures, action)


def omniscient_rows(suite: Suite, protocol: str, plans: Plans) -> list[Row]:
    """Rows of the plans, driven in the real world; score and entropy are those of `Plans.score`.

    Under `true` the two scores are the same, as what is seen depends on true positions alone (as long as V does not
    grow with the believed range); under `surrogate` the filter that really runs weighs its noisy means, which the
    planner that feels no noise does not know.
    """
    trace = _drive(suite.problem, jnp.asarray(plans.action), suite.episodes, PROTOCOLS[protocol], policy_keys(suite))
    horizons = np.asarray(suite.episodes.horizon)
    rows = rows_of(suite, "omniscient", protocol, jax.tree.map(np.asarray, trace), list(plans.seconds / horizons))
    n_y = suite.problem.motion.state_size
    return [
        row if row.score is None else replace(row, score=float(value), entropy=float(entropy(jnp.asarray(value), n_y)))
        for row, value in zip(rows, plans.score, strict=True)
    ]


@eqx.filter_jit
def _drive(problem: Problem, action, episodes: Episode, protocol: Protocol, keys):
    return jax.vmap(lambda e, a, k: rollout(problem, Given(a), e, protocol, k))(episodes, action, keys)


def _future(problem: Problem, episode: Episode) -> Future:
    """What will really happen in an episode."""
    assert episode.truth is not None, "the future of an episode without truth is not known"
    first = first_information(problem, len(episode.present))
    return Future(
        pose=episode.pose,
        state=episode.truth.state[1:],
        information=jax.vmap(lambda Y: belief.predict_information(Y, problem.motion))(first),
        present=episode.present,
        horizon=episode.horizon,
    )


def _solve(problem: Problem, futures: Future, settings: PlanSettings, keys) -> Float[Array, "episodes K m"]:
    return jax.vmap(lambda future, key: plan(problem, future, settings, key).action)(futures, keys)


def _cropped(futures: Future, rows: np.ndarray, targets: int, steps: int) -> Future:
    def crop(future: Future) -> Future:
        return Future(
            pose=future.pose,
            state=future.state[:steps, :targets],
            information=future.information[:targets],
            present=future.present[:targets],
            horizon=future.horizon,
        )

    return jax.vmap(crop)(jax.tree.map(lambda x: x[rows], futures))


def _solve_all(
    suite: Suite, futures: Future, settings: PlanSettings, report: Callable[[int], None]
) -> tuple[np.ndarray, np.ndarray]:
    """Actions and seconds of every episode. Episodes of one size share a program, so that none is padded."""
    keys = policy_keys(suite)
    action = np.zeros((*futures.state.shape[:2], len(suite.problem.agent.axes)), futures.state.dtype)
    seconds = np.zeros(len(action))
    sizes: dict[tuple[int, int], list[int]] = {}
    for i in range(len(action)):
        scene = suite.scenes[i // suite.episodes_per_scene]
        sizes.setdefault((max(1, len(scene.targets)), scene.horizon), []).append(i)
    parts = [[rows[i : i + TOGETHER] for i in range(0, len(rows), TOGETHER)] for rows in sizes.values()]

    def calls(size: tuple[int, int], groups: list[list[int]]) -> list[tuple]:
        filled = [np.array((group * TOGETHER)[:TOGETHER]) for group in groups]
        return [(suite.problem, _cropped(futures, rows, *size), settings, keys[rows]) for rows in filled]

    work = [calls(size, groups) for size, groups in zip(sizes, parts, strict=True)]
    solver: Any = eqx.filter_jit(_solve)
    done = 0
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        programs = list(pool.map(lambda some: solver.lower(*some[0]).compile(), work))
        for (size, rows), groups, some, solve in zip(sizes.items(), parts, work, programs, strict=True):
            began = time.perf_counter()
            for group, found in zip(
                groups, pool.map(lambda call, run=solve: np.asarray(run(*call)), some), strict=True
            ):
                action[group, : size[1]] = found[: len(group)]
                done += len(group)
                report(done)
            seconds[rows] = (time.perf_counter() - began) / len(rows)
    return action, seconds


def _content(suite: Suite, protocol: str, settings: PlanSettings) -> str:
    """A digest of everything that plans depend on."""
    leaves, structure = jax.tree.flatten((suite.problem, suite.episodes.pose, suite.truth.state))
    arrays = [np.asarray(leaf) for leaf in leaves]
    words = {
        "version": [__version__, VERSION],
        "protocol": protocol,
        "settings": asdict(settings),
        "scenes": [asdict(scene) for scene in suite.scenes],
        "episodes": [suite.seed, suite.episodes_per_scene],
        "structure": str(structure),
        "arrays": [[array.dtype.str, array.shape] for array in arrays],
    }
    total = hashlib.sha256(json.dumps(words, sort_keys=True).encode())
    for array in arrays:
        total.update(array.tobytes())
    return total.hexdigest()


def _known(path: Path, content: str, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray] | None:
    """Actions and seconds that a file keeps; None where it is not there, or not as it was written."""
    try:
        header, arrays = load_arrays(path, KIND, VERSION)
    except InputError:
        return None
    fits = header.get("content") == content and set(arrays) == {"action", "seconds"}
    if not fits or arrays["action"].shape != shape or arrays["seconds"].shape != shape[:1]:
        return None
    return arrays["action"], arrays["seconds"]


def _keep(path: Path, content: str, action: np.ndarray, seconds: np.ndarray) -> None:
    """Write the file; a folder that cannot be written to costs the next run its time, not this one its result."""
    header = {"format": f"foveate-{KIND}", "version": VERSION, "content": content}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        save_arrays(path, {"action": action, "seconds": seconds}, header)
    except OSError as error:
        warnings.warn(f"{path}: not kept: {error.strerror or error}", stacklevel=3)


Cell = tuple[str, int]
"""Motion, number of targets."""


def oracle_rows(suite: Suite, protocol: str, report: Callable[[int], None] = lambda done: None) -> list[Row]:
    """The rows of the best plans with all known; taken from the user's cache folder where they were made before.

    `report` is called with the number of episodes that are done.
    """
    plans = omniscient(suite, protocol, OMNISCIENT[protocol], cache_folder("plans"), report)
    return omniscient_rows(suite, protocol, plans)


def lower_bounds(problem: Problem, scenes: Sequence[Scene]) -> dict[Cell, float]:
    """The mean score of one who never sees anything [nat per target], for every cell of the scenes.

    Raises ValueError for a filter that learns from looking in vain: there this is no floor, and plans are no ceiling.
    """
    if problem.sensor.uses_missed_detections:
        raise InputError(
            "sensor.missed_detections = 'used': normalised_score is of a filter that learns from measurements alone: expected none"
        )
    values: dict[Cell, list[float]] = {}
    for scene, value in zip(scenes, floor(problem, [scene.horizon for scene in scenes]), strict=True):
        values.setdefault((scene.motion, len(scene.targets)), []).append(float(value))
    return {cell: float(np.mean(found)) for cell, found in values.items()}


def with_normalised_scores(
    summary: Sequence[Summary], ceiling: Sequence[Summary], floors: Mapping[Cell, float]
) -> list[Summary]:
    """The summaries with their normalised_score to the omniscient planner's; null where that has no rows, or sees nothing."""
    best = {(cell.protocol, cell.motion, cell.targets): cell.mean for cell in ceiling}

    def judged(cell: Summary) -> Summary:
        lowest = floors[cell.motion, cell.targets]
        highest = best.get((cell.protocol, cell.motion, cell.targets), lowest)
        # A nat in ten thousand is what rounding makes of nothing.
        value = normalised_score(cell.mean, lowest, highest) if highest - lowest > 1e-4 else None
        return replace(cell, normalised_score=value)

    return [judged(cell) for cell in summary]
