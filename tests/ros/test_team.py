"""Robots that tell each other what they measure, against a scalar Kalman filter of all measurements, each once."""

import json
from dataclasses import replace

import numpy as np
import pytest
from helpers.ros import PLANE, Watched, detections, odometry

from foveate.errors import InputError
from foveate.experiment.presets import PRESETS
from foveate.ros.core import CoreSettings
from foveate.ros.team import TeamCore
from foveate.scenario.kinds import RobotSettings
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.team import TeamSettings

NOW = 1_760_000_000.0
V, RATE = 0.1**2, 0.2**2 / 0.5


def robot(name, **settings):
    core = TeamCore(Watched().core.model, CoreSettings(**settings), name)
    core.on_odometry(odometry(NOW))
    return core


def looks(core, time_s, now_s=None, **positions):
    core.on_odometry(odometry(time_s))
    assert core.on_detections(detections(time_s, **positions), time_s if now_s is None else now_s) is None


def belief(core, now_s, target="a"):
    (found,) = [each for each in core.decide(now_s).estimates if each.target == target]
    return found.mean, found.covariance


def kalman(measurements, now_s):
    """Mean and variance now of a random walk, of measurements (time, x, y) in any order."""
    mean = variance = time_s = None
    for at_s, *z in sorted(measurements):
        if mean is None:
            mean, variance = np.array(z, float), V
        else:
            variance += RATE * (at_s - time_s)
            gain = variance / (variance + V)
            mean, variance = mean + gain * (np.array(z) - mean), (1 - gain) * variance
        time_s = at_s
    return mean, variance + RATE * (now_s - time_s)


def check(core, measurements, now_s):
    mean, covariance = belief(core, now_s)
    expected, variance = kalman(measurements, now_s)
    np.testing.assert_allclose(mean, expected, atol=1e-6)
    np.testing.assert_allclose(covariance, variance * np.eye(2), rtol=1e-5)


def test_each_measurement_counts_once_however_often_it_is_told():
    first, second, third = robot("r1"), robot("r2"), robot("r3")
    looks(first, NOW, a=(3, 1, 0))
    looks(second, NOW + 0.1, a=(3.1, 1.1, 0))
    told = first.message(NOW + 0.1)
    assert second.on_message(told, NOW + 0.1) is None
    assert second.on_message(told, NOW + 0.2) is None
    # The third hears of the first by the second alone, and then from the first, too.
    assert third.on_message(second.message(NOW + 0.2), NOW + 0.2) is None
    assert third.on_message(first.message(NOW + 0.2), NOW + 0.2) is None
    assert first.on_message(third.message(NOW + 0.3), NOW + 0.3) is None
    both = [(NOW, 3, 1), (NOW + 0.1, 3.1, 1.1)]
    for core in (first, second, third):
        check(core, both, NOW + 0.4)


def test_messages_that_are_lost_or_late_are_made_up_for():
    rng = np.random.default_rng(2)
    cores, waiting, all_of_them = [robot(name, lag_s=1.5) for name in "xyz"], [], []
    for k in range(40):
        now_s = NOW + 0.1 * k
        for core in cores:
            core.on_odometry(odometry(now_s))
            if rng.random() < 0.5:
                x, y = 3 + rng.normal(0, 0.1), 1 + rng.normal(0, 0.1)
                looks(core, now_s, a=(x, y, 0))
                all_of_them.append((now_s, x, y))
        for sender in cores:
            text = sender.message(now_s)
            arrives = [core for core in cores if core is not sender and rng.random() < 0.6]
            waiting += [(now_s + rng.uniform(0, 0.3), core, text) for core in arrives]
        for _, core, text in [each for each in waiting if each[0] <= now_s]:
            assert core.on_message(text, now_s) is None
        waiting = [each for each in waiting if each[0] > now_s]
    for _ in range(2):  # at last all hear each other
        for sender in cores:
            for core in cores:
                assert core.on_message(sender.message(now_s), now_s) is None
    for core in cores:
        check(core, all_of_them, now_s + 0.05)


