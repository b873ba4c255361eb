"""The tracker against filterpy's Kalman filter, as foveate's own filter is; its gate against chi-square."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2

from foveate.deploy.tracker import Tracker
from foveate.experiment.checkpoint import save_tree, write_config
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import QUADROTOR
from foveate.experiment.run_folder import BEST
from foveate.policies.attention import AttentionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.sensor import ScheduleSettings, SensorSettings

EXAMPLE = Path(__file__).parents[2] / "examples" / "robot_loop.py"
SENSOR = SensorSettings(V=((0.04, 0.01, 0), (0.01, 0.09, 0), (0, 0, 0.02)), frame="body", range_growth_per_m=0.1)
SPACE = replace(QUADROTOR, sensor=SENSOR)
PLANE = Scenario(schedule=ScheduleSettings(tau_s=(1.0, 0.5), W=(((0.1, 0), (0, 0.2)), ((0.02, 0), (0, 0.01)))))


def other(problem, mean, covariance, step=0):
    """filterpy's filter of one target, with the matrices of a step."""
    now = problem.at(jnp.asarray(step))
    motion, sensor = now.motion, now.sensor
    one = KalmanFilter(dim_x=motion.state_size, dim_z=len(sensor.H), dim_u=motion.input_size)
    one.x, one.P = np.array(mean, float)[:, None], np.array(covariance, float)
    one.F, one.B, one.Q, one.H = (np.asarray(x) for x in (motion.A, motion.B, motion.W, sensor.H))
    return one


def noise(pose, point_world):
    """V of a sensor in the body frame whose deviation grows by a tenth of a metre's worth a metre."""
    R, t = pose[:3, :3], pose[:3, 3]
    return R @ np.array(SENSOR.V) @ R.T * (1 + 0.1 * np.linalg.norm(point_world - t)) ** 2


def pose_of(rng):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.random(random_state=rng.integers(1000)).as_matrix(), rng.normal(0, 3, 3)
    return pose


