"""Planners as methods of an evaluation: same scenes, noise and rows as every policy."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Lock

import jax
import jax.numpy as jnp

from foveate.evaluation.evaluate import Row, decision_time, episode_rows, evaluate_traces, prepare
from foveate.models.problem import Problem
from foveate.planning.receding import OpenLoop, Receding
from foveate.planning.shooting import PlanSettings
from foveate.scenario.scenes import Scene, SceneSettings
from foveate.simulation.records import PROTOCOLS, Policy, Trace

TOGETHER = 16
"""Episodes of one size that run side by side."""


WINDOW = 30
"""Most steps that an online plan looks ahead, unless told otherwise."""


def planner(
    problem: Problem, settings: PlanSettings, horizon: int, window: int = WINDOW, policy: Policy | None = None
) -> Receding:
    """The receding-horizon planner of episodes of so many steps; with a policy, one that refines it."""
    return Receding(
        problem=problem, settings=settings, window=min(window, horizon), horizon=jnp.array(horizon), policy=policy
    )


def planner_rows(
    problem: Problem,
    scene_settings: SceneSettings,
    scenes: Sequence[Scene],
    method: str,
    policy_of: Callable[[int], Policy],
    protocol: str,
    seed: int = 0,
    episodes: int = 1,
    report: Callable[[int], None] = lambda done: None,
) -> list[Row]:
    """One row an episode, in the order of the scenes; `policy_of` gives the planner for episodes of so many steps.

    Scenes of one size share a program, so that no planner plans for padding; `report` is called with the number
    of episodes that are done. `step_time_s` is that of the largest size, as for a policy in an evaluation.
    """
    sizes: dict[tuple[int, int], list[Scene]] = {}
    for scene in scenes:
        sizes.setdefault((len(scene.targets), scene.horizon), []).append(scene)
    suites = {size: prepare(problem, scene_settings, group, seed, episodes) for size, group in sizes.items()}
    done, lock = dict.fromkeys(sizes, 0), Lock()

    def run(size: tuple[int, int]) -> Trace:
        count = len(sizes[size]) * episodes

        def tell(more: int) -> None:
            with lock:
                done[size] = more
                report(sum(done.values()))

        return evaluate_traces(suites[size], policy_of(size[1]), PROTOCOLS[protocol], min(TOGETHER, count), tell)

    with ThreadPoolExecutor(os.cpu_count()) as pool:  # compilation, most of the wait, runs side by side
        traces = dict(zip(sizes, pool.map(run, sizes), strict=True))
    largest = max(sizes)
    policy, first = policy_of(largest[1]), jax.tree.map(lambda x: x[0], suites[largest].episodes)
    time = decision_time(problem, policy, first, with_start=isinstance(policy, OpenLoop))
    found: dict[str, list[Row]] = {}
    for size, suite in suites.items():
        for row in episode_rows(suite, method, protocol, traces[size], [time] * (len(sizes[size]) * episodes)):
            found.setdefault(row.scene, []).append(row)
    return [row for scene in scenes for row in found[scene.id]]
