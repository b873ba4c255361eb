"""Robustness: scores in scenarios that differ from the one a policy was trained in, one factor at a time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import jax
import numpy as np

from foveate.evaluation.bounds import lower_bounds, normalised_score
from foveate.evaluation.evaluate import prepare, simulate
from foveate.evaluation.metrics import measures
from foveate.evaluation.statistics import group_by, mean_interval, paired
from foveate.experiment.experiment import Experiment
from foveate.scenario.scenario import Scenario
from foveate.simulation.records import PROTOCOLS, Policy
from foveate.simulation.suites import suite
from foveate.study.methods import Acting, Benchmark, Method

TARGETS = 5
"""In every scene, where their number is not the factor."""

ORACLE = "omniscient"
"""The method that normalised_score is measured by."""


@dataclass(frozen=True, kw_only=True)
class Factor:
    """A property of the scenario and its values; `trained` is the range that training knew, from and to.

    `same_scenes`: whether scenes of different values differ in nothing else, and can be compared one by one.
    """

    name: str
    label: str
    values: tuple[float, ...]
    trained: tuple[float, float]
    change: Callable[[Scenario, float], Scenario]
    same_scenes: bool = True

    @property
    def nominal(self) -> float:
        """The unchanged value; of a range that training knew, the first that is measured."""
        low, high = self.trained
        return next(value for value in self.values if low <= value <= high)


@dataclass(frozen=True, kw_only=True)
class Point:
    """One method (of one training seed) in one changed scenario: score [nat per target] and share seen, a scene each.

    `floor` is the lower bound, the mean score of never seeing anything.
    """

    factor: str
    value: float
    method: str
    training_seed: int | None
    floor: float
    scores: Sequence[float]
    seen: Sequence[float]


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A method in a changed scenario, mean over training seeds; intervals take scenes as independent.

    `difference` to its own score in the nominal scenario, scene by scene where the scenes are the same, else None.
    """

    factor: str
    value: float
    method: str
    mean: float
    ci95: tuple[float, float]
    seen_fraction: float
    floor: float
    normalised_score: float | None
    difference: float | None
    difference_ci95: tuple[float, float] | None
    by_seed: tuple[float, ...]


def _set(part: str, *names: str, scale: float = 1.0) -> Callable[[Scenario, float], Scenario]:
    """A change that sets these fields of a part of the scenario to the value, times `scale`."""

    def change(scenario: Scenario, value: float) -> Scenario:
        old = getattr(scenario, part)
        new: dict[str, Any] = {}
        for name in names:
            field = getattr(old, name)
            new[name] = (value,) * len(field) if isinstance(field, tuple) else type(field)(scale * value)
        return replace(scenario, **{part: replace(old, **new)})

    return change


FACTORS = (
    Factor(name="W", label="process noise, std [m]", values=(0.0125, 0.025, 0.05, 0.1, 0.2), trained=(0.05, 0.05),
           change=_set("target", "process_std_m")),
    Factor(name="V", label="sensor noise, std [m]", values=(0.05, 0.1, 0.2, 0.4, 0.8), trained=(0.2, 0.2),
           change=_set("sensor", "std_m")),
    Factor(name="drift", label="drift up to [m/s]", values=(0.2, 0.4, 0.8, 1.6, 3.2), trained=(0.8, 0.8),
           change=_set("scenes", "drift_m_s")),
    Factor(name="targets", label="targets", values=(3.0, 5.0, 8.0, 12.0, 20.0), trained=(3.0, 8.0),
           change=_set("scenes", "targets_min", "targets_max"), same_scenes=False),
    Factor(name="depth", label="depth of the view [m]", values=(0.5, 1.0, 2.0, 4.0, 8.0), trained=(2.0, 2.0),
           change=_set("view", "depth_m")),
    Factor(name="angle", label="angle of the view [deg]", values=(30.0, 60.0, 90.0, 120.0, 150.0),
           trained=(120.0, 120.0), change=_set("view", "angle_deg")),
    Factor(name="speed", label="speed up to [m/s]", values=(1.0, 2.0, 4.0, 8.0, 16.0), trained=(4.0, 4.0),
           change=_set("agent", "v_max_m_s")),
    Factor(name="turn", label="turn rate up to [deg/s]", values=(15.0, 30.0, 60.0, 120.0, 240.0), trained=(60.0, 60.0),
           change=_set("agent", "w_max_rad_s", scale=np.pi / 180)),
)  # fmt: skip
"""Of the paper's scenario: a quarter to four times what training knew, as far as the factor goes."""