def test_equals_filterpy():
    """Positions and velocities in space, noise that turns with the agent and grows with range, known inputs."""
    problem, rng = SPACE.problem(), np.random.default_rng(0)
    tracker = Tracker(problem, gate=None, forget_after_s=1e9)
    means = rng.normal(0, 3, (3, 6))
    P_0 = np.linalg.inv(np.asarray(problem.prior_information))
    for i, mean in enumerate(means):
        mean[3:] = 0
        tracker.add(f"t{i}", mean[:3])
    theirs = [other(problem, mean, P_0) for mean in means]
    for _ in range(20):
        pushes, pose = rng.normal(0, 0.1, (3, 3)), pose_of(rng)
        assert tracker.predict({"t0": pushes[0], "t2": pushes[2]}) == ()
        pushes[1] = 0
        detections = {f"t{i}": rng.normal(0, 3, 3) for i in range(3) if rng.random() < 0.6}
        seen = tracker.update(pose, detections)
        assert set(seen.updated) == set(detections)
        for i, one in enumerate(theirs):
            one.predict(pushes[i][:, None])
            if (z := detections.get(f"t{i}")) is not None:
                one.update(z[:, None], R=noise(pose, one.x[:3, 0]))
            np.testing.assert_allclose(tracker.mean[i], one.x[:, 0], rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(tracker.covariance[i], one.P, rtol=1e-9, atol=1e-9)


def test_a_first_detection_is_the_update_of_a_flat_prior():
    """The limit of filterpy's filter whose position is unknown to a hundred kilometres."""
    problem, rng = SPACE.problem(), np.random.default_rng(1)
    pose, z = pose_of(rng), np.array([1.0, -2.0, 3.0])
    tracker = Tracker(problem)
    assert tracker.update(pose, {7: z}).appeared == (7,)
    P_0 = np.linalg.inv(np.asarray(problem.prior_information))
    P_0[:3, :3] = 1e10 * np.eye(3)
    one = other(problem, np.zeros(6), P_0)
    one.update(z[:, None], R=noise(pose, z))
    np.testing.assert_allclose(tracker.mean[0], one.x[:, 0], rtol=0, atol=1e-8)
    np.testing.assert_allclose(tracker.covariance[0], one.P, rtol=0, atol=1e-5)


def test_each_step_has_its_own_matrices():
    problem, rng = PLANE.problem(), np.random.default_rng(2)
    tracker = Tracker(problem, gate=None)
    tracker.add("a", [1.0, 2.0])
    mean, P = np.array([1.0, 2.0]), 2.0 * np.eye(2)
    for step in range(4):
        one, z = other(problem, mean, P, step), rng.normal(size=2)
        one.predict(np.zeros((2, 1)))
        one.update(z[:, None], R=0.04 * np.eye(2))
        mean, P = one.x[:, 0], one.P
        tracker.predict()
        tracker.update(np.zeros(3), {"a": z})
        np.testing.assert_allclose(tracker.covariance[0], P, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(tracker.mean[0], mean, rtol=1e-10, atol=1e-12)


def test_invalid_poses_and_covariances_are_rejected_without_effect():
    tracker = Tracker(Scenario())
    tracker.add("a", [1.0, 2.0])
    for pose in ([np.nan, 0, 0], [0.0, 0.0], np.eye(3)):
        with pytest.raises(ValueError, match="pose = "):
            tracker.update(pose, {"b": [0.0, 1.0]})
    with pytest.raises(ValueError, match="positive definite"):
        tracker.add("c", [0.0, 0.0], -np.eye(2))
    with pytest.raises(ValueError, match="known input of target 'a'"):
        tracker.predict({"a": [1.0]})
    assert (tracker.ids, tracker.step, list(tracker.unseen_s)) == (("a",), 0, [0.0])


def test_missed_detections_equal_those_of_the_simulation():
    """A view over half of a belief that is not detected: as sampled, what is outside; a detected one is updated."""
    problem = Scenario(sensor=SensorSettings(missed_detections="used")).problem()
    pose, rng = np.array([1.0, -2.0, 0.7]), np.random.default_rng(5)
    tracker = Tracker(problem)
    tracker.add("sought", np.add(pose[:2], [1.4, 1.0]))
    tracker.add("found", np.add(pose[:2], [1.0, 0.5]))
    tracker.predict()
    mean, covariance = tracker.mean.copy(), tracker.covariance.copy()
    tracker.update(pose, {"found": mean[1]})
    samples = rng.multivariate_normal(mean[0], covariance[0], 200_000)
    ahead = (samples - pose[:2]) @ [np.cos(0.7), np.sin(0.7)]
    aside = (samples - pose[:2]) @ [-np.sin(0.7), np.cos(0.7)]
    outside = samples[(ahead > 2) | (np.abs(aside) > np.tan(np.pi / 3) * ahead)]
    assert 0.4 < len(outside) / len(samples) < 0.9
    np.testing.assert_allclose(tracker.mean[0], outside.mean(axis=0), atol=0.05)
    np.testing.assert_allclose(tracker.covariance[0], np.cov(outside.T), atol=0.12)
    np.testing.assert_allclose(tracker.mean[1], mean[1], atol=1e-12)
    np.testing.assert_allclose(np.linalg.inv(tracker.covariance[1]), np.linalg.inv(covariance[1]) + 25 * np.eye(2))


def test_the_gate_rejects_outliers_and_few_valid_detections():
    problem, rng, count = Scenario().problem(), np.random.default_rng(3), 20_000
    tracker = Tracker(problem, gate=0.99)
    # One by one, `add` would copy all of them each time.
    tracker.mean, tracker.covariance = np.zeros((count, 2)), np.tile(np.eye(2), (count, 1, 1))
    tracker.unseen_s = np.zeros(count)
    deviation = np.sqrt(1 + 0.04)
    tracker.ids = tuple(range(count))
    z = rng.normal(0, deviation, (count, 2))
    rejected = tracker.update(np.zeros(3), dict(enumerate(z))).rejected
    expected = np.flatnonzero((z**2).sum(axis=1) / deviation**2 > chi2.ppf(0.99, 2))
    assert rejected == tuple(expected.tolist())
    low, high = binom.interval(1 - 1e-6, count, 0.01)
    assert low < len(rejected) < high
    assert set(tracker.rejected) == set(rejected)


@pytest.mark.parametrize("wild", [100 * np.sqrt(2.04), np.nan, np.inf])
def test_an_outlier_is_ignored_and_counted(wild):
    """100 sigma of the innovation, by the default gate; a second one adds to the count; the age keeps growing."""
    tracker = Tracker(Scenario().problem())
    tracker.add("a", [0.0, 0.0])
    tracker.predict()
    mean, P = tracker.mean.copy(), tracker.covariance.copy()
    for times in (1, 2):
        assert tracker.update(np.zeros(3), {"a": [wild, 0.0], "b": [np.nan, 0.0]}).rejected == ("a", "b")
        assert tracker.rejected == {"a": times, "b": times}
    assert tracker.ids == ("a",)
    assert np.array_equal(tracker.mean, mean)
    assert np.array_equal(tracker.covariance, P)
    assert tracker.unseen_s.tolist() == [1.0]
    if np.isfinite(wild):
        free = Tracker(Scenario().problem(), gate=None)
        free.add("a", [0.0, 0.0])
        assert free.update(np.zeros(3), {"a": [wild, 0.0]}).updated == ("a",)


def test_targets_appear_age_and_are_dropped():
    tracker = Tracker(Scenario(tau_s=0.1).problem(), forget_after_s=0.3)
    pose = np.zeros(3)
    seen = tracker.update(pose, {"a": [1, 0], "b": [2, 0]})
    assert (seen.appeared, seen.updated) == (("a", "b"), ())
    for _ in range(3):
        assert tracker.predict() == ()
        assert tracker.update(pose, {"a": [1, 0]}).updated == ("a",)
    np.testing.assert_allclose(tracker.unseen_s, [0.0, 0.3])
    assert tracker.predict() == ("b",)
    assert tracker.ids == ("a",)
    tracker.update(pose, {"b": [50, 0]})
    assert tracker.ids == ("a", "b")
    np.testing.assert_allclose(tracker.mean[1], [50, 0], atol=1e-12)


def test_inputs_are_those_of_the_beliefs_padded():
    tracker = Tracker(Scenario().problem())
    assert {key: x.shape for key, x in tracker.inputs(np.zeros(3), 5).items()} == {
        "pose": (1, 3),
        "mean": (1, 0, 2),
        "information": (1, 0, 2, 2),
        "present": (1, 0),
        "known_input": (1, 0, 2),
        "steps_left": (1,),
    }
    tracker.add("a", [1.0, 2.0])
    tracker.add("b", [3.0, 4.0], covariance=[[4.0, 0.0], [0.0, 0.5]])
    tracker.predict({"b": [0.5, 0.0]})
    found = tracker.inputs([1, 2, 3], 5, pad_to=3)
    np.testing.assert_allclose(found["mean"][0], [[1, 2], [3.5, 4], [0, 0]], rtol=1e-6)
    np.testing.assert_allclose(found["known_input"][0], [[0, 0], [0.5, 0], [0, 0]], rtol=1e-6)
    np.testing.assert_allclose(found["information"][0, 1], np.diag([1 / 4.0025, 1 / 0.5025]), rtol=1e-6)
    assert found["present"].tolist() == [[True, True, False]]
    seen = tracker.observation([1, 2, 3], 5, pad_to=3)
    assert (int(seen.left), int(seen.step), seen.mean.shape) == (5, 0, (3, 2))


def test_wrong_input_is_named():
    problem = Scenario().problem()
    for options, complaint in [
        ({"gate": 1.0}, r"gate = 1.0: expected a probability"),
        ({"forget_after_s": 0.0}, r"forget_after_s = 0.0: expected > 0"),
        ({"forget_after_s": float("nan")}, r"forget_after_s = nan"),
    ]:
        with pytest.raises(ValueError, match=complaint):
            Tracker(problem, **options)
    tracker = Tracker(problem)
    tracker.add("a", [0, 0])
    with pytest.raises(ValueError, match="'a': is tracked already"):
        tracker.add("a", [0, 0])
    with pytest.raises(ValueError, match="position of target 'b'"):
        tracker.add("b", [0, 0, 0])
    with pytest.raises(ValueError, match="known input of target 'a'"):
        tracker.predict({"a": [1.0]})
    with pytest.raises(ValueError, match=r"detection of 'a' has shape \(3,\): expected \(2,\)"):
        tracker.update(np.zeros(3), {"a": [0, 0, 0]})


@pytest.mark.slow
def test_the_example_runs(tmp_path):
    experiment = Experiment(policy=AttentionSettings(agent_widths=(4,), target_widths=(4,), out_widths=(4,)))
    (tmp_path / "checkpoint").mkdir()
    write_config(tmp_path, experiment)
    policy = experiment.policy.policy(experiment.scenario.problem(), jax.random.key(0))
    save_tree(tmp_path / BEST, policy, experiment, "policy", {})
    command = [sys.executable, str(EXAMPLE), str(tmp_path), "--steps", "4", "--speed", "100"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 5
    assert lines[3].startswith("step 4: command ")
    assert lines[4].endswith("0 detections rejected")
