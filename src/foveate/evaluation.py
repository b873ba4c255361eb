"""How well a policy did, honestly: every method on the same scenes, the same noise, under both protocols."""

import math
import os
import time
import zlib
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from foveate.episodes import scene_episodes
from foveate.models.belief import entropy
from foveate.problem import Episode, Policy, Problem, Trace, Truth
from foveate.rollout import PROTOCOLS, Protocol, observe, predict, rollout, start
from foveate.scenario import SceneSettings
from foveate.scenes import Scene
from foveate.statistics import mean_interval

CHUNK = 256
"""Episodes that run side by side: bounds memory, and every suite runs the same compiled program."""
Z95 = 1.959963984540054


@dataclass(frozen=True, kw_only=True)
class Row:
    """One episode of one method under one protocol.

    `score`: sum_j log det Y_K / targets [nat]; `entropy`: mean differential entropy at the end [nat]; both null
    without targets. `seen_fraction`: targets really measured at least once; `seen_step_fraction`: measured targets
    among all targets of all steps; `longest_unseen_s`: the longest time any target went without a measurement.
    `rmse_m` and `nees` (honest: the state's length) at the horizon, over the targets. `step_time_s`: one compiled
    decision, alone, on this machine.
    """

    scene: str
    episode: int
    seed: int
    method: str
    protocol: str
    motion: str
    targets: int
    score: float | None
    seen_fraction: float
    seen_step_fraction: float
    longest_unseen_s: float
    entropy: float | None
    rmse_m: float
    nees: float
    step_time_s: float


@dataclass(frozen=True, kw_only=True)
class Summary:
    """One cell: a method, a protocol, a motion, a number of targets.

    `std` is over episodes; `ci95` Student's 95 % interval of the mean, scenes taken as independent; `nees_band`
    is where 95 % of such means lie if the filter's covariance is right. `closeness`: how far the mean gets from the
    floor, never seeing anything (0), to the omniscient planner's (1); null where that was not asked for.
    """

    method: str
    protocol: str
    motion: str
    targets: int
    mean: float
    std: float
    ci95: tuple[float, float]
    seen_fraction: float
    seen_step_fraction: float
    rmse_m: float
    nees: float
    nees_band: tuple[float, float]
    episodes: int
    closeness: float | None = None


@dataclass(frozen=True, kw_only=True)
class Suite:
    """Scenes and the chance in them, ready to run: what every method gets alike."""

    problem: Problem
    scenes: tuple[Scene, ...]
    episodes_per_scene: int
    seed: int
    episodes: Episode
    truth: Truth


def prepare(
    problem: Problem, settings: SceneSettings, scenes: Sequence[Scene], seed: int = 0, episodes: int = 1
) -> Suite:
    """Draw the chance of `episodes` runs of every scene from (seed, scene id, episode)."""
    drawn = scene_episodes(problem, settings, scenes, seed, episodes)
    assert drawn.truth is not None, "scene_episodes always draws the truth"
    return Suite(
        problem=problem, scenes=tuple(scenes), episodes_per_scene=episodes, seed=seed, episodes=drawn, truth=drawn.truth
    )


@eqx.filter_jit
def _run(problem: Problem, policy: Policy, episodes: Episode, protocol: Protocol, keys) -> Trace:
    return jax.vmap(lambda e, k: rollout(problem, policy, e, protocol, k))(episodes, keys)


@jax.jit
def _keys(key, names, runs):
    """The policy's own chance: like all other, from (seed, scene id, episode) alone."""
    return jax.vmap(lambda name, run: jax.random.fold_in(jax.random.fold_in(key, name), run))(names, runs)


def policy_keys(suite: Suite) -> jax.Array:
    """The key of a policy's own chance in every episode."""
    names = [zlib.crc32(scene.id.encode()) for scene in suite.scenes for _ in range(suite.episodes_per_scene)]
    runs = np.arange(len(names)) % suite.episodes_per_scene
    return _keys(jax.random.key(suite.seed), np.array(names, np.uint32), runs)


