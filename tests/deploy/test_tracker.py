"""The tracker against filterpy's Kalman filter, as foveate's own filter is; its gate against chi-square."""

import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from helpers.untyped import unchecked
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2

from foveate.deploy.belief import whole_steps
from foveate.deploy.tracker import Tracker
from foveate.errors import InputError
from foveate.experiment.checkpoint import save_tree, write_config
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import QUADROTOR
from foveate.experiment.run_folder import BEST
from foveate.policies.attention import AttentionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import ScheduleSettings, SensorSettings
from foveate.scenario.target import AccelerationTarget, StaticTarget, VelocityTarget

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
        assert tracker.predict(known_inputs={"t0": pushes[0], "t2": pushes[2]}) == ()
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
        tracker.predict(known_inputs={"a": [1.0]})
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


def test_looking_at_the_same_place_again_says_nothing_new():
    """Twenty looks in vain at a target that stands still: as after the first, by sampling; a new place is cut."""
    scenes = SceneSettings(drift_m_s=(0.0, 0.0), jitter_m_s=0.0)
    sensor = SensorSettings(missed_detections="used")
    problem = Scenario(sensor=sensor, target=StaticTarget(kind="static"), scenes=scenes).problem()
    rng, tracker = np.random.default_rng(6), Tracker(problem, forget_after_s=1e9)
    tracker.add("sought", [1.4, 1.0])
    samples = rng.multivariate_normal(tracker.mean[0], tracker.covariance[0], 400_000)
    poses = [np.zeros(3)] * 20 + [np.array([0.0, 0.0, 2.0])]
    for count, pose in enumerate(poses):
        tracker.predict()
        before = tracker.mean[0].copy()
        tracker.update(pose, {})
        is_new = count in (0, len(poses) - 1)
        if is_new:
            ahead = (samples - pose[:2]) @ [np.cos(pose[2]), np.sin(pose[2])]
            aside = (samples - pose[:2]) @ [-np.sin(pose[2]), np.cos(pose[2])]
            samples = samples[(ahead > 2) | (np.abs(aside) > np.tan(np.pi / 3) * ahead)]
        assert (np.abs(tracker.mean[0] - before).max() > 0.02) == is_new
        # A second cut is of what the first has left, as a Gaussian.
        np.testing.assert_allclose(tracker.mean[0], samples.mean(axis=0), atol=0.1 if count < 20 else 0.25)
        np.testing.assert_allclose(tracker.covariance[0], np.cov(samples.T), atol=0.25 if count < 20 else 0.5)


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
        "step": (1,),
    }
    tracker.add("a", [1.0, 2.0])
    tracker.add("b", [3.0, 4.0], covariance=[[4.0, 0.0], [0.0, 0.5]])
    tracker.predict(known_inputs={"b": [0.5, 0.0]})
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
        tracker.predict(known_inputs={"a": [1.0]})
    with pytest.raises(ValueError, match=r"detection of 'a' has shape \(3,\): expected \(2,\)"):
        tracker.update(np.zeros(3), {"a": [0, 0, 0]})


WORLDS = {
    "plane": Scenario(),
    "space": SPACE,
    "missed": Scenario(sensor=SensorSettings(missed_detections="used", range_growth_per_m=0.1)),
    "acceleration": Scenario(target=AccelerationTarget(kind="constant_acceleration")),
}


@pytest.mark.parametrize("gate", [0.9999, None])
@pytest.mark.parametrize("world", WORLDS)
def test_nothing_finite_breaks_a_belief_and_no_target_those_of_others(world, gate):
    """Detections of every size; a target beside them, detected as it should be, is always known, and can be told."""
    problem, rng = WORLDS[world].problem(), np.random.default_rng(0)
    d, m = len(problem.motion.Z), len(problem.sensor.H)
    tracker, pose, good = Tracker(problem, gate=gate, forget_after_s=1e9), np.zeros(3) if d == 2 else np.eye(4), "good"
    sizes = [0.0, 1e-300, 1e-9, 1.0, 1e6, 1e9, 1.1e9, 1e38, 1e200, 1e308, np.inf, np.nan]
    for _ in range(25):
        tracker.predict()
        wild = {name: rng.choice([-1, 1], m) * rng.choice(sizes, m) for name in range(8) if rng.random() < 0.8}
        tracker.update(pose, {**wild, good: np.full(m, 0.01)})
        assert good in tracker.ids
        assert np.isfinite(tracker.mean).all()
        assert (np.linalg.eigvalsh(tracker.covariance)[:, 0] > 0).all()
        seen = tracker.observation(pose, 5, 16)
        assert np.isfinite(np.asarray(seen.mean)).all()
        assert np.isfinite(np.asarray(seen.information)).all()
    i = tracker.ids.index(good)
    np.testing.assert_allclose(tracker.mean[i, :m], 0.01, atol=1e-3)


