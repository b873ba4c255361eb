"""Evaluate methods on the same scenes with the same noise, under each protocol: one row an episode."""

import time
import zlib
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import numpy as np

from foveate.evaluation.detections import detection_measures, member_measures
from foveate.evaluation.metrics import measures
from foveate.evaluation.rows import Row
from foveate.evaluation.team import team_measures
from foveate.io.jax_settings import compiled, quick_compilation
from foveate.learning.devices import cores
from foveate.models.precision import suits_quick_compilation, warn_of_rounding
from foveate.models.problem import Problem
from foveate.models.robot import Robot
from foveate.names import Objective
from foveate.planning.receding import OpenLoop, Receding
from foveate.scenario.scenes import Scene, SceneSettings, checked
from foveate.simulation.records import PROTOCOLS, Episode, Observation, Policy, Protocol, Trace, Truth, observe
from foveate.simulation.rollout import rollout
from foveate.simulation.step import predict, start
from foveate.simulation.suites import scene_episodes
from foveate.simulation.team.rollout import first_observations

EPISODES_PER_CHUNK = 48
"""Episodes in a batch: every suite runs the same compiled program, and the built-in ones of 90 and 180 episodes, which
that hardly pads, leave work for every core. Other sizes round differently."""


@dataclass(frozen=True, kw_only=True)
class Suite:
    """Scenes with their noise, the same for every method; rows have a score by the `objective`, if there is one."""

    problem: Problem
    scenes: tuple[Scene, ...]
    episodes_per_scene: int
    seed: int
    episodes: Episode
    truth: Truth
    objective: Objective | None = None


def prepare(
    problem: Problem,
    settings: SceneSettings,
    scenes: Sequence[Scene],
    seed: int = 0,
    episodes: int = 1,
    objective: Objective | None = None,
) -> Suite:
    """Prepare a suite: scenes with the noise of their episodes, drawn from (seed, scene id, episode).

    Args:
        problem: Models of agent, sensor and targets.
        settings: Scene settings of the scenario.
        scenes: Scenes of the suite.
        seed: Seed of the noise.
        episodes: Episodes per scene.
        objective: Objective of a training, by which rows are scored too.
    """
    if not all(scene.horizon and len(scene.drift) == len(scene.targets) for scene in scenes):
        scenes = checked(scenes, problem.agent.space, settings)
    warn_of_rounding(problem, max(scene.horizon or 0 for scene in scenes))
    drawn = scene_episodes(problem, settings, scenes, seed, episodes)
    assert drawn.truth is not None, "scene_episodes always draws the truth"
    return Suite(
        problem=problem,
        scenes=tuple(scenes),
        episodes_per_scene=episodes,
        seed=seed,
        episodes=drawn,
        truth=drawn.truth,
        objective=objective,
    )


def _run(problem: Problem, policy: Policy, protocol: Protocol, episodes: Episode, key_data: jax.Array) -> Trace:
    keys = jax.random.wrap_key_data(key_data)
    return jax.vmap(lambda e, k: rollout(problem, policy, e, protocol, k))(episodes, keys)


_SIMULATE = {quick: compiled(_run, quick) for quick in (False, True)}


def compiles_quickly(problem: Problem, policy: Policy) -> bool:
    """True where `suits_quick_compilation`, and for a policy that is no planner, as `compiled` explains."""
    return suits_quick_compilation(problem) and not isinstance(policy, OpenLoop | Receding)


@jax.jit
def _keys(key, names, runs):
    """Fold scene and episode into the seed's key, so that a key depends on (seed, scene id, episode) alone."""
    return jax.vmap(lambda name, run: jax.random.fold_in(jax.random.fold_in(key, name), run))(names, runs)


def policy_keys(suite: Suite) -> jax.Array:
    """Keys of the policy's random numbers in every episode of a suite."""
    names = [zlib.crc32(scene.id.encode()) for scene in suite.scenes for _ in range(suite.episodes_per_scene)]
    runs = np.arange(len(names)) % suite.episodes_per_scene
    return _keys(jax.random.key(suite.seed), np.array(names, np.uint32), runs)


