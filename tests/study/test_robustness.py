"""Worlds that differ by one factor differ in nothing else; what is made of their scores, by scipy."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from helpers.points import DOUBLING, SCORES, random_points
from scipy import stats

from foveate.evaluation.evaluate import evaluate
from foveate.experiment.presets import PRESETS
from foveate.policies.heuristics import heuristic
from foveate.scenario.scenario import Scenario
from foveate.simulation.suites import table1
from foveate.study.methods import Fixed
from foveate.study.robustness import FACTORS, as_json, changed_bench, points, verdicts
from foveate.study.tables import worlds

WORLD = PRESETS["paper"]
BY_NAME = {factor.name: factor for factor in FACTORS}


def leaves(scenario):
    return {jax.tree_util.keystr(path): np.asarray(leaf)
            for path, leaf in jax.tree_util.tree_leaves_with_path(scenario.problem())}  # fmt: skip


CHANGED = {
    "W": (".motion.W", lambda v: v**2 * np.eye(2)),
    "V": (".sensor.V", lambda v: v**2 * np.eye(2)),
    "depth": (".sensor.view.vertices", lambda v: v * np.array([[0, 0], [1, -np.sqrt(3)], [1, np.sqrt(3)]])),
    "angle": (
        ".sensor.view.vertices",
        lambda v: 2 * np.array([[0, 0], [1, -np.tan(np.radians(v / 2))], [1, np.tan(np.radians(v / 2))]]),
    ),
    "speed": (".agent.upper", lambda v: np.array([v, np.pi / 3])),
    "turn": (".agent.upper", lambda v: np.array([4.0, np.radians(v)])),
    "drift": (None, None),
    "targets": (None, None),
}


@pytest.mark.parametrize("name", BY_NAME)
def test_a_factor_changes_what_it_says_and_nothing_else(name):
    factor, plain = BY_NAME[name], leaves(Scenario())
    where, expected = CHANGED[name]
    for value in factor.values:
        scenario = factor.change(Scenario(), value)
        found = leaves(scenario)
        for place, leaf in plain.items():
            if place == where:
                np.testing.assert_allclose(found[place], expected(value), atol=1e-9)
            elif not (name == "turn" and place == ".agent.lower"):  # a turn rate has two limits
                np.testing.assert_array_equal(found[place], leaf)
        scenes = {
            "drift": {"drift_m_s": (value, value)},
            "targets": dict.fromkeys(("targets_min", "targets_max"), int(value)),
        }
        assert scenario.scenes == replace(Scenario().scenes, **scenes.get(name, {}))
    if name != "targets":
        assert factor.change(Scenario(), factor.nominal).problem().tau == 1.0
        assert factor.trained == (factor.nominal, factor.nominal)
        np.testing.assert_allclose(
            np.concatenate([leaf.ravel() for leaf in leaves(factor.change(Scenario(), factor.nominal)).values()]),
            np.concatenate([leaf.ravel() for leaf in plain.values()]),
            atol=1e-9,
        )


def test_scenes_are_those_of_table1_and_the_same_for_every_value():
    drift = BY_NAME["drift"]
    benches = {value: changed_bench(WORLD, drift, value, 3, 2023, 0) for value in (0.4, 0.8)}
    scenes = [scene for scene in table1(WORLD.scenario.problem()) if scene.id.startswith("biased-5-")][:3]
    assert list(benches[0.8].suite.scenes) == scenes
    for half, whole in zip(benches[0.4].suite.scenes, scenes, strict=True):
        assert (half.id, half.agent, half.targets) == (whole.id, whole.agent, whole.targets)
        np.testing.assert_allclose(half.drift, np.array(whole.drift) / 2, atol=1e-6)


@pytest.mark.slow
def test_points_are_what_an_evaluation_says():
    def nearest(world):
        return heuristic("nearest", world.scenario.problem(), world.scenario.view.depth_m)

    factor = replace(BY_NAME["V"], values=(0.2, 0.4))
    benches = {value: changed_bench(WORLD, factor, value, 2, 2023, 0) for value in factor.values}
    told = []
    found = points(benches, factor, Fixed(name="nearest", make=nearest), 7, None, "true", told.append)
    assert told == [1, 2]
    assert [(one.factor, one.value, one.training_seed) for one in found] == [("V", 0.2, 7), ("V", 0.4, 7)]
    rows = evaluate(benches[0.4].suite, "nearest", nearest(benches[0.4].world), ("true",))
    assert found[1].scores == pytest.approx([row.score for row in rows], abs=1e-9)
    assert found[1].seen == pytest.approx([row.seen_fraction for row in rows])
    # Never seen: the variance grows from 2 m^2 by 0.05^2 a step for 15 steps.
    assert found[0].floor == pytest.approx(-2 * np.log(2.0 + 15 * 0.05**2))


def test_the_table_leaves_out_a_closeness_that_says_nothing():
    """Where a method passes the omniscient planner, that planner is the weak one."""
    best = [replace(one, scores=(9.0 if one.value == 1.0 else 2.0,) * 12) for one in random_points()[-2:]]
    found = worlds([DOUBLING], [*random_points()[:-2], *best])
    mean = SCORES.mean(axis=(0, 2))
    (_, method, *cells), (_, ceiling, *highest) = found.rows
    assert (method, ceiling, highest[0]) == ("net", "omniscient", "9.00 ± 0.00")
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
