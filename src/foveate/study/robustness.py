"""Robustness: scores in scenarios that differ from the one of the training, one factor at a time."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from foveate.evaluation.bounds import lower_bounds, normalised_score
from foveate.evaluation.evaluate import episode_rows, evaluate_traces, prepare
from foveate.evaluation.statistics import mean_interval, paired
from foveate.experiment.experiment import Experiment
from foveate.io.grouping import group_by
from foveate.scenario.factors import Factor
from foveate.simulation.records import PROTOCOLS, Policy
from foveate.simulation.suites import Cell, suite
from foveate.study.methods import Acting, Benchmark, Method

TARGETS = 5
"""In every scene, unless their number is the factor."""

ORACLE = "omniscient"
"""Name of the method whose normalised_score is 1."""


@dataclass(frozen=True, kw_only=True)
class Point:
    """One method (of one training seed) in one changed scenario: score [nat per target] and share seen of each scene.

    `lower_bound` is the lower bound, the mean score of never seeing anything [nat per target].
    """

    factor: str
    value: float
    method: str
    training_seed: int | None
    lower_bound: float
    scores: Sequence[float]
    seen: Sequence[float]


def point_of(record: dict[str, Any]) -> Point:
    """Read a point from its fields; `lower_bound` was called `floor` in version 0.1."""
    return Point(**{"lower_bound" if name == "floor" else name: value for name, value in record.items()})


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A method in a changed scenario, mean over training seeds; intervals take scenes as independent.

    `difference` to its own score in the nominal scenario, scene by scene; None if the factor changes the scenes.
    """

    factor: str
    value: float
    method: str
    mean: float
    ci95: tuple[float, float]
    seen_fraction: float
    lower_bound: float
    normalised_score: float | None
    difference: float | None
    difference_ci95: tuple[float, float] | None
    by_seed: tuple[float, ...]


def changed_benchmark(
    experiment: Experiment, factor: Factor, value: float, scenes: int, seed: int, noise_seed: int
) -> Benchmark:
    """Biased test scenes of a scenario with a factor changed: except for the factor, the same for every value."""
    plain = replace(experiment.scenario.scenes, targets_min=TARGETS, targets_max=TARGETS)
    scenario = factor.change(replace(experiment.scenario, scenes=plain), value)
    problem = scenario.problem()
    drawn = suite(scenario.scenes, problem, seed, [Cell(scenario.scenes.targets_max, biased=True)], scenes)
    prepared = prepare(problem, scenario.scenes, drawn, seed=noise_seed)
    return Benchmark(experiment=replace(experiment, scenario=scenario), suite=prepared)


def measure(method: Method, benchmark: Benchmark, protocol: str, policy: Policy | None) -> dict[str, Any]:
    """Measure the fields `lower_bound`, `scores` and `seen` of a `Point`."""
    suite = benchmark.suite
    if isinstance(method, Acting):  # not timed, unlike in `rows`: timing would compile each policy again
        acting = method.policy(benchmark.experiment, policy)
        trace = evaluate_traces(suite, acting, PROTOCOLS[protocol], len(suite.scenes))
        rows = episode_rows(suite, method.name, protocol, trace, [0.0] * len(suite.scenes))
    else:
        rows = method.rows(benchmark, protocol, policy, lambda done: None)
    (lower_bound,) = lower_bounds(suite.problem, suite.scenes).values()
    scores = [row.score for row in rows if row.score is not None]
    return {"lower_bound": lower_bound, "scores": scores, "seen": [row.seen_fraction for row in rows]}


def verdicts(factor: Factor, points: Sequence[Point]) -> list[Verdict]:
    """Verdicts of a factor, method after method, in the order of the values."""
    ours = [point for point in points if point.factor == factor.name]
    groups = group_by(ours, lambda point: (point.method, point.value))
    scores = {key: np.mean([point.scores for point in group], axis=0) for key, group in groups.items()}
    return [_verdict(factor, group, scores) for group in groups.values()]


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
        lower_bound=first.lower_bound,
        normalised_score=None if oracle is None else normalised_score(mean, first.lower_bound, float(oracle.mean())),
        difference=None if change is None else change.mean,
        difference_ci95=None if change is None else change.ci95,
        by_seed=tuple(float(np.mean(point.scores)) for point in group),
    )


def as_json(factors: Sequence[Factor], points: Sequence[Point], facts: Mapping[str, Any]) -> dict[str, Any]:
    """All points and verdicts, factor by factor."""
    described = []
    for factor in factors:
        about = {"name": factor.name, "label": factor.label, "trained": factor.trained}
        results = [asdict(verdict) for verdict in verdicts(factor, points)]
        ours = [asdict(point) for point in points if point.factor == factor.name]
        described.append({**about, "verdicts": results, "points": ours})
    return {**facts, "factors": described}