def simulate(
    suite: Suite,
    policy: Policy,
    protocol: Protocol,
    chunk: int = CHUNK,
    report: Callable[[int], None] = lambda done: None,
) -> Trace:
    """Every episode of the suite; a leading axis of episodes, as numpy arrays.

    `chunk` episodes run in one program, and as many of these as there are cores side by side; `report` is called
    with the number of episodes that are done.
    """
    count, keys = len(suite.scenes) * suite.episodes_per_scene, policy_keys(suite)

    def run(first: int) -> Trace:
        rows = np.minimum(np.arange(first, first + chunk), count - 1)
        trace = _run(suite.problem, policy, jax.tree.map(lambda x: x[rows], suite.episodes), protocol, keys[rows])
        return jax.tree.map(lambda x: np.asarray(x)[: count - first], trace)

    parts = []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for part in pool.map(run, range(0, count, chunk)):
            parts.append(part)
            report(min(count, chunk * len(parts)))
    return jax.tree.map(lambda *pieces: np.concatenate(pieces), *parts)


def decision_time(
    problem: Problem, policy: Policy, episode: Episode, repeats: int = 30, with_start: bool = False
) -> float:
    """Median time of one compiled decision for one agent [s], called alone and waited for.

    `with_start` adds each decision's share of the policy's start, for those that think there.
    """
    steps = jax.tree.map(lambda x: x[0], episode.inputs)
    predicted = predict(problem, start(problem, episode, PROTOCOLS["true"]), steps)
    observation, key = observe(predicted, steps, episode.horizon), jax.random.key(0)
    arrays, static = eqx.partition(policy, eqx.is_array)
    begin = jax.jit(lambda arrays, observation: eqx.combine(arrays, static).start(observation))
    decide = jax.jit(lambda arrays, *seen: eqx.combine(arrays, static)(*seen))
    memory = begin(arrays, observation)
    decision = _median_time(lambda: decide(arrays, observation, memory, key), repeats)
    if not with_start:
        return decision
    return decision + _median_time(lambda: begin(arrays, observation), repeats) / int(episode.horizon)


def _median_time(call: Callable[[], Any], repeats: int) -> float:
    """Median wall time of a call that is waited for [s], after one that does not count."""
    jax.block_until_ready(call())
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - began)
    return float(np.median(times))


def evaluate(suite: Suite, method: str, policy: Policy, protocols: Iterable[str]) -> list[Row]:
    """Run a policy on a suite under each protocol: one row an episode."""
    protocols = tuple(protocols)
    with ThreadPoolExecutor() as pool:  # compilation, most of the wait, runs side by side
        traces = list(pool.map(lambda name: simulate(suite, policy, PROTOCOLS[name]), protocols))
    step_time = decision_time(suite.problem, policy, jax.tree.map(lambda x: x[0], suite.episodes))
    times = [step_time] * len(suite.truth.state)
    return [
        row
        for protocol, trace in zip(protocols, traces, strict=True)
        for row in rows_of(suite, method, protocol, trace, times)
    ]


