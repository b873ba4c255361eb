"""Measure what a filter loses by ignoring missed detections, and what using them gains.

    python experiments/non_detection.py [--run runs/best-0 ...] [--episodes 4] [--initial-error consistent]

Two filters run side by side on every episode of table1, with the same measurements. *plain* is the Kalman filter of the
true protocol, which ignores missed detections. *conditioned* replaces the belief of a target, at every step without a
measurement, by the Gaussian with the mean and covariance of the part outside the view. The policy observes the one, the
other, or the *mean* of the conditioned one with the covariance of the plain one. The first table has scores and errors
at the horizon, of both filters; the second the gain of observing another belief than the plain one; the third NEES
against the time since a target was last measured, over all steps.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from foveate.evaluation.evaluate import Suite, policy_keys, prepare
from foveate.evaluation.metrics import chi_square_band
from foveate.evaluation.statistics import paired
from foveate.experiment.checkpoint import load_run
from foveate.experiment.presets import PRESETS
from foveate.geometry.linalg import log_det_spd
from foveate.models.problem import Problem
from foveate.models.robot import Robot
from foveate.planning.named import heuristic_policy
from foveate.simulation.records import TRUE, Episode, Policy, State, observe
from foveate.simulation.step import act, instants, predict, start
from foveate.simulation.suites import table1
from foveate.types import Key

AGES = ((0, 0), (1, 1), (2, 2), (3, 4), (5, 8), (9, 99))
"""Groups of steps since a target was last measured, from and to; 0 is now."""
OBSERVED = ("plain", "conditioned", "mean")
"""Beliefs that the policy observes."""
HELD_STEPS = 3
"""Consecutive steps with a measurement that make a target held in view."""
HELD = f"held: seen in {HELD_STEPS} consecutive steps"


class Course(NamedTuple):
    """Visibility and both filters' results in an episode; the filters' axis is plain, conditioned."""

    visible: Bool[Array, "K n"]
    log_det: Float[Array, "K 2 n"]
    squared_error: Float[Array, "K 2 n"]
    nees: Float[Array, "K 2 n"]


def drive(problems: tuple[Problem, Problem], policy: Policy, episode: Episode, key: Key, observed: str) -> Course:
    """Run one episode under both filters; the policy observes the belief named by `observed`."""

    def step(carry, instant):
        states, memory = carry
        ahead = [predict(*pair, instant.known_input) for pair in zip(problems, states, strict=True)]
        plain, conditioned = ahead
        mixed = eqx.tree_at(lambda s: s.mean, plain, conditioned.mean)
        seen = {"plain": plain, "conditioned": conditioned, "mean": mixed}[observed]
        observation = observe(seen, instant.known_input, episode.horizon, Robot.of(problems[0]))
        action, memory = policy(observation, memory, jax.random.fold_in(key, seen.step))
        pairs = zip(problems, ahead, strict=True)
        plain, conditioned = (act(problem, TRUE, predicted, instant, action) for problem, predicted in pairs)
        assert instant.truth is not None, "episodes of a suite have truth"
        states = plain.state, conditioned.state
        errors = _errors(problems[0], states, instant.truth.state)
        return (states, memory), Course(plain.measured, *errors)

    steps, first = instants(episode), start(problems[0], episode, TRUE)
    first_input = jax.tree.map(lambda x: x[0], steps.known_input)
    predicted = predict(problems[0], first, first_input)
    memory = policy.start(observe(predicted, first_input, episode.horizon, Robot.of(problems[0])))
    return jax.lax.scan(step, ((first, first), memory), steps)[1]


def _errors(problem: Problem, states: tuple[State, State], truth: Float[Array, "n n_y"]):
    """Return log det, squared position error and NEES of every target, for both filters."""
    mean, information = jnp.stack([s.mean for s in states]), jnp.stack([s.information[0] for s in states])
    error = mean - truth
    squared_error = jnp.sum((error @ problem.motion.Z.T) ** 2, axis=-1)
    return log_det_spd(information), squared_error, jnp.einsum("fni,fnij,fnj->fn", error, information, error)


@eqx.filter_jit
def _drive_all(problems: tuple[Problem, Problem], policy: Policy, episodes: Episode, keys, observed: str) -> Course:
    return jax.vmap(lambda e, k: drive(problems, policy, e, k, observed))(episodes, keys)


def at_the_end(suite: Suite, course: Course) -> dict[tuple[str, int], list[dict[str, np.ndarray]]]:
    """Metrics of every episode at its horizon, by cell."""
    cells: dict[tuple[str, int], list[dict[str, np.ndarray]]] = {}
    for i in range(len(course.visible)):
        scene = suite.scenes[i // suite.episodes_per_scene]
        n, last = len(scene.targets), scene.horizon - 1
        cells.setdefault((scene.motion, n), []).append(
            {
                "seen": course.visible[i, : last + 1, :n].any(axis=0).mean(),
                "score": course.log_det[i, last, :, :n].mean(axis=-1),
                "rmse": np.sqrt(course.squared_error[i, last, :, :n].mean(axis=-1)),
                "nees": course.nees[i, last, :, :n].mean(axis=-1),
            }
        )
    return cells


def ages(suite: Suite, course: Course) -> list[tuple[str, int, np.ndarray]]:
    """Group target-steps by the time since the last measurement: name, count, mean NEES of both filters."""
    groups: dict[str, list[np.ndarray]] = {}
    for i in range(len(course.visible)):
        scene = suite.scenes[i // suite.episodes_per_scene]
        for j in range(len(scene.targets)):
            since, run = -1, 0
            for k in range(scene.horizon):
                seen = bool(course.visible[i, k, j])
                run = run + 1 if seen else 0
                since = 0 if seen else since + 1 if since >= 0 else -1
                for name in _groups(since, run):
                    groups.setdefault(name, []).append(course.nees[i, k, :, j])
    order = [HELD, *(_age_name(*age) for age in AGES), "never seen"]
    return [(name, len(groups[name]), np.mean(groups[name], axis=0)) for name in order if name in groups]


def _groups(since: int, run: int) -> list[str]:
    if since < 0:
        return ["never seen"]
    age = next(_age_name(first, last) for first, last in AGES if first <= since <= last)
    return [age, *[HELD] * (run >= HELD_STEPS)]


def _age_name(first: int, last: int) -> str:
    if last == 0:
        return "seen now"
    return f"seen {first} step{'s' * (first > 1)} ago" if first == last else f"seen {first} to {last} steps ago"


def main() -> None:
    """Print the three tables, in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--run", nargs="+", type=Path, default=[], help="run folders: trained policies")
    parser.add_argument("--method", nargs="+", default=["uncertain", "nearest"], help="heuristics")
    parser.add_argument("--episodes", type=int, default=4, help="noise realisations per scene")
    parser.add_argument("--initial-error", choices=("paper", "consistent"), default="consistent")
    parser.add_argument("--seed", type=int, default=0, help="seed of the noise")
    given = parser.parse_args()
    scenario = PRESETS["paper"].scenario
    scenario = replace(scenario, scenes=replace(scenario.scenes, initial_error=given.initial_error))
    problem = scenario.problem()
    suite = prepare(problem, scenario.scenes, table1(problem), given.seed, given.episodes)
    problems, keys = (
        (problem, replace(problem, sensor=replace(problem.sensor, uses_missed_detections=True))),
        policy_keys(suite),
    )
    policies = {name: heuristic_policy(name, problem, float(scenario.view.depth_m)) for name in given.method}
    policies |= {str(run): load_run(run)[1] for run in given.run}
    courses = {}
    for name, policy in policies.items():
        for observed in OBSERVED:
            course = _drive_all(problems, policy, suite.episodes, keys, observed)
            courses[name, observed] = jax.tree.map(np.asarray, course)
    print_ends(suite, courses)
    print_differences(suite, courses)
    print_ages(suite, courses)


