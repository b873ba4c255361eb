"""Scenarios that differ by one factor differ in nothing else; what is made of their scores, by scipy."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.points import DOUBLING, SCORES, random_points
from scipy import stats

from foveate.evaluation.evaluate import evaluate
from foveate.experiment.presets import PRESETS
from foveate.planning.named import heuristic_policy
from foveate.scenario.factors import FACTORS
from foveate.simulation.suites import table1
from foveate.study.methods import Fixed
from foveate.study.robustness import as_json, changed_benchmark, measure, verdicts
from foveate.study.tables import robustness

PAPER = PRESETS["paper"]
BY_NAME = {factor.name: factor for factor in FACTORS}


def test_scenes_are_those_of_table1_and_the_same_for_every_value():
    drift = BY_NAME["drift"]
    benches = {value: changed_benchmark(PAPER, drift, value, 3, 2023, 0) for value in (0.4, 0.8)}
    scenes = [scene for scene in table1(PAPER.scenario.problem()) if scene.id.startswith("biased-5-")][:3]
    assert list(benches[0.8].suite.scenes) == scenes
    for half, whole in zip(benches[0.4].suite.scenes, scenes, strict=True):
        assert (half.id, half.agent, half.targets) == (whole.id, whole.agent, whole.targets)
        np.testing.assert_allclose(half.drift, np.array(whole.drift) / 2, atol=1e-6)


@pytest.mark.slow
def test_points_equal_an_evaluation():
    def nearest(experiment):
        return heuristic_policy("nearest", experiment.scenario.problem(), experiment.scenario.view.depth_m)

    method = Fixed(name="nearest", make=nearest)
    benchmarks = {value: changed_benchmark(PAPER, BY_NAME["V"], value, 2, 2023, 0) for value in (0.2, 0.4)}
    measured = {value: measure(method, benchmark, "true", None) for value, benchmark in benchmarks.items()}
    rows = evaluate(benchmarks[0.4].suite, "nearest", nearest(benchmarks[0.4].experiment), ("true",))
    assert measured[0.4]["scores"] == pytest.approx([row.score for row in rows], abs=1e-9)
    assert measured[0.4]["seen"] == pytest.approx([row.seen_fraction for row in rows])
    # Never seen: the variance grows from 2 m^2 by 0.05^2 a step for 15 steps.
    assert measured[0.2]["lower_bound"] == pytest.approx(-2 * np.log(2.0 + 15 * 0.05**2))


def test_the_table_omits_a_meaningless_normalised_score():
    """A method may pass the omniscient planner, which is then the weaker of the two."""
    best = [replace(one, scores=(9.0 if one.value == 1.0 else 2.0,) * 12) for one in random_points()[-2:]]
    found = robustness([DOUBLING], [*random_points()[:-2], *best])
    mean = SCORES.mean(axis=(0, 2))
    (_, method, *cells), (_, oracle, *highest) = found.rows
    assert (method, oracle, highest[0]) == ("net", "omniscient", "9.00 ± 0.00")
    assert cells[0].startswith(f"{mean[0]:.2f} ± ")
    assert [cell.rpartition(" ")[2] for cell in cells] == [f"({(mean[0] + 1) / 10:.2f})", "(-)"]


def test_verdicts():
    found = {(one.method, one.value): one for one in verdicts(DOUBLING, random_points())}
    mean = SCORES.mean(axis=0)
    net = found["net", 2.0]
    assert net.mean == pytest.approx(mean[1].mean())
    assert net.ci95 == pytest.approx(stats.t.interval(0.95, 11, loc=mean[1].mean(), scale=stats.sem(mean[1])))
    assert net.normalised_score == pytest.approx((mean[1].mean() + 1) / 8)
    assert net.by_seed == pytest.approx(SCORES[:, 1].mean(axis=1))
    change = mean[1] - mean[0]
    assert net.difference == pytest.approx(change.mean())
    assert net.difference_ci95 == pytest.approx(stats.t.interval(0.95, 11, loc=change.mean(), scale=stats.sem(change)))
    assert found["omniscient", 1.0].normalised_score == pytest.approx(1.0)
    (others, _, _, _) = verdicts(replace(DOUBLING, same_scenes=False), random_points())
    assert others.difference is None
    alone = [point for point in random_points() if point.method == "net"]
    assert {one.normalised_score for one in verdicts(DOUBLING, alone)} == {None}
    data = as_json([DOUBLING], random_points(), {"protocol": "true"})
    assert [len(data["factors"][0][part]) for part in ("verdicts", "points")] == [4, 6]