def rows_of(suite: Suite, method: str, protocol: str, trace: Trace, step_times: Sequence[float]) -> list[Row]:
    """One row an episode of what happened to a method, whose decisions took `step_times` [s] in each episode."""
    truth = np.asarray(suite.truth.state)
    rows = []
    for i, step_time in enumerate(step_times):
        scene = suite.scenes[i // suite.episodes_per_scene]
        measures = _measures(suite.problem, jax.tree.map(lambda x, i=i: x[i], trace), truth[i], scene)
        rows.append(
            Row(
                scene=scene.id,
                episode=i % suite.episodes_per_scene,
                seed=suite.seed,
                method=method,
                protocol=protocol,
                motion=scene.motion,
                targets=len(scene.targets),
                step_time_s=step_time,
                **measures,
            )
        )
    return rows


def _measures(problem: Problem, trace: Trace, truth: np.ndarray, scene: Scene) -> dict[str, Any]:
    n, K, n_y = len(scene.targets), scene.horizon, problem.motion.state_size
    if n == 0:
        nothing = dict.fromkeys(("seen_fraction", "seen_step_fraction", "longest_unseen_s", "rmse_m", "nees"), 0.0)
        return {"score": None, "entropy": None, **nothing}
    visible, log_det = np.asarray(trace.visible[:K, :n]), np.asarray(trace.log_det[K - 1, :n], float)
    error = (trace.mean[K, :n] - truth[K, :n]).astype(float)
    position_error = error @ np.asarray(problem.motion.Z, float).T
    return {
        "score": float(log_det.mean()),
        "entropy": float(np.mean(entropy(jnp.asarray(log_det), n_y))),
        "seen_fraction": float(visible.any(axis=0).mean()),
        "seen_step_fraction": float(visible.mean()),
        "longest_unseen_s": float(longest_run(~visible, problem.step_lengths_s(K)).max()),
        "rmse_m": float(np.sqrt((position_error**2).sum(axis=1).mean())),
        "nees": float(np.einsum("ni,nij,nj->n", error, trace.information[K, :n].astype(float), error).mean()),
    }


def longest_run(flags: Bool[np.ndarray, "K n"], lengths: Float[np.ndarray, " K"]) -> Float[np.ndarray, " n"]:
    """The longest run of true values in each column; each row is as long as `lengths` says."""
    longest = current = np.zeros(flags.shape[1])
    for row, length in zip(flags, lengths, strict=True):
        current = np.where(row, current + length, 0.0)
        longest = np.maximum(longest, current)
    return longest


def chi_square_band(dof: int, count: int) -> tuple[float, float]:
    """The interval that holds 95 % of means of `count` chi-square variables (Wilson and Hilferty 1931)."""
    total = dof * count
    spread = 2.0 / (9.0 * total)
    low, high = (dof * max(0.0, 1.0 - spread + sign * Z95 * math.sqrt(spread)) ** 3 for sign in (-1.0, 1.0))
    return low, high


def summarise(rows: Sequence[Row], state_size: int) -> list[Summary]:
    """One summary a cell, in the order in which cells first appear; scenes without targets are left out."""
    cells: dict[tuple, list[Row]] = {}
    for row in rows:
        if row.score is not None:
            cells.setdefault((row.method, row.protocol, row.motion, row.targets), []).append(row)
    return [_summary(group, state_size) for group in cells.values()]


def _summary(rows: Sequence[Row], state_size: int) -> Summary:
    def mean(name: str) -> float:
        return float(np.mean([getattr(row, name) for row in rows]))

    scores = np.array([row.score for row in rows], float)
    first = rows[0]
    by_scene: dict[str, list[float]] = {}
    for row, score in zip(rows, scores, strict=True):
        by_scene.setdefault(row.scene, []).append(score)
    # Episodes of one scene share its layout, so the scene is the unit that is independent.
    means = np.array([np.mean(values) for values in by_scene.values()])
    return Summary(
        method=first.method,
        protocol=first.protocol,
        motion=first.motion,
        targets=first.targets,
        mean=float(scores.mean()),
        std=float(scores.std(ddof=1)) if len(scores) > 1 else 0.0,
        ci95=mean_interval(means),
        seen_fraction=mean("seen_fraction"),
        seen_step_fraction=mean("seen_step_fraction"),
        rmse_m=mean("rmse_m"),
        nees=mean("nees"),
        nees_band=chi_square_band(state_size, first.targets * len({(row.scene, row.episode) for row in rows})),
        episodes=len(rows),
    )


def result(rows: Sequence[Row], summary: Sequence[Summary], facts: dict[str, str]) -> dict[str, object]:
    """The evaluation as JSON: rows, summary, and what they were made with."""
    return {**facts, "rows": [asdict(row) for row in rows], "summary": [asdict(cell) for cell in summary]}