def test_a_belief_that_grows_beyond_numbers_is_dropped_and_the_others_stay():
    tracker = Tracker(WORLDS["acceleration"], forget_after_s=1e300)
    tracker.add("vague", [0.0, 0.0], covariance=1e18 * np.eye(6))
    for _ in range(20):
        tracker.predict()
        tracker.update(np.zeros(3), {"near": [1.0, 0.0]})
    tracker.covariance[0] *= 1e200  # what only millions of steps would do
    assert tracker.predict() == ("vague",)
    assert tracker.ids == ("near",)
    assert tracker.belief().targets == 1


def test_ids_and_counts_are_bounded():
    tracker, pose = Tracker(Scenario()), np.zeros(3)
    for call in (lambda: tracker.update(pose, {np.nan: [1.0, 0.0]}), lambda: tracker.add(float("nan"), [0.0, 0.0])):
        with pytest.raises(ValueError, match="id nan: expected one that equals itself"):
            call()
    assert tracker.ids == ()
    for start in range(0, 25_000, 5_000):
        tracker.update(pose, {name: [np.nan, 0.0] for name in ("often", *range(start, start + 5_000))})
    assert len(tracker.rejected) == 10_000
    assert tracker.rejected["often"] == 5
    assert tracker.rejected[24_999] == 1
    assert 14_999 not in tracker.rejected


def test_thousands_of_new_targets_begin_at_once():
    tracker, rng = Tracker(SPACE), np.random.default_rng(0)
    z = rng.normal(0, 5, (5_000, 3))
    one_by_one = Tracker(SPACE)
    began = time.thread_time()  # not of other threads, which may compile for other tests
    for i in range(200):
        one_by_one.add(i, z[i])
    alone_s = (time.thread_time() - began) / 200
    began = time.thread_time()
    assert len(tracker.update(np.eye(4), dict(enumerate(z))).appeared) == 5_000
    tracker.predict()
    assert tracker.belief().targets == 5_000
    assert time.thread_time() - began < 0.5 * 5_000 * alone_s
    for i in (0, 4_999):  # as one alone
        alone = Tracker(SPACE)
        alone.update(np.eye(4), {"a": z[i]})
        alone.predict()
        np.testing.assert_allclose(tracker.covariance[i], alone.covariance[0], rtol=1e-12)


def test_steps_beyond_an_int32():
    """After 248 days at 100 Hz; the matrices of a schedule stay in their order."""
    tracker = Tracker(PLANE)
    tracker.add("a", [0.0, 0.0])
    for step in (2**31 - 1, 2**31, 2**40 + 1):
        tracker.step = step
        assert int(tracker.observation(np.zeros(3), 5).step) % 2 == (step - 1) % 2
    with pytest.raises(ValueError, match=r"steps_left = 2147483648: expected a whole number"):
        tracker.inputs(np.zeros(3), 2**31)
    for wrong in (1e10, 2.5, np.nan, np.inf, "many", None):
        with pytest.raises(ValueError, match=r"n = .*: expected a whole number from 1 to 2147483647"):
            whole_steps("n", wrong, 1)


@pytest.mark.parametrize("z", ["ab", [[1], [2, 3]], 1j])
def test_what_is_no_detection_is_named(z):
    with pytest.raises(ValueError, match="detection of 'a'"):
        Tracker(Scenario()).update(np.zeros(3), {"a": z})


# Time


VELOCITY = Scenario(
    tau_s=0.5,
    target=VelocityTarget(kind="constant_velocity", acceleration_m2_s3=0.3),
    sensor=SensorSettings(std_m=0.1),
)