def changed_benchmark(
    experiment: Experiment, factor: Factor, value: float, scenes: int, seed: int, noise_seed: int
) -> Benchmark:
    """Biased test scenes of a scenario with a factor changed: but for the factor, the same for every value."""
    plain = replace(experiment.scenario.scenes, targets_min=TARGETS, targets_max=TARGETS)
    scenario = factor.change(replace(experiment.scenario, scenes=plain), value)
    problem = scenario.problem()
    drawn = suite(scenario.scenes, problem, seed, scenario.scenes.targets_max, scenes, biased=True)
    prepared = prepare(problem, scenario.scenes, drawn, seed=noise_seed)
    return Benchmark(experiment=replace(experiment, scenario=scenario), suite=prepared)


def measure(method: Method, benchmark: Benchmark, protocol: str, policy: Policy | None) -> dict[str, Any]:
    """The measured fields of a `Point`. Policies are not timed: timing would compile each again."""
    suite = benchmark.suite
    (floor,) = lower_bounds(suite.problem, suite.scenes).values()
    if isinstance(method, Acting):
        acting = method.policy(benchmark.experiment, policy)
        trace, truth = simulate(suite, acting, PROTOCOLS[protocol], len(suite.scenes)), np.asarray(suite.truth.state)
        rows = [
            measures(suite.problem, jax.tree.map(lambda x, i=i: x[i], trace), truth[i], scene)
            for i, scene in enumerate(suite.scenes)
        ]
    else:
        rows = [asdict(row) for row in method.rows(benchmark, protocol, policy, lambda done: None)]
    scores = [row["score"] for row in rows if row["score"] is not None]
    return {"floor": floor, "scores": scores, "seen": [row["seen_fraction"] for row in rows]}


def verdicts(factor: Factor, points: Sequence[Point]) -> list[Verdict]:
    """Verdicts of a factor, method after method, in the order of the values."""
    ours = [point for point in points if point.factor == factor.name]
    grouped = group_by(ours, lambda point: (point.method, point.value))
    scores = {key: np.mean([point.scores for point in group], axis=0) for key, group in grouped.items()}
    return [_verdict(factor, group, scores) for group in grouped.values()]


def _verdict(factor: Factor, group: Sequence[Point], scores: Mapping[tuple[str, float], np.ndarray]) -> Verdict:
    """The verdict of one method and value; `scores` of every scene, mean over training seeds, by method and value."""
    first = group[0]
    own, oracle = scores[first.method, first.value], scores.get((ORACLE, first.value))
    change = paired(own, scores[first.method, factor.nominal]) if factor.same_scenes else None
    mean = float(own.mean())
    return Verdict(
        factor=factor.name,
        value=first.value,
        method=first.method,
        mean=mean,
        ci95=mean_interval(own),
        seen_fraction=float(np.mean([point.seen for point in group])),
        floor=first.floor,
        normalised_score=None if oracle is None else normalised_score(mean, first.floor, float(oracle.mean())),
        difference=None if change is None else change.mean,
        difference_ci95=None if change is None else change.ci95,
        by_seed=tuple(float(np.mean(point.scores)) for point in group),
    )


def as_json(factors: Sequence[Factor], points: Sequence[Point], facts: Mapping[str, Any]) -> dict[str, Any]:
    """All points and verdicts, factor by factor."""

    def listed(factor: Factor) -> dict[str, Any]:
        return {
            "name": factor.name,
            "label": factor.label,
            "trained": factor.trained,
            "verdicts": [asdict(verdict) for verdict in verdicts(factor, points)],
            "points": [asdict(point) for point in points if point.factor == factor.name],
        }

    return {**facts, "factors": [listed(factor) for factor in factors]}