def test_the_noise_is_that_of_the_robot_that_has_measured():
    """A sensor whose error grows with range: the other one stands at 1 m from the target, this one at 5 m."""

    far_sighted = replace(PLANE, sensor=replace(PLANE.sensor, range_growth_per_m=1.0))
    first, second = (TeamCore(Watched(far_sighted).core.model, CoreSettings(), name) for name in ("r1", "r2"))
    for core, x in ((first, 0.0), (second, 4.0)):
        core.on_odometry(odometry(NOW, (x, 0, 0)))
        assert core.on_detections(detections(NOW, a=(5, 0, 0)), NOW) is None
    assert first.on_message(second.message(NOW), NOW) is None
    _, covariance = belief(first, NOW)
    information = 1 / (V * (1 + 5) ** 2) + 1 / (V * (1 + 1) ** 2)
    np.testing.assert_allclose(np.diag(covariance), 1 / information, rtol=0.02)


def test_robots_of_different_kinds_fuse_with_the_noise_of_the_sender():
    """Three robots with standard deviations of 0.1, 0.4 and 0.1 m; the third hears of the second by the first alone."""
    vague = RobotSettings(sensor=SensorSettings(std_m=0.4))
    mixed = replace(PLANE, team=TeamSettings(agents=3, robots=(RobotSettings(), vague)))
    cores = [TeamCore(Watched(mixed.of_robot(i)).core.model, CoreSettings(), f"r{i}") for i in range(3)]
    measured = [(3.0, 1.0), (3.6, 0.4), (3.1, 1.1)]
    for core, (x, y) in zip(cores, measured, strict=True):
        looks(core, NOW, a=(x, y, 0))
    first, second, third = cores
    assert first.on_message(second.message(NOW), NOW) is None
    assert third.on_message(first.message(NOW), NOW) is None
    for core in (first, second):
        assert core.on_message(third.message(NOW), NOW) is None
    assert second.on_message(first.message(NOW), NOW) is None
    weights = np.array([0.1, 0.4, 0.1]) ** -2.0
    for core in cores:
        mean, covariance = belief(core, NOW)
        np.testing.assert_allclose(mean, weights @ np.array(measured) / weights.sum(), atol=1e-6)
        np.testing.assert_allclose(covariance, np.eye(2) / weights.sum(), rtol=1e-5)
    with pytest.raises(InputError, match=r"team\.robots: expected the scenario of one robot"):
        Watched(mixed)


def test_a_message_without_a_noise_has_that_of_the_own_sensor():
    core = robot("r1")
    assert core.on_message(rows({}), NOW) is None
    check(core, [(NOW, 3, 1)], NOW)


@pytest.mark.parametrize("V", [[[1.0]], [[1.0, 0.0], [0.0, -1.0]], [[1.0, 2.0], [0.0, 1.0]]])
def test_a_noise_that_is_no_covariance_is_left_out_with_a_reason(V):
    core = robot("r1")
    assert core.on_message(rows({"V": V}), NOW).startswith("team: r2: V = ")
    assert core.decide(NOW).estimates == ()


def test_what_the_gate_rejects_is_not_told():
    core = robot("r1")
    for k in range(5):
        looks(core, NOW + 0.1 * k, a=(3, 1, 0))
    looks(core, NOW + 0.5, a=(5, -4, 0))
    told = json.loads(core.message(NOW + 0.5))["measurements"]
    assert [each["positions"]["a"] for each in told] == [[3, 1, 0]] * 5


def test_old_measurements_are_neither_told_nor_taken():
    first, second = robot("r1"), robot("r2")
    looks(first, NOW, a=(3, 1, 0))
    told = first.message(NOW)
    assert json.loads(first.message(NOW + 1.2))["measurements"] == []
    second.on_odometry(odometry(NOW + 1.2))
    assert second.on_message(told, NOW + 1.2) is None
    assert second.decide(NOW + 1.2).estimates == ()