def loop(dts, detections):
    """filterpy's filter over steps of these lengths, with A(dt), W(dt) of constant velocity."""
    one = KalmanFilter(dim_x=4, dim_z=2)
    one.x, one.P = np.zeros((4, 1)), np.diag([0.01, 0.01, 1.0, 1.0])
    one.H, one.R, one.B = np.eye(2, 4), 0.01 * np.eye(2), None
    one.x[:2, 0] = detections[0]
    for dt, z in zip(dts, detections[1:], strict=True):
        one.F = np.kron([[1.0, dt], [0.0, 1.0]], np.eye(2))
        one.Q = 0.3 * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(2))
        one.predict()
        if z is not None:
            one.update(z)
    return one


def test_irregular_steps_equal_filterpy_with_the_matrices_of_each():
    dts, zs = [0.2, 1.4, 0.3, 0.9, 0.25], [[1.0, 0.0], [1.1, 0.0], None, [1.3, 0.1], None, [1.4, 0.1]]
    by_length, by_time = Tracker(VELOCITY, gate=None), Tracker(VELOCITY, gate=None)
    by_length.update(np.zeros(3), {"a": zs[0]})
    by_time.update(np.zeros(3), {"a": zs[0]}, time_s=1.76e9)
    for k, dt in enumerate(dts):
        by_length.predict(dt)
        seen = {} if zs[k + 1] is None else {"a": zs[k + 1]}
        by_length.update(np.zeros(3), seen)
        by_time.update(np.zeros(3), seen, time_s=1.76e9 + sum(dts[: k + 1]))
    one = loop(dts, zs)
    for tracker, tolerance in ((by_length, 1e-9), (by_time, 1e-5)):  # a clock from 1970 resolves 0.2 us
        np.testing.assert_allclose(tracker.mean[0], one.x[:, 0], rtol=tolerance, atol=tolerance)
        np.testing.assert_allclose(tracker.covariance[0], one.P, rtol=tolerance, atol=tolerance)
    assert by_length.belief().step_s == 0.25
    unseen = Tracker(VELOCITY)
    unseen.update(np.zeros(3), {"a": zs[0]})
    for dt in dts:
        unseen.predict(dt)
    np.testing.assert_allclose(unseen.unseen_s, [sum(dts)])


