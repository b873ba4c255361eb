"""The omniscient planner against every other method on its own problem, and its plans kept by content."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.evaluation import oracle
from foveate.evaluation.bounds import unseen_scores
from foveate.evaluation.evaluate import episode_rows, evaluate_traces, prepare
from foveate.evaluation.oracle import omniscient, omniscient_rows
from foveate.evaluation.summary import summarise
from foveate.io.npz import load_arrays, save_arrays
from foveate.planning.named import heuristic_policy
from foveate.planning.shooting import PAPER, PlanSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene
from foveate.simulation.records import TRUE

SCENARIO = Scenario()
PROBLEM = SCENARIO.problem()
STILL = ((0.0, 0.0),) * 2
SCENES = [
    Scene(id="a", agent=(0.0, 0.0, 0.5), targets=((3.0, 1.0), (-2.0, 2.0)), drift=STILL, horizon=5),
    Scene(id="b", agent=(1.0, 0.0, 0.0), targets=((3.0, -1.0),), drift=((0.3, 0.0),), horizon=3),
    Scene(id="c", agent=(0.0, 1.0, 2.0), targets=((-1.0, -1.0), (2.0, 4.0)), drift=STILL, horizon=5),
    Scene(id="none", agent=(0.0, 0.0, 0.0), targets=(), drift=(), horizon=3),
]
FEW = PlanSettings(starts=8, iterations=20)


@pytest.fixture(scope="module")
def suite():
    return prepare(PROBLEM, SCENARIO.scenes, SCENES, seed=1)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache") / "plans"


@pytest.fixture(scope="module")
def plans(suite, cache):
    done = []
    result = omniscient(suite, "true", FEW, cache, done.append)
    assert done[-1] == len(SCENES)
    assert done == sorted(done)
    return result


@pytest.mark.slow
def test_rows_are_those_of_an_evaluation(suite, plans):
    rows = omniscient_rows(suite, "true", plans)
    assert [row.scene for row in rows] == [scene.id for scene in SCENES]
    assert {row.method for row in rows} == {"omniscient"}
    assert rows[3].score is None
    np.testing.assert_allclose([row.score for row in rows[:3]], plans.score[:3], rtol=1e-12)
    trace = oracle._drive(PROBLEM, jnp.asarray(plans.action), suite.episodes, TRUE, oracle.policy_keys(suite))
    driven = episode_rows(
        suite, "omniscient", "true", jax.tree.map(np.asarray, trace), [row.step_time_s for row in rows]
    )
    for row, real in zip(rows, driven, strict=True):
        # Score of the running filter along the plan: under `true` exactly the planned score.
        if row.targets:
            assert (row.score, row.entropy) == pytest.approx((real.score, real.entropy), rel=1e-9)
        assert replace(row, score=None, entropy=None) == replace(real, score=None, entropy=None)
    assert all(np.abs(plans.action).max(axis=(1, 2)) <= 1)
    summarise(rows, 2)


def test_a_policy_does_not_beat_the_omniscient(suite, plans):
    trace = evaluate_traces(suite, heuristic_policy("nearest", PROBLEM, 2.0), TRUE, chunk=4)
    scores = [row.score for row in episode_rows(suite, "nearest", "true", trace, [0.0] * 4)[:3]]
    assert (plans.score[:3] >= np.array(scores) - 1e-9).all()
    assert (plans.score[:3] > unseen_scores(PROBLEM, [5, 3, 5])).all()


def test_cached_plans_are_loaded(suite, plans, cache, monkeypatch):
    monkeypatch.setattr(oracle, "_solve_all", None)
    again = omniscient(suite, "true", FEW, cache)
    for name in ("action", "score", "seconds"):
        np.testing.assert_array_equal(getattr(again, name), getattr(plans, name))


def test_any_other_input_is_planned_again(suite, plans, cache, monkeypatch):
    called = []

    def solve_all(suite, futures, settings, report):
        called.append(settings)
        return np.zeros_like(plans.action), np.zeros_like(plans.seconds)

    monkeypatch.setattr(oracle, "_solve_all", solve_all)
    moved = [replace(SCENES[0], agent=(0.0, 0.0, 0.6)), *SCENES[1:]]
    renamed = [replace(SCENES[0], id="x"), *SCENES[1:]]
    louder = replace(SCENARIO, sensor=replace(SCENARIO.sensor, std_m=0.3)).problem()
    wider = replace(SCENARIO, view=replace(SCENARIO.view, angle_deg=100.0)).problem()
    others = [
        (prepare(PROBLEM, SCENARIO.scenes, moved, seed=1), "true", FEW),
        (prepare(PROBLEM, SCENARIO.scenes, renamed, seed=1), "true", FEW),
        (prepare(PROBLEM, SCENARIO.scenes, SCENES, seed=2), "true", FEW),
        (prepare(louder, SCENARIO.scenes, SCENES, seed=1), "true", FEW),
        (prepare(wider, SCENARIO.scenes, SCENES, seed=1), "true", FEW),
        (suite, "surrogate", FEW),
        (suite, "true", replace(FEW, iterations=21)),
        (suite, "true", replace(FEW, keep=PAPER)),
    ]
    for i, (other, protocol, settings) in enumerate(others):
        omniscient(other, protocol, settings, cache)
        assert len(called) == i + 1
    assert len(list(cache.iterdir())) == len(others) + 1


def test_a_damaged_file_is_computed_again(suite, plans, tmp_path, monkeypatch):
    called = []

    def solve_all(*_):
        called.append(1)
        return plans.action, plans.seconds

    monkeypatch.setattr(oracle, "_solve_all", solve_all)
    omniscient(suite, "true", FEW, tmp_path)
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    header, arrays = load_arrays(path, "plans", oracle.VERSION)
    other = tmp_path / "other.npz"
    save_arrays(other, arrays, {**header, "format": "foveate-plans", "content": "of something else"})
    short = tmp_path / "short.npz"
    cut = {name: array[1:] for name, array in arrays.items()}
    save_arrays(short, cut, {**header, "format": "foveate-plans"})
    broken_files = (whole[:-50], whole[:200] + b"\xff" + whole[201:], b"", other.read_bytes(), short.read_bytes())
    for count, broken in enumerate(broken_files):
        path.write_bytes(broken)
        result = omniscient(suite, "true", FEW, tmp_path)
        assert len(called) == count + 2
        np.testing.assert_array_equal(result.action, plans.action)
        assert path.read_bytes() == whole
    omniscient(suite, "true", FEW, tmp_path)
    assert len(called) == len(broken_files) + 1


def test_a_folder_that_cannot_be_written_costs_only_time(suite, plans, tmp_path, monkeypatch):
    monkeypatch.setattr(oracle, "_solve_all", lambda *_: (plans.action, plans.seconds))
    (tmp_path / "file").write_text("")
    with pytest.warns(UserWarning, match="not kept"):
        found = omniscient(suite, "true", FEW, tmp_path / "file" / "plans")
    np.testing.assert_array_equal(found.score, plans.score)
