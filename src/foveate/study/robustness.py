"""Worlds that differ from the one a policy was trained in, one factor at a time, and what methods score there."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import jax
import numpy as np

from foveate.evaluation.bounds import lower_bounds, normalised_score
from foveate.evaluation.evaluate import evaluate_traces, prepare
from foveate.evaluation.metrics import measures
from foveate.evaluation.statistics import mean_interval, paired
from foveate.experiment.experiment import Experiment
from foveate.scenario.scenario import Scenario
from foveate.simulation.records import PROTOCOLS, Policy
from foveate.simulation.suites import suite
from foveate.study.methods import Acting, Bench, Method, Report

TARGETS = 5
"""In every scene, where their number is not the factor."""


ORACLE = "omniscient"
"""The method that normalised_score is measured by."""


@dataclass(frozen=True, kw_only=True)
class Factor:
    """What is changed, to which values; `trained` is the range that training knew, from and to.

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
        """The value of the world as it is; of a range that training knew, the first that is measured."""
        low, high = self.trained
        return next(value for value in self.values if low <= value <= high)


@dataclass(frozen=True, kw_only=True)
class Point:
    """One method (of one training seed) in one changed world: score [nat per target] and share seen, a scene each."""

    factor: str
    value: float
    method: str
    training_seed: int | None
    floor: float
    scores: tuple[float, ...]
    seen: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A method in a changed world, in the mean over training seeds; intervals take scenes as independent.

    `difference` to its own score in the nominal world, scene by scene where the scenes are the same, else None.
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


def _with(part: str, *names: str) -> Callable[[Scenario, float], Scenario]:
    """The scenario with these fields of one of its parts at a value."""

    def change(scenario: Scenario, value: float) -> Scenario:
        old = getattr(scenario, part)
        new = {name: type(getattr(old, name))(value) for name in names}
        return replace(scenario, **{part: replace(old, **new)})

    return change


def _drift(scenario: Scenario, value: float) -> Scenario:
    drift = (value,) * len(scenario.scenes.drift_m_s)
    return replace(scenario, scenes=replace(scenario.scenes, drift_m_s=drift))


def _turn(scenario: Scenario, value: float) -> Scenario:
    return _with("agent", "w_max_rad_s")(scenario, float(np.radians(value)))


FACTORS = (
    Factor(name="W", label="process noise, std [m]", values=(0.0125, 0.025, 0.05, 0.1, 0.2), trained=(0.05, 0.05),
           change=_with("target", "process_std_m")),
    Factor(name="V", label="sensor noise, std [m]", values=(0.05, 0.1, 0.2, 0.4, 0.8), trained=(0.2, 0.2),
           change=_with("sensor", "std_m")),
    Factor(name="drift", label="drift up to [m/s]", values=(0.2, 0.4, 0.8, 1.6, 3.2), trained=(0.8, 0.8),
           change=_drift),
    Factor(name="targets", label="targets", values=(3.0, 5.0, 8.0, 12.0, 20.0), trained=(3.0, 8.0),
           change=_with("scenes", "targets_min", "targets_max"), same_scenes=False),
    Factor(name="depth", label="depth of the view [m]", values=(0.5, 1.0, 2.0, 4.0, 8.0), trained=(2.0, 2.0),
           change=_with("view", "depth_m")),
    Factor(name="angle", label="angle of the view [deg]", values=(30.0, 60.0, 90.0, 120.0, 150.0),
           trained=(120.0, 120.0), change=_with("view", "angle_deg")),
    Factor(name="speed", label="speed up to [m/s]", values=(1.0, 2.0, 4.0, 8.0, 16.0), trained=(4.0, 4.0),
           change=_with("agent", "v_max_m_s")),
    Factor(name="turn", label="turn rate up to [deg/s]", values=(15.0, 30.0, 60.0, 120.0, 240.0), trained=(60.0, 60.0),
           change=_turn),
)  # fmt: skip
"""Of the paper's world: a quarter to four times what training knew, as far as the factor goes."""