@pytest.mark.parametrize("missed", [None, "used"])
def test_late_detections_give_what_the_sorted_sequence_gives(missed):
    """Two cameras, one of them 0.05 to 0.9 s late; ids appear, jump and are rejected on the way."""
    scenario = replace(VELOCITY, sensor=SensorSettings(std_m=0.1, missed_detections=missed))
    rng = np.random.default_rng(4)
    looks = []
    for k in range(60):
        at_s = 100 + 0.2 * k + (0.03 if k % 3 == 0 else 0.0)
        names = [name for name in ("a", "b", "c") if rng.random() < 0.7]
        jump = 30.0 if k > 35 else 0.0
        detections = {name: [2 + 0.1 * k + jump * (name == "b"), 0.2 * i] + 0.1 * rng.normal(size=2)
                      for i, name in enumerate(names)}  # fmt: skip
        delay = rng.uniform(0.05, 0.9) if k % 3 == 0 else 0.0
        looks.append((at_s + delay, at_s, np.array([0.1 * k, 0.0, 0.2]), detections))
    looks[0] = (looks[0][1], *looks[0][1:])
    sorted_, late = Tracker(scenario), Tracker(scenario, lag_s=1.0)
    for _, at_s, pose, detections in sorted(looks, key=lambda look: look[1]):
        sorted_.update(pose, detections, time_s=at_s)
    for _, at_s, pose, detections in sorted(looks, key=lambda look: look[0]):
        late.update(pose, detections, time_s=at_s)
    assert late.too_late == 0
    order = [late.ids.index(name) for name in sorted_.ids]
    assert sorted_.rejected["b"] >= 4  # so that the sequence matters
    assert late.rejected == sorted_.rejected
    np.testing.assert_allclose(late.mean[order], sorted_.mean, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(late.covariance[order], sorted_.covariance, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(late.unseen_s[order], sorted_.unseen_s, atol=1e-6)


def test_a_detection_between_the_steps_of_a_loop_keeps_the_known_inputs():
    """The loop has predicted to the end of a step when the camera's picture of its middle comes."""
    late, exact = Tracker(VELOCITY, gate=None, lag_s=2.0), Tracker(VELOCITY, gate=None)
    for tracker in (late, exact):
        tracker.update(np.zeros(3), {"a": [1.0, 0.0]}, time_s=0.0)
    late.predict(0.4, known_inputs={"a": [2.0, -1.0]})
    late.add("known", [5.0, 5.0])
    late.predict(0.5)
    late.update(np.zeros(3), {"a": [1.2, 0.0]}, time_s=0.3)
    exact.predict(0.3, known_inputs={"a": [2.0, -1.0]})
    exact.update(np.zeros(3), {"a": [1.2, 0.0]})
    exact.predict(0.1, known_inputs={"a": [2.0, -1.0]})
    exact.add("known", [5.0, 5.0])
    exact.predict(0.5)
    assert late.ids == exact.ids
    np.testing.assert_allclose(late.mean, exact.mean, atol=1e-9)
    np.testing.assert_allclose(late.covariance, exact.covariance, atol=1e-9)
    assert late.time_s == pytest.approx(0.9)


def test_detections_older_than_the_buffer_are_rejected_and_counted():
    for lag_s, oldest in ((0.0, 10.0), (1.0, 9.0)):
        tracker = Tracker(VELOCITY, lag_s=lag_s)
        for k in range(50, 101):
            tracker.update(np.zeros(3), {"a": [1.0, 0.0]}, time_s=0.1 * k)
        mean = tracker.mean.copy()
        seen = tracker.update(np.zeros(3), {"a": [1.1, 0.0], "b": [2.0, 0.0]}, time_s=oldest - 0.05)
        assert (seen.rejected, tracker.too_late, tracker.ids) == (("a", "b"), 2, ("a",))
        np.testing.assert_array_equal(tracker.mean, mean)
        assert tracker.update(np.zeros(3), {"a": [1.1, 0.0]}, time_s=oldest + 0.05 * (lag_s > 0)).updated == ("a",)
        assert len(tracker._history._events) <= 25  # the buffer does not grow


def test_wrong_types_are_named_in_one_line():
    tracker = Tracker(VELOCITY, lag_s=1.0)
    tracker.update(np.zeros(3), {"a": [1.0, 0.0]}, time_s=1.0)
    calls = [
        (lambda: tracker.predict({"a": [0.0, 0.0]}), "known_inputs="),
        (lambda: tracker.predict("soon"), "dt_s"),
        (lambda: tracker.predict(-0.1), "dt_s = -0.1: expected seconds > 0"),
        (lambda: tracker.predict(0.1, 3.0), "known_inputs="),
        (lambda: tracker.update(np.zeros(3), [[1.0, 2.0]]), "data associator"),
        (lambda: tracker.update(np.zeros(3), {"a": [1.0, 0.0]}, time_s=np.nan), "time_s"),
        (lambda: tracker.update(np.zeros(3), {"a": [1.0, 0.0]}, quaternion="ros"), "quaternion = 'ros'"),
        (lambda: Tracker(VELOCITY, lag_s=-1.0), "lag_s = -1.0"),
    ]
    before = tracker.mean.copy()
    for call, said in calls:
        with unchecked(), pytest.raises(InputError, match=said) as caught:
            call()
        assert "\n" not in str(caught.value)
    np.testing.assert_array_equal(tracker.mean, before)


def test_tracker_and_policy_take_the_same_poses():
    half = np.sqrt(0.5)
    tracker, T = Tracker(SPACE), np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_euler("z", 0.5 * np.pi).as_matrix(), [0, 0, 2]
    for pose, order in ((T, "wxyz"), ([0, 0, 2, half, 0, 0, half], "wxyz"), ([0, 0, 2, 0, 0, half, half], "xyzw")):
        alone = Tracker(SPACE)
        alone.update(pose, {"a": [0.0, 4.0, 2.0]}, quaternion=order)
        np.testing.assert_allclose(alone.covariance[0][:3, :3], noise(T, np.array([0.0, 4.0, 2.0])), atol=1e-12)
        np.testing.assert_allclose(tracker.observation(pose, 3, quaternion=order).pose, T, atol=1e-6)


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
