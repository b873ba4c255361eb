"""The tracker of detections without ids: it finds targets, names and loses them, and survives bad input."""

import re
import runpy
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.untyped import unchecked

import foveate
from foveate.errors import InputError
from foveate.geometry.fov import half_space
from foveate.models.detections import filter as pmb
from foveate.models.detections.records import Scan

SETTINGS = foveate.DetectionSettings(
    low_m=(-10.0, -10.0), high_m=(10.0, 10.0), cells=(10, 10), undetected=3.0, clutter=0.2, tracks=6, detections=4
)
SCENARIO = foveate.Scenario(view=foveate.SectorView(depth_m=6.0, angle_deg=360.0))
POSE = [0.0, 0.0, 0.0]
ROOT = Path(__file__).parents[2]


def tracker() -> foveate.DetectionTracker:
    return foveate.DetectionTracker(SCENARIO, SETTINGS)


def looked(own: foveate.DetectionTracker, scans: list) -> list[foveate.Scanned]:
    seen = []
    for scan in scans:
        own.predict()
        seen.append(own.update(POSE, scan))
    return seen


def test_a_target_is_confirmed_followed_and_lost():
    own = tracker()
    seen = looked(own, [[[2.0, 1.0]], [[2.1, 1.0]], [[2.2, 1.0]]])
    assert sum((scan.confirmed for scan in seen), ()) == (0,)
    assert own.ids == (0,)
    assert own.existence[0] > 0.99
    np.testing.assert_allclose(own.mean, [[2.2, 1.0]], atol=0.2)
    gone = looked(own, [[]] * 10)  # three detections are worth seven misses
    assert sum((scan.lost for scan in gone), ()) == (0,)
    assert own.ids == ()
    assert len(own.mean) == len(own.belief().mean) == 0


def test_a_track_that_nobody_looks_at_is_not_reported_until_it_is_detected_again():
    """It surely exists. After K steps the mean square error of its position is the trace of P + K W."""
    own = foveate.DetectionTracker(SCENARIO, replace(SETTINGS, cutoff_m=1.0))
    looked(own, [[[2.0, 1.0]], [[2.1, 1.0]], [[2.1, 1.0]]])
    P, W = own.covariance[0], np.asarray(SCENARIO.problem().motion.W)
    away, confirmed = [1e3, 0.0, 0.0], True
    for K in range(1, 200):
        own.predict()
        own.update(away, [])
        q = np.trace(P + K * W)
        confirmed = 1.0 - q * (1.0 - np.exp(-1.0 / q)) > 0.5
        assert own.ids == ((0,) if confirmed else ())
        if not confirmed:
            break
    assert not confirmed
    assert own.belief().targets == 1
    assert own.update(POSE, [[2.1, 1.0]]).confirmed == (0,)


def test_a_track_that_is_lost_while_another_begins_is_said_to_be_lost():
    """A known target is in the belief at once, and reported where it is located."""
    own = foveate.DetectionTracker(SCENARIO, replace(SETTINGS, cutoff_m=1.0))
    looked(own, [[[2.0, 1.0]], [[2.1, 1.0]], [[2.1, 1.0]]])
    for _ in range(300):
        own.predict()
    assert own.ids == ()
    vague, sure = own.add([-4.0, 0.0]), own.add([0.0, 5.0], 0.01 * np.eye(2))
    assert own.ids == (sure,)
    assert own.belief().targets == 3
    seen = own.update([1e3, 0.0, 0.0], [])
    assert (seen.confirmed, seen.lost) == ((), (0,))
    assert vague not in own.ids


def test_two_targets_in_any_order_keep_their_ids():
    own = tracker()
    looked(own, [[[2.0, 1.0], [-3.0, 0.0]], [[-3.0, 0.1], [2.0, 1.1]], [[2.0, 1.2], [-3.0, 0.2]]])
    assert sorted(own.ids) == [0, 1]
    assert own.mean[own.ids.index(0)] == pytest.approx([2.0, 1.2], abs=0.2)


def test_the_numbers_are_those_of_the_filter():
    own, problem, model = tracker(), SCENARIO.problem(), SETTINGS.model(SCENARIO.problem())
    looked(own, [[[2.0, 1.0]]])
    scan = Scan(jnp.array([[2.0, 1.0], [0, 0], [0, 0], [0, 0]]), jnp.array([True, False, False, False]))

    @jax.jit
    def step(population):
        return pmb.update(
            problem, model, pmb.predict(problem, model, population, jnp.zeros((6, 2))), jnp.zeros(3), scan
        )

    population = step(pmb.start(problem, model, jnp.zeros(3)))
    assert own.expected_number == pytest.approx(float(population.expected_number))
    np.testing.assert_allclose(own.undetected, population.undetected)