def print_ends(suite: Suite, courses: dict[tuple[str, str], Course]) -> None:
    """Print scores and errors at the horizon, by cell."""
    print(
        "| policy | observes | cell | seen | score, plain | rmse [m], plain / conditioned | NEES, plain / conditioned |"
    )
    print("|---|---|---|---:|---:|---:|---:|")
    for (name, observed), course in courses.items():
        for (motion, n), rows in at_the_end(suite, course).items():
            mean = {key: np.mean([row[key] for row in rows], axis=0) for key in rows[0]}
            print(
                f"| {name} | {observed} | {n} {motion} | {mean['seen']:.0%} | {mean['score'][0]:.2f} "
                f"| {mean['rmse'][0]:.2f} / {mean['rmse'][1]:.2f} | {mean['nees'][0]:.2f} / {mean['nees'][1]:.2f} |"
            )


def print_differences(suite: Suite, courses: dict[tuple[str, str], Course]) -> None:
    """Print the gain over observing the plain belief, paired by scene over all cells, with the same noise."""
    print("\n| policy | observes | true score, less that of plain | its 95 % interval |\n|---|---|---:|---:|")

    def by_scene(course: Course) -> np.ndarray:
        scores = [row["score"][0] for rows in at_the_end(suite, course).values() for row in rows]
        return np.reshape(scores, (-1, suite.episodes_per_scene)).mean(axis=1)

    for (name, observed), course in courses.items():
        if observed != "plain":
            gain = paired(by_scene(course), by_scene(courses[name, "plain"]))
            print(f"| {name} | {observed} | {gain.mean:+.2f} | {gain.ci95[0]:+.2f} to {gain.ci95[1]:+.2f} |")


def print_ages(suite: Suite, courses: dict[tuple[str, str], Course]) -> None:
    """Print NEES against the time since a target was last measured. The band treats target-steps as independent."""
    print("\n| policy | observes | target | target-steps | NEES, plain | conditioned | 95 % band |")
    print("|---|---|---|---:|---:|---:|---:|")
    size = suite.problem.motion.state_size
    for (name, observed), course in courses.items():
        for group, count, nees in ages(suite, course):
            low, high = chi_square_band(size, count)
            print(
                f"| {name} | {observed} | {group} | {count} | {nees[0]:.2f} | {nees[1]:.2f} | {low:.2f} .. {high:.2f} |"
            )


if __name__ == "__main__":
    main()
