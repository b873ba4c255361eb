"""Planners as methods of an evaluation: same scenes, noise and rows as every policy."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from threading import Lock

import jax

from foveate.evaluation.evaluate import Row, Suite, decision_time, episode_rows, evaluate_traces, prepare
from foveate.io.grouping import group_by
from foveate.learning.devices import cores
from foveate.models.problem import Problem
from foveate.planning.receding import OpenLoop, Receding
from foveate.planning.shooting import PlanSettings
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.records import PROTOCOLS, Policy, Trace

PLANS_PER_BATCH = 16
"""Episodes of one size that run side by side."""

WINDOW = 30
"""Default of the most steps that an online plan looks ahead."""

Size = tuple[int, int]
"""Number of targets, number of steps."""


def planner(
    problem: Problem, settings: PlanSettings, horizon: int, window: int = WINDOW, policy: Policy | None = None
) -> Receding:
    """Make the receding-horizon planner for episodes of `horizon` steps; with a policy, it refines that one's plan."""
    return Receding(problem=problem, settings=settings, window=min(window, horizon), policy=policy)


def planner_rows(
    suite: Suite,
    settings: SceneSettings,
    method: str,
    policy_of: Callable[[int], Policy],
    protocol: str,
    on_progress: Callable[[int], None] = lambda done: None,
) -> list[Row]:
    """Run a planner on a suite: one row an episode, in the order of the scenes.

    `settings` are those of the suite; `policy_of` makes the planner for a number of steps: scenes of one size share a
    program, so that no planner plans for padding. `on_progress` takes the number of completed episodes. `step_time_s`
    is that of the largest size, as for a policy in an evaluation.
    """
    sizes = group_by(suite.scenes, lambda scene: (len(scene.targets), scene.horizon))
    episodes = suite.episodes_per_scene
    rest = (suite.seed, episodes, suite.objective)
    suites = {size: prepare(suite.problem, settings, scenes, *rest) for size, scenes in sizes.items()}
    done, lock = dict.fromkeys(sizes, 0), Lock()

    def report(size: Size, count: int) -> None:
        with lock:
            done[size] = count
            on_progress(sum(done.values()))

    def run(size: Size) -> Trace:
        chunk = min(PLANS_PER_BATCH, len(sizes[size]) * episodes)
        return evaluate_traces(suites[size], policy_of(size[1]), PROTOCOLS[protocol], chunk, partial(report, size))

    with ThreadPoolExecutor(cores()) as pool:  # compilation, most of the wait, runs side by side
        traces = dict(zip(sizes, pool.map(run, sizes), strict=True))
    largest = max(sizes)
    policy, first = policy_of(largest[1]), jax.tree.map(lambda x: x[0], suites[largest].episodes)
    time = decision_time(suite.problem, policy, first, with_start=isinstance(policy, OpenLoop))
    rows = [
        row
        for size, part in suites.items()
        for row in episode_rows(part, method, protocol, traces[size], [time] * (len(part.scenes) * episodes))
    ]
    by_scene = group_by(rows, lambda row: row.scene)
    return [row for scene in suite.scenes for row in by_scene[scene.id]]