def test_looking_lowers_the_intensity_where_one_looks():
    own = tracker()
    before = own.undetected.sum()
    looked(own, [[]])
    assert own.undetected[5, 5] < 0.2 * own.undetected[0, 0]
    assert own.undetected.sum() < before


def test_a_step_of_another_length_is_as_many_steps():
    """Half a step twice, and one step: the same survival and births; the spread of a random walk adds up."""
    settings = foveate.DetectionSettings(
        low_m=(-10.0, -10.0), high_m=(10.0, 10.0), survival=0.9, births=(foveate.BirthSettings(rate=1.0),)
    )
    one, two = (foveate.DetectionTracker(SCENARIO, settings) for _ in range(2))
    for own in (one, two):
        own.add([1.0, 0.0])
    one.predict()
    two.predict(0.5)
    two.predict(0.5)
    np.testing.assert_allclose(two.existence, one.existence, rtol=1e-6)
    np.testing.assert_allclose(two.covariance, one.covariance, rtol=1e-5)
    assert two.expected_number == pytest.approx(one.expected_number, rel=0.05)


def test_a_view_without_end_needs_a_cutoff():
    endless = eqx.tree_at(lambda problem: problem.sensor.view, SCENARIO.problem(), half_space([-1.0, 0.0], 0.0))
    with pytest.raises(InputError, match="cutoff_m = None: is missing; expected a number, as the view has no end"):
        foveate.DetectionTracker(endless, replace(SETTINGS, clutter=0.0))


BAD = {
    "by id": (lambda own: own.update(POSE, {"a": [1, 2]}), "expected a list without ids"),
    "of three numbers": (lambda own: own.update(POSE, [[1, 2, 3]]), "shape (1, 3): expected (k, 2)"),
    "one flat": (lambda own: own.update(POSE, [1, 2]), "shape (2,): expected (k, 2)"),
    "ragged": (lambda own: own.update(POSE, [[1, 2], [3]]), "detections: expected numbers in rows of one length"),
    "too many": (lambda own: own.update(POSE, [[1, 2]] * 5), "detections: 5 in one scan: expected at most 4"),
    "no pose": (lambda own: own.update([0, 0], [[1, 2]]), "expected [x, y, yaw]"),
    "no time": (lambda own: own.predict(-1.0), "dt_s = -1.0: expected seconds > 0"),
    "of no covariance": (lambda own: own.add([0, 0], np.zeros((2, 2))), "expected a symmetric, positive definite"),
    "never there": (lambda own: own.add([0, 0], existence=0.0), "expected a probability above 0, up to 1"),
    "an odd covariance": (lambda own: own.add([0, 0], np.eye(3)), "expected (2, 2)"),
}


@pytest.fixture(scope="module")
def running():
    own = tracker()
    looked(own, [[[2.0, 1.0]], [[2.1, 1.0]]])
    return own


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_line_and_changes_nothing(running, name):
    call, words = BAD[name]
    before = running.expected_number, running.step, running.mean.tolist()
    with unchecked(), pytest.raises(InputError) as caught:
        call(running)
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert (running.expected_number, running.step, running.mean.tolist()) == before


def test_detections_that_are_no_numbers_are_rejected_and_the_others_taken(running):
    seen = running.update(POSE, [[np.nan, 1.0], [2.1, 1.0], [np.inf, 0.0], [0.0, 1e12]])
    assert seen.rejected == 3
    assert running.ids == (0,)
    assert np.isfinite(running.mean).all()


def test_no_slot_is_left():
    own = tracker()
    for i in range(6):
        own.add([i, 0.0])
    with pytest.raises(InputError, match="tracks = 6: all are taken"):
        own.add([7.0, 0.0])


def test_a_policy_decides_on_confirmed_tracks(running):
    policy = foveate.heuristic("nearest", SCENARIO)
    assert policy(running.belief(), POSE).shape == (2,)
    inputs = running.inputs(POSE, 5, pad_to=4)
    np.testing.assert_array_equal(inputs["present"], [[True, False, False, False]])
    assert running.observation(POSE, 5, pad_to=4).mean.shape == (4, 2)


@pytest.mark.slow
def test_the_page_runs(capsys):
    """The Python of docs/detections.md: the target that all three scans have is confirmed."""
    names: dict = {}
    page = (ROOT / "docs" / "detections.md").read_text(encoding="utf-8")
    for block in re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE):
        exec(compile(block, "detections.md", "exec"), names)
    assert len(names["tracker"].ids) == 1
    assert names["command"].shape == (2,)
    assert "never detected" in capsys.readouterr().out


@pytest.mark.slow
def test_the_example_finds_targets(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["detections_loop.py", "best", "--steps", "30", "--seed", "1"])
    runpy.run_path(str(ROOT / "examples" / "detections_loop.py"))["main"]()
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 31
    assert any("confirmed" in line for line in lines)
    assert lines[-1].endswith("0 tracks did not fit")