def changed_bench(world: Experiment, factor: Factor, value: float, scenes: int, seed: int, noise_seed: int) -> Bench:
    """Biased test scenes of the world with a factor changed: but for the factor, the same for every value."""
    plain = replace(world.scenario.scenes, targets_min=TARGETS, targets_max=TARGETS)
    scenario = factor.change(replace(world.scenario, scenes=plain), value)
    problem = scenario.problem()
    drawn = suite(scenario.scenes, problem, seed, scenario.scenes.targets_max, scenes, biased=True)
    return Bench(
        world=replace(world, scenario=scenario), suite=prepare(problem, scenario.scenes, drawn, seed=noise_seed)
    )


def points(
    benches: Mapping[float, Bench],
    factor: Factor,
    method: Method,
    training_seed: int | None,
    policy: Policy | None,
    protocol: str,
    report: Report,
) -> list[Point]:
    """A method in every world of a factor; `report` is called with the number of worlds that are done."""
    found = []
    for value, bench in benches.items():
        scores, seen = _scores(method, bench, protocol, policy)
        (floor,) = lower_bounds(bench.suite.problem, bench.suite.scenes).values()
        found.append(
            Point(
                factor=factor.name, value=value, method=method.name, training_seed=training_seed, floor=floor,
                scores=tuple(scores), seen=tuple(seen),
            )
        )  # fmt: skip
        report(len(found))
    return found


def _scores(method: Method, bench: Bench, protocol: str, policy: Policy | None) -> tuple[list[float], list[float]]:
    """Score and share of targets seen, scene by scene. Policies are not timed: timing would compile each anew."""
    if not isinstance(method, Acting):
        rows = method.rows(bench, protocol, policy, lambda done: None)
        return [row.score for row in rows if row.score is not None], [row.seen_fraction for row in rows]
    world, acting = bench.suite, method.policy(bench.world, policy)
    trace, truth = evaluate_traces(world, acting, PROTOCOLS[protocol], len(world.scenes)), np.asarray(world.truth.state)
    found = [
        measures(world.problem, jax.tree.map(lambda x, i=i: x[i], trace), truth[i], scene)
        for i, scene in enumerate(world.scenes)
    ]
    return [one["score"] for one in found], [one["seen_fraction"] for one in found]


def verdicts(factor: Factor, found: Sequence[Point]) -> list[Verdict]:
    """What the points of a factor say, a method after the other, in the order of the values."""
    ours = [point for point in found if point.factor == factor.name]
    grouped: dict[tuple[str, float], list[Point]] = {}
    for point in ours:
        grouped.setdefault((point.method, point.value), []).append(point)
    return [_verdict(factor, group, grouped) for group in grouped.values()]


def _verdict(factor: Factor, group: Sequence[Point], grouped: Mapping[tuple[str, float], Sequence[Point]]) -> Verdict:
    first = group[0]
    scores = _by_scene(group)
    best = grouped.get((ORACLE, first.value))
    nominal = _by_scene(grouped[first.method, factor.nominal])
    difference = paired(scores, nominal) if factor.same_scenes else None
    return Verdict(
        factor=factor.name,
        value=first.value,
        method=first.method,
        mean=float(scores.mean()),
        ci95=mean_interval(scores),
        seen_fraction=float(np.mean([point.seen for point in group])),
        floor=first.floor,
        normalised_score=None
        if best is None
        else normalised_score(float(scores.mean()), first.floor, float(_by_scene(best).mean())),
        difference=None if difference is None else difference.mean,
        difference_ci95=None if difference is None else difference.ci95,
        by_seed=tuple(float(np.mean(point.scores)) for point in group),
    )


def _by_scene(group: Sequence[Point]) -> np.ndarray:
    """The score of every scene, in the mean over training seeds."""
    return np.mean([point.scores for point in group], axis=0)


def as_json(factors: Sequence[Factor], found: Sequence[Point], facts: Mapping[str, Any]) -> dict[str, Any]:
    """All points and verdicts, factor by factor."""
    return {
        **facts,
        "factors": [
            {
                "name": factor.name,
                "label": factor.label,
                "trained": factor.trained,
                "verdicts": [asdict(one) for one in verdicts(factor, found)],
                "points": [asdict(point) for point in found if point.factor == factor.name],
            }
            for factor in factors
        ],
    }