def message(**changes):
    row = {"robot": "r2", "time_s": NOW, "pose": [0, 0, 0, 0, 0, 0, 1], "positions": {"a": [3, 1, 0]}}
    content = {"format": "foveate-team", "version": 1, "robot": "r2", "frame": "odom", "measurements": [row]}
    return {**content, **changes}, row


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"format": "other"}, "format 'other'"),
        ({"version": 2}, "version 2"),
        ({"frame": "map"}, "the frame of r2 is 'map', that of the odometry 'odom'"),
        ({"measurements": [{}]}, "lacks a field"),
        ({"measurements": 3}, "lacks a field"),
        ({"measurements": [{**message()[1], "pose": [0, 0]}]}, "lacks a field"),
        ({"measurements": [{**message()[1], "positions": {"a": [1, 2]}}]}, "lacks a field"),
        ({"measurements": [{**message()[1], "positions": []}]}, "lacks a field"),
        ({"measurements": [{**message()[1], "time_s": 10**400}]}, "lacks a field"),
        ({"measurements": [{**message()[1], "V": "wide"}]}, "lacks a field"),
        ({"measurements": [{**message()[1], "pose": [10**400, 0, 0, 0, 0, 0, 1]}]}, "lacks a field"),
        ({"measurements": [{**message()[1], "pose": [1e12, 0, 0, 0, 0, 0, 1]}]}, "team: r2: "),
    ],
)
def test_a_message_that_is_none_is_left_out_with_a_reason(changes, why):
    core = robot("r1")
    text = json.dumps(message(**changes)[0])
    assert why in core.on_message(text, NOW)
    assert core.decide(NOW).estimates == ()


def rows(*changes):
    return json.dumps(message(measurements=[{**message()[1], **each} for each in changes])[0])


def test_what_is_of_no_use_costs_the_rest_of_a_message_nothing():
    """A pose and a position beyond all bounds before good ones, which alone are worked in and told on."""
    core = robot("r1")
    bad = {"time_s": NOW - 0.2, "pose": [1e30, 0, 0, 0, 0, 0, 1]}
    mixed = {"time_s": NOW - 0.1, "positions": {"a": [3, 1, 0], "b": [1e200, 1, 0]}}
    for _ in range(2):
        wrong = core.on_message(rows(bad, mixed, {"positions": {"a": [3.1, 1.1, 0]}}), NOW)
        assert wrong.startswith("team: r2: pose = [1e+30")
    assert "position of 'b' = [1e+200, 1.0, 0.0]" in core.on_message(rows(mixed), NOW)
    told = json.loads(core.message(NOW))["measurements"]
    assert [each["positions"] for each in told] == [{"a": [3, 1, 0]}, {"a": [3.1, 1.1, 0]}]
    check(core, [(NOW - 0.1, 3, 1), (NOW, 3.1, 1.1)], NOW)


def test_what_is_too_late_is_tried_once():
    core = robot("r1")
    looks(core, NOW + 0.5, now_s=NOW, a=(3, 1, 0))  # by a clock that is ahead: the tracker takes none before NOW - 0.5
    for _ in range(3):
        assert core.on_message(rows({"time_s": NOW - 0.9}), NOW) is None
    assert core._tracker.too_late == 1
    assert [each["robot"] for each in json.loads(core.message(NOW))["measurements"]] == ["r1"]


def test_a_policy_that_learns_from_targets_not_detected_is_rejected():
    search = Watched(PRESETS["search"].scenario).core.model
    with pytest.raises(InputError, match=r"sensor\.missed_detections = 'used': expected none for a team"):
        TeamCore(search, CoreSettings(), "r1")


def test_other_texts_and_its_own_are_left_out():
    core = robot("r1")
    assert "no JSON" in core.on_message("[1, 2", NOW)
    assert "team: NaN" in core.on_message("[NaN]", NOW)
    assert "lacks a field" in core.on_message("[]", NOW)
    assert core.on_message(json.dumps(message(robot="r1")[0]), NOW) is None
    assert core.decide(NOW).estimates == ()
    silent = TeamCore(core.model, CoreSettings(), "r3")
    assert "no odometry yet" in silent.on_message(json.dumps(message()[0]), NOW)
    assert core.on_message(json.dumps(message()[0]), NOW) is None
    np.testing.assert_allclose(belief(core, NOW)[0], [3, 1], atol=1e-6)
    with pytest.raises(InputError, match="robot"):
        TeamCore(core.model, CoreSettings(), "")
