"""Evaluation: rows of episodes, the same noise for every method, a consistent filter has a consistent NEES."""

from dataclasses import replace
from importlib.metadata import version

import jax
import numpy as np
import pytest

from foveate.evaluation.evaluate import evaluate, evaluate_traces, prepare
from foveate.evaluation.metrics import chi_square_band
from foveate.evaluation.summary import read_result, summarise, write_result
from foveate.evaluation.summary_table import summary_table
from foveate.planning.named import heuristic_policy
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene, SceneSettings
from foveate.simulation.records import TRUE

PAPER = Scenario().problem()
EVERYWHERE = Scenario(view=SectorView(depth_m=1e6, angle_deg=360.0), scenes=SceneSettings(initial_error="consistent"))
ALONE = Scene(id="alone", agent=(0.0, 0.0, 0.0), targets=((1.0, 0.3),), drift=((0.2, 0.0),), horizon=4)
THREE = Scene(id="three", agent=(0.0, 1.0, 2.0), targets=((1.0, 2.0),) * 3, drift=((0.0, 0.0),) * 3, horizon=6)
EMPTY = Scene(id="empty", agent=(0.0, 0.0, 0.0), targets=(), drift=(), horizon=3)


@pytest.fixture(scope="module")
def rows():
    suite = prepare(PAPER, SceneSettings(), [ALONE, THREE, EMPTY], seed=3, episodes=2)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("foveate.evaluation.evaluate.decision_time", lambda *_: 0.125)
        return suite, evaluate(suite, "still", heuristic_policy("still", PAPER, 2.0), ("surrogate", "true"))


def test_rows(rows, tmp_path):
    _, found = rows
    assert [(r.protocol, r.scene, r.episode) for r in found] == [
        (protocol, scene, k)
        for protocol in ("surrogate", "true")
        for scene in ("alone", "three", "empty")
        for k in (0, 1)
    ]
    assert {r.seed for r in found} == {3}
    assert {r.method for r in found} == {"still"}
    for row in found:
        assert row.step_time_s == 0.125
        assert row.targets == {"alone": 1, "three": 3, "empty": 0}[row.scene]
        assert row.motion == ("biased" if row.scene == "alone" else "unbiased")
        assert 0 <= row.seen_step_fraction <= row.seen_fraction <= 1
        if row.scene == "empty":
            assert row.score is row.entropy is None
        else:
            assert row.entropy == pytest.approx(np.log(2 * np.pi * np.e) - row.score / 2, abs=1e-12)
    write_result(tmp_path / "r.json", found, summarise(found, 2), {"experiment": "0123", "seed": 3})
    again, facts = read_result(tmp_path / "r.json")
    assert again == found
    device = f"{jax.device_count()} {jax.default_backend()}"
    assert facts.pop("device").startswith(device)
    assert facts == {
        "experiment": "0123",
        "seed": 3,
        "foveate": version("foveate"),
        "jax": jax.__version__,
        "precision": "float64",
    }


def test_detected_targets_are_the_same_under_both_protocols(rows):
    """Targets move without regard to the filter: an agent that stands still sees the same under both."""
    suite, found = rows
    half = len(found) // 2
    for soft, true in zip(found[:half], found[half:], strict=True):
        for name in ("seen_fraction", "seen_step_fraction", "longest_unseen_s"):
            assert getattr(soft, name) == getattr(true, name)
    assert any(r.seen_fraction > 0 for r in found)
    detected = evaluate_traces(suite, heuristic_policy("still", PAPER, 2.0), TRUE).visible
    for i, r in enumerate(found[half:]):
        horizon = suite.scenes[i // 2].horizon
        ever = [bool(detected[i, :horizon, j].any()) for j in range(r.targets)]
        assert r.seen_fraction == (sum(ever) / len(ever) if ever else 0.0)
    alone = [r for r in found if r.scene == "alone"]
    assert alone[0].score != alone[2].score


def test_scenes_without_targets_stay_out_of_the_summary(rows):
    _, found = rows
    cells = summarise(found, 2)
    assert [(c.protocol, c.motion, c.targets, c.episodes) for c in cells] == [
        (protocol, motion, n, 2) for protocol in ("surrogate", "true") for motion, n in (("biased", 1), ("unbiased", 3))
    ]
    assert summarise([r for r in found if r.targets == 0], 2) == []


@pytest.fixture(scope="module")
def always_seen():
    """Targets that are measured at every step, wherever the agent goes: 400 episodes."""
    suite = prepare(EVERYWHERE.problem(), EVERYWHERE.scenes, [THREE], seed=0, episodes=400)
    return suite, evaluate_traces(suite, heuristic_policy("random", suite.problem, 2.0), TRUE)


def test_an_honest_filter_has_an_honest_nees(always_seen):
    suite, trace = always_seen
    assert trace.visible.all()
    assert len(np.unique(trace.action)) == trace.action.size, "a new action every step"
    assert trace.mean.shape == (400, 7, 3, 2)
    error = trace.mean - np.asarray(suite.truth.state)
    nees = np.einsum("ekni,eknij,eknj->kn", error, trace.information, error) / 400
    low, high = chi_square_band(2, 400 * 3)
    for k in (0, 1, 3, 6):
        assert low < nees[k].mean() < high, f"after step {k}"
    # A filter that claimed half its covariance would fail.
    assert not low < 2 * nees[6].mean() < high


def test_every_method_gets_the_same_noise(always_seen):
    """If all targets are seen, beliefs depend on the noise alone: they equal those of an agent that stands still."""
    suite, trace = always_seen
    other = evaluate_traces(suite, heuristic_policy("still", suite.problem, 2.0), TRUE)
    assert np.abs(other.pose - trace.pose).max() > 1
    np.testing.assert_allclose(other.mean, trace.mean, atol=1e-12)


def test_another_objective_than_the_score_has_a_column(rows):
    cells = [replace(cell, objective=0.25) for cell in summarise(rows[1], 2)]
    plain = summary_table("Title", cells, "terminal")
    assert "objective" not in plain.header
    assert plain.title == "Title"
    assert summary_table("Title", cells, None) == plain
    for objective, words in {"mean": "mean log det over the steps", "seen": "share of time in view"}.items():
        table = summary_table("Title", cells, objective)
        assert table.note.startswith(f"objective: {words}")
        assert table.header.index("objective") == table.header.index("score [nat]") - 1
        assert {row[table.header.index("objective")] for row in table.rows} == {"0.250"}


def test_keys_of_a_method_depend_on_seed_scene_and_episode_alone():
    """Contract: all randomness of an episode is drawn from (seed, scene id, episode); also that of `random`."""
    problem, settings = EVERYWHERE.problem(), EVERYWHERE.scenes
    policy = heuristic_policy("random", problem, 2.0)
    here = evaluate_traces(prepare(problem, settings, [THREE], seed=1), policy, TRUE)
    there = evaluate_traces(prepare(problem, settings, [replace(THREE, id="other"), THREE], seed=1), policy, TRUE)
    np.testing.assert_array_equal(there.mean[1], here.mean[0])
    np.testing.assert_array_equal(there.action[1], here.action[0])