def evaluate_traces(
    suite: Suite,
    policy: Policy,
    protocol: Protocol,
    chunk: int = EPISODES_PER_CHUNK,
    report: Callable[[int], None] = lambda done: None,
) -> Trace:
    """Run a policy through every episode of a suite: one trace with a leading axis of episodes, as numpy arrays.

    Each core runs batches of `chunk` episodes; `report` takes the number of completed episodes.
    """
    count, keys = len(suite.scenes) * suite.episodes_per_scene, policy_keys(suite)
    simulate = _SIMULATE[compiles_quickly(suite.problem, policy)]
    # Slices of numpy arrays need no compiled programs.
    inputs = jax.tree.map(np.asarray, (suite.episodes, jax.random.key_data(keys)))

    def run(first: int) -> Trace:
        # Copies of the last episode fill the last chunk: every chunk then runs the same compiled program.
        rows = np.minimum(np.arange(first, first + chunk), count - 1)
        trace = simulate(suite.problem, policy, protocol, *jax.tree.map(lambda x: x[rows], inputs))
        return jax.tree.map(lambda x: np.asarray(x)[: count - first], trace)

    parts = []
    with ThreadPoolExecutor(cores()) as pool:
        for part in pool.map(run, range(0, count, chunk)):
            parts.append(part)
            report(min(count, chunk * len(parts)))
    return jax.tree.map(lambda *pieces: np.concatenate(pieces), *parts)


@eqx.filter_jit
def _first_observation(problem: Problem, episode: Episode) -> Observation:
    if episode.team is not None:
        return jax.tree.map(lambda x: x[0], first_observations(problem, episode, PROTOCOLS["true"]))
    problem = problem.of_map(episode.map_number)
    predicted = predict(problem, start(problem, episode, PROTOCOLS["true"]), episode.inputs[0])
    return observe(predicted, episode.inputs[0], episode.horizon, Robot.of(problem))


def decision_time(
    problem: Problem, policy: Policy, episode: Episode, repeats: int = 30, with_start: bool = False
) -> float:
    """Median time of one compiled decision for one agent [s], run by itself.

    `with_start` adds each decision's share of the policy's start, for planners that plan there.
    """
    observation, key = _first_observation(problem, episode), jax.random.key(0)
    arrays, static = eqx.partition(policy, eqx.is_array)
    options = quick_compilation() if compiles_quickly(problem, policy) else {}
    begin = jax.jit(lambda arrays, seen: eqx.combine(arrays, static).start(seen), compiler_options=options)
    decide = jax.jit(lambda arrays, *seen: eqx.combine(arrays, static)(*seen), compiler_options=options)
    memory = begin(arrays, observation)
    decision_s = _median_time(lambda: decide(arrays, observation, memory, key), repeats)
    start_s = _median_time(lambda: begin(arrays, observation), repeats) if with_start else 0.0
    return decision_s + start_s / int(episode.horizon)


def _median_time(call: Callable[[], Any], repeats: int) -> float:
    """Median wall time of a call and its computation [s], after a first call that compiles."""
    jax.block_until_ready(call())
    times = []
    for _ in range(repeats):
        start_s = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - start_s)
    return float(np.median(times))


def evaluate(suite: Suite, method: str, policy: Policy, protocols: Iterable[str]) -> list[Row]:
    """Run a policy on a suite under each protocol: one row an episode."""
    protocols = tuple(protocols)
    with ThreadPoolExecutor() as pool:  # compilation, most of the wait, runs side by side
        traces = list(pool.map(lambda name: evaluate_traces(suite, policy, PROTOCOLS[name]), protocols))
    step_time = decision_time(suite.problem, policy, jax.tree.map(lambda x: np.asarray(x)[0], suite.episodes))
    times = [step_time] * len(suite.truth.state)
    return [
        row
        for protocol, trace in zip(protocols, traces, strict=True)
        for row in episode_rows(suite, method, protocol, trace, times)
    ]


def episode_rows(suite: Suite, method: str, protocol: str, trace: Trace, step_times: Sequence[float]) -> list[Row]:
    """Rows of the traces of a method, one an episode; `step_times` [s] are those of a decision in each episode."""
    count = suite.episodes_per_scene
    scenes = [scene for scene in suite.scenes for _ in range(count)]
    truth, scans = np.asarray(suite.truth.state), suite.episodes.scans
    if scans is None:
        measured = measures(suite.problem, trace, truth, scenes, suite.objective)
        teams = team_measures(trace.team, scenes, suite.objective)
    else:
        alive = np.asarray(scans.alive)
        measured = detection_measures(suite.problem, trace, truth, alive, scenes, suite.objective)
        teams = member_measures(suite.problem, trace.team, truth, alive, scenes, suite.objective)
    return [
        Row(
            scene=scene.id,
            episode=i % count,
            seed=suite.seed,
            method=method,
            protocol=protocol,
            motion=scene.motion,
            targets=len(scene.targets),
            step_time_s=step_time,
            **numbers,
            **team,
        )
        for i, (scene, numbers, team, step_time) in enumerate(zip(scenes, measured, teams, step_times, strict=True))
    ]
