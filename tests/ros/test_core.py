"""Decisions of a node without ROS, against closed forms, SciPy's rotations, and the same messages in order."""

import time

import numpy as np
import pytest
from helpers.ros import PLANE, Watched, detections, odometry
from scipy.spatial.transform import Rotation

from foveate.errors import InputError
from foveate.experiment.presets import PRESETS
from foveate.ros.core import CoreSettings

NOW = 1_760_000_000.0
SPACE = PRESETS["quadrotor"].scenario


def test_a_belief_is_predicted_to_now_and_to_the_end_of_the_step():
    """Of a random walk: variance V of the detection, and W / tau for each second since."""
    watched = Watched()
    watched.core.on_odometry(odometry(NOW))
    assert watched.core.on_detections(detections(NOW, a=(3, 1, 7)), NOW) is None
    watched.core.on_odometry(odometry(NOW + 0.3, (1, 0, 0)))
    decision = watched.core.decide(NOW + 0.37)
    (estimate,) = decision.estimates
    assert (estimate.target, decision.frame, decision.stopped) == ("a", "odom", "")
    rate = 0.2**2 / 0.5
    np.testing.assert_allclose(estimate.mean, [3.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(estimate.covariance, (0.01 + 0.37 * rate) * np.eye(2), rtol=1e-5)
    np.testing.assert_allclose(watched.belief.covariance[0], (0.01 + 0.87 * rate) * np.eye(2), rtol=1e-5)
    assert watched.belief.step_s == 0.5
    np.testing.assert_array_equal(watched.asked[-1][1], [1, 0, 0])


def test_a_command_is_a_twist_in_the_order_of_ros():
    watched = Watched(SPACE, axes=("vx", "vy", "vz", "wz"), command=(1.0, 2.0, 3.0, 4.0))
    watched.core.on_odometry(odometry(NOW))
    assert watched.core.decide(NOW).twist == (1.0, 2.0, 3.0, 0.0, 0.0, 4.0)


@pytest.mark.exhaustive  # it needs a quiet machine
@pytest.mark.slow
@pytest.mark.parametrize(("scenario", "axes"), [(PLANE, ("vx", "wz")), (SPACE, ("vx", "vy", "vz", "wz"))])
def test_a_decision_costs_little_beyond_the_policy(scenario, axes):
    """With 8 targets and a detection of each between decisions; the policy here takes no time."""
    watched, times = Watched(scenario, axes=axes, command=(0.0,) * len(axes)), []
    for now in NOW + 0.1 * np.arange(60):
        watched.core.on_odometry(odometry(now))
        watched.core.on_detections(detections(now - 0.05, **{f"t{i}": (2 + i, i % 3, 0) for i in range(8)}), now)
        before_s = time.thread_time()
        decision = watched.core.decide(now)
        times.append(time.thread_time() - before_s)
        assert len(decision.estimates) == 8
    assert np.median(times) < 1e-3  # measured: 0.4 to 0.6 ms


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_late_detections_give_what_the_order_of_their_stamps_gives(seed):
    rng = np.random.default_rng(seed)
    messages = []
    for k in range(40):
        spots = {
            name: (*rng.normal(0, 0.1, 2) + at, 0) for name, at in (("a", (2, 0)), ("b", (3, 2))) if rng.random() < 0.7
        }
        messages.append((NOW + 0.1 * k, spots))
    results = []
    for delays in (np.zeros(40), rng.uniform(0, 0.9, 40)):
        watched = Watched(SPACE if seed % 2 else PLANE, axes=("vx", "wz"), lag_s=1.0)
        events = [(NOW + 0.05 * k, "odometry", None) for k in range(-2, 120)]
        events += [
            (stamp + delay, "detections", (stamp, spots))
            for (stamp, spots), delay in zip(messages, delays, strict=True)
        ]
        events += [(NOW + 0.5 * k, "decide", None) for k in range(12)]
        for at_s, what, content in sorted(events, key=lambda event: (event[0], event[1])):
            if what == "odometry":
                watched.core.on_odometry(odometry(at_s, (0.1 * (at_s - NOW), 0, 0), (0.3 * (at_s - NOW), 0, 0)))
            elif what == "decide":
                decision = watched.core.decide(at_s)
            else:
                watched.core.on_detections(detections(content[0], **content[1]), at_s)
        results.append(decision)
    first, second = results
    assert {each.target for each in first.estimates} == {"a", "b"}
    by_name = {each.target: each for each in second.estimates}
    for each in first.estimates:
        np.testing.assert_allclose(each.mean, by_name[each.target].mean, atol=1e-9)
        np.testing.assert_allclose(each.covariance, by_name[each.target].covariance, rtol=1e-9)


def test_detections_of_every_frame_are_of_one_world():
    """By SciPy: of the body at the time of the stamp, between two odometries, and of a sensor on it."""
    sensor = (0.2, 0.0, 0.5, *Rotation.from_euler("ZYX", (0.4, 0.3, 0.0)).as_quat())
    body, point = Rotation.from_euler("ZYX", (1.0, 0.05, -0.1)), np.array([4.0, -1.0, 0.3])
    in_body = body.inv().apply(point - [1.0, 2.0, 0.0])
    in_sensor = Rotation.from_quat(sensor[3:]).inv().apply(in_body - sensor[:3])
    for frame, position in (("odom", point), ("base_link", in_body), ("/camera", in_sensor)):
        for scenario, d in ((PLANE, 2), (SPACE, 3)):
            watched = Watched(scenario, axes=("vx", "wz"), sensor_frame="camera", sensor_pose=sensor)
            # Half way between two poses on a straight line is this one; it does not turn.
            for side in (-1, 1):
                watched.core.on_odometry(odometry(NOW + 0.1 * side, (1 + side, 2 - side, 0), (1.0, 0.05, -0.1)))
            assert watched.core.on_detections(detections(NOW, frame, a=position), NOW) is None
            (estimate,) = watched.core.decide(NOW).estimates
            np.testing.assert_allclose(estimate.mean[:d], point[:d], atol=1e-6)
    other = Watched(sensor_frame="camera")
    other.core.on_odometry(odometry(NOW))
    for frame in ("lidar", ""):
        problem = other.core.on_detections(detections(NOW, frame, a=(1, 1, 0)), NOW)
        assert f"frame {frame!r} is none of odom, base_link, camera" in problem
    named = Watched(detections_frame="odom")
    named.core.on_odometry(odometry(NOW))
    assert named.core.on_detections(detections(NOW, "", a=(1, 1, 0)), NOW) is None


def test_in_the_plane_a_robot_may_roll_and_pitch():
    watched = Watched()
    watched.core.on_odometry(odometry(NOW, (1, 2, 0.5), (0.7, 0.1, 0.2)))
    watched.core.decide(NOW)
    ahead = Rotation.from_euler("ZYX", (0.7, 0.1, 0.2)).apply([1, 0, 0])
    np.testing.assert_allclose(watched.asked[-1][1], [1, 2, np.arctan2(ahead[1], ahead[0])], atol=1e-12)


def test_without_odometry_the_robot_stands():
    watched = Watched(odometry_timeout_s=0.4)
    core = watched.core
    assert (core.decide(NOW).stopped, core.decide(NOW).twist) == ("no odometry yet", (0.0,) * 6)
    core.on_odometry(odometry(NOW))
    assert core.decide(NOW + 0.39).twist[0] == 1.0
    late = core.decide(NOW + 0.41)
    assert late.twist == (0.0,) * 6
    assert "0.41 s old, more than odometry_timeout_s = 0.4 s" in late.stopped
    assert "2 s ahead of this node's clock" in core.decide(NOW - 2.0).stopped
    core.on_odometry(odometry(NOW + 0.5))
    assert core.decide(NOW + 0.6).stopped == ""
    broken = odometry(NOW + 0.6)._replace(quaternion=(0.0, 0.0, 0.0, 0.0))
    assert "quaternion is zero" in core.on_odometry(broken)
    assert "not finite" in core.on_odometry(odometry(NOW + 0.6, (np.nan, 0, 0)))
    assert "1 s old" in core.decide(NOW + 1.5).stopped  # neither counts


def test_a_policy_that_cannot_decide_stops_the_robot():
    watched = Watched()
    watched.core.on_odometry(odometry(NOW))

    def fail(belief, pose):
        raise InputError("belief: too large")

    object.__setattr__(watched.core.model, "decide", fail)
    decision = watched.core.decide(NOW)
    assert (decision.stopped, decision.twist) == ("no decision: belief: too large", (0.0,) * 6)


def test_stamps_that_cannot_be_are_named():
    core = Watched(lag_s=1.0).core
    assert "no odometry of their time" in core.on_detections(detections(NOW, a=(1, 1, 0)), NOW)
    for k in range(40):
        core.on_odometry(odometry(NOW + 0.1 * k))
    now = NOW + 4.0
    assert "5 s ahead of this node's clock" in core.on_detections(detections(now + 5.0, a=(1, 1, 0)), now)
    assert core.on_detections(detections(0.0, a=(1, 1, 0)), now) is None  # no stamp: now
    core.decide(now)
    assert "no odometry of their time, 4 s ago" in core.on_detections(detections(now - 4.0, a=(1, 1, 0)), now)
    assert core.on_detections(detections(now - 0.9, a=(1, 1, 0)), now) is None
    assert "older than lag_s = 1 s" in core.on_detections(detections(now - 1.3, a=(1, 1, 0)), now)


def test_a_clock_that_goes_back_or_another_frame_begins_again():
    core = Watched().core
    core.on_odometry(odometry(NOW))
    core.on_detections(detections(NOW, a=(1, 1, 0), b=(np.nan, 1, 0)), NOW)
    assert [each.target for each in core.decide(NOW).estimates] == ["a"]
    assert "clock went back by 100 s" in core.on_odometry(odometry(NOW - 100.0))
    assert core.decide(NOW - 100.0).estimates == ()
    core.on_detections(detections(NOW - 100.0, a=(2, 2, 0)), NOW - 100.0)
    assert len(core.decide(NOW - 100.0).estimates) == 1
    assert "its frame was odom, and is map" in core.on_odometry(odometry(NOW - 99.9, frame="map"))
    assert core.decide(NOW - 99.9).estimates == ()


def test_targets_that_nobody_sees_are_forgotten():
    core = Watched(forget_after_s=5.0, lag_s=1.0).core
    core.on_odometry(odometry(NOW))
    core.on_detections(detections(NOW, a=(1, 1, 0)), NOW)
    held = [bool(core.decide(NOW + 0.5 * k).estimates) for k in range(16)]
    assert held == [0.5 * k <= 6.0 for k in range(16)]  # as far behind the clock as detections may come late
    core.on_odometry(odometry(NOW + 8.0))
    core.on_detections(detections(NOW + 8.0, a=(1, 1, 0)), NOW + 8.0)
    assert core.decide(NOW + 8.0).estimates
    assert core.decide(NOW + 1e6).estimates == ()  # a clock that jumps


def test_settings_are_checked():
    for name in ("odometry_timeout_s", "lag_s", "forget_after_s"):
        with pytest.raises(InputError, match=name):
            CoreSettings(**{name: 0.0})
    with pytest.raises(InputError, match="sensor_pose"):
        CoreSettings(sensor_pose=(0.0,) * 7)
