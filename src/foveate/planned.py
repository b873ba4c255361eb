"""Planners as methods of an evaluation: same scenes, noise and rows as every policy."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp

from foveate.evaluation import Row, decision_time, prepare, rows_of, simulate
from foveate.planning.receding import OpenLoop, Receding
from foveate.planning.shooting import PlanSettings
from foveate.problem import Policy, Problem
from foveate.rollout import PROTOCOLS
from foveate.scenario import SceneSettings
from foveate.scenes import Scene

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
    of episodes that are done.
    """
    sizes: dict[tuple[int, int], list[Scene]] = {}
    for scene in scenes:
        sizes.setdefault((len(scene.targets), scene.horizon), []).append(scene)
    found: dict[str, list[Row]] = {}
    done = 0
    for (_, horizon), group in sizes.items():
        suite, policy = prepare(problem, scene_settings, group, seed, episodes), policy_of(horizon)
        count = len(group) * episodes
        first = jax.tree.map(lambda x: x[0], suite.episodes)
        trace = simulate(
            suite, policy, PROTOCOLS[protocol], min(TOGETHER, count), lambda more, before=done: report(before + more)
        )
        time = decision_time(problem, policy, first, with_start=isinstance(policy, OpenLoop))
        for row in rows_of(suite, method, protocol, trace, [time] * count):
            found.setdefault(row.scene, []).append(row)
        done += count
    return [row for scene in scenes for row in found[scene.id]]
