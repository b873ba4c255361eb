"""The dynamic window against a simulation of all its commands in numpy, with a covariance filter."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.decisions import bearing_to, decide, seen

from foveate.models.robot import Robot
from foveate.planning.named import heuristic_policy
from foveate.policies.tokens import tokens_of
from foveate.policies.window import NETWORK_VALUES, PERIODS, VALUES, DynamicWindow, commands, told_window
from foveate.scenario.agent import DifferentialDrive, FreeBody, Quadrotor
from foveate.scenario.region import RegionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.sensor import ScheduleSettings

PROBLEM = Scenario().problem()
KEY = jax.random.key(0)
V, W = 4.0, np.pi / 3
GRID, COARSE = ([(v, w) for v in np.linspace(0, V, k) for w in np.linspace(-W, W, k)] for k in (7, NETWORK_VALUES))


def moved(pose, v, w):
    """The end of an arc of 1 s."""
    x, y, yaw = pose
    if abs(w) < 1e-9:
        return np.array([x + v * np.cos(yaw), y + v * np.sin(yaw), yaw])
    return np.array([x + v / w * (np.sin(yaw + w) - np.sin(yaw)), y - v / w * (np.cos(yaw + w) - np.cos(yaw)), yaw + w])


def in_view(pose, point):
    """Membership of the triangle of 2 m and 120 degrees."""
    bearing, distance = bearing_to(pose, point), np.linalg.norm(point - pose[:2])
    return abs(bearing) <= np.pi / 3 and distance * np.cos(bearing) <= 2.0


def value(poses, paths, information):
    """Mean log det of the information over targets and periods, by covariances; noises as in the scenario."""
    total = 0.0
    for path, P in zip(paths, np.linalg.inv(information), strict=True):
        for k, pose in enumerate(poses):
            P = P if k == 0 else P + 0.05**2 * np.eye(2)
            if in_view(pose, path[k]):
                P = P - P @ np.linalg.inv(P + 0.2**2 * np.eye(2)) @ P
            total -= np.linalg.slogdet(P)[1]
    return total / len(paths) / len(poses)


def steering(pose, path):
    """First command, and poses, of an agent that turns to a moving point and stops 1 m before it."""
    taken, poses = [], []
    for point in path:
        bearing = bearing_to(pose, point)
        ahead = max(np.cos(bearing), 0.0) * (np.linalg.norm(point - pose[:2]) - 1.0)
        taken.append((np.clip(ahead, 0, V), np.clip(bearing, -W, W)))
        pose = moved(pose, *taken[-1])
        poses.append(pose)
    return taken[0], poses


def constant(pose, command, left):
    poses = []
    for _ in range(left):
        pose = moved(pose, *command)
        poses.append(pose)
    return command, poses


def test_takes_the_best_of_all_commands():
    rng, policy, apart = np.random.default_rng(0), heuristic_policy("window", PROBLEM, 2.0), 0
    for case in range(60):
        pose = np.array([*rng.uniform(-2, 2, 2), rng.uniform(-9, 9)])
        mean, log_dets, present = rng.uniform(-6, 6, (5, 2)), rng.uniform(-2, 9, 5), rng.random(5) < 0.8
        if not present.any():
            continue
        left, inputs = 2 if case % 5 == 0 else 9, rng.uniform(-1, 1, (5, 2))
        observation = replace(seen(pose, mean, log_dets, present, left), known_input=jnp.asarray(inputs))
        steps = min(left, PERIODS)
        paths = (mean[:, None] + np.arange(steps)[:, None] * inputs[:, None])[present]
        tried = [steering(pose, path) for path in paths]
        tried += [constant(pose, command, steps) for command in [*GRID, (0.0, 0.0)]]
        information = np.asarray(observation.information)[present]
        values = np.array([value(poses, paths, information) for _, poses in tried])
        _, control = decide(policy, observation, KEY)
        same = [np.allclose(control, command, atol=1e-9) for command, _ in tried]
        assert max(values[same]) > values.max() - 2e-4
        apart += np.sum(values > values.max() - 1e-4) < 5
    assert apart > 10, "in some of the cases few commands are the best"


def test_what_a_network_is_told():
    """Losses of steering to each target against the same simulation, and the window's own action."""
    rng, told = np.random.default_rng(3), eqx.filter_jit(told_window)
    window = DynamicWindow(PROBLEM, 1.0, NETWORK_VALUES)
    for case in range(12):
        pose = np.array([*rng.uniform(-2, 2, 2), rng.uniform(-9, 9)])
        mean, log_dets = rng.uniform(-5, 5, (4, 2)), rng.uniform(-2, 9, 4)
        left, tells_time = 2 if case % 3 == 0 else 9, case % 2 == 0
        observation = replace(seen(pose, mean, log_dets, np.ones(4, bool), left), robot=Robot.of(PROBLEM))
        steps = min(left, PERIODS) if tells_time else PERIODS
        tracks, information = np.repeat(mean[:, None], steps, axis=1), np.asarray(observation.information)
        ways = [*(steering(pose, track)[1] for track in tracks)]
        values = [value(way, tracks, information) for way in ways]
        others = [value(constant(pose, each, steps)[1], tracks, information) for each in [*COARSE, (0.0, 0.0)]]
        loss = 4 * (max(values + others) - np.array(values))
        tokens = told(tokens_of(observation, "mean", tells_time), observation, tells_time)
        np.testing.assert_allclose(tokens.features[:, 0], np.log1p(loss), atol=1e-6)
        np.testing.assert_allclose(tokens.features[:, 1], np.log1p(loss.min()), atol=1e-6)
        if steps == min(left, PERIODS):
            action = decide(window, observation, KEY)[0]
            np.testing.assert_allclose(np.asarray(tokens.window)[[0, 2]], action, atol=1e-9)


def test_steers_as_price_where_nobody_can_be_reached():
    rng = np.random.default_rng(1)
    window, price = (heuristic_policy(name, PROBLEM, 2.0) for name in ("window", "price"))
    for _ in range(20):
        angle = rng.uniform(-np.pi, np.pi, 5)
        mean = 60.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        observation = seen([0, 0, 1], mean, rng.uniform(-2, 9, 5), np.ones(5, bool))
        np.testing.assert_allclose(decide(window, observation, KEY)[0], decide(price, observation, KEY)[0], atol=1e-9)


@pytest.mark.parametrize(
    ("agent", "count"),
    [
        (FreeBody(kind="body", space="planar", axes=("wz",), lower=(-1.0,), upper=(2.0,)), 8),
        (DifferentialDrive(v_min_m_s=-1.0), 50),
        (Quadrotor(kind="quadrotor"), 17),
    ],
)
def test_commands_reach_all_limits_and_stand_still(agent, count):
    body = agent.agent()
    found = np.asarray(jax.vmap(body.control)(commands(body, max(VALUES.values()))))
    assert len(found) == count
    np.testing.assert_allclose(found.min(axis=0), body.lower)
    np.testing.assert_allclose(found.max(axis=0), body.upper)
    np.testing.assert_allclose(found[-1], 0, atol=1e-12)
    assert len(np.unique(found[:-1].round(9), axis=0)) == count - 1


def test_decides_under_a_schedule():
    """The coming periods are taken to be as the step's."""
    observation, found = seen([0, 0, 0], [[5.0, 1.0], [-3.0, 2.0]], [0.0, -1.0], np.ones(2, bool)), []
    scheduled = replace(Scenario(), schedule=ScheduleSettings(tau_s=(1.0, 0.5))).problem()
    for step, tau_s in enumerate((1.0, 0.5)):
        alone = replace(Scenario(), tau_s=tau_s).problem()
        now = replace(observation, step=jnp.asarray(step))
        found.append(decide(heuristic_policy("window", scheduled, 2.0), now, KEY)[0])
        np.testing.assert_allclose(found[-1], decide(heuristic_policy("window", alone, 2.0), now, KEY)[0], atol=1e-9)
    assert not np.allclose(*found), "the steps differ"


def test_does_not_drive_to_what_is_beyond_a_border():
    """The less certain target cannot be seen from this side, and so the other is the better one."""
    free, region = Scenario(), RegionSettings(low_m=(-1.0, -9.0), high_m=(1.0, 9.0), targets="free")
    observation = seen([0, 0, 0], [[6.0, 0.0], [0.0, -4.0]], [-3.0, 0.0], np.ones(2, bool))
    turns = {}
    for name, scenario in (("free", free), ("bounded", replace(free, region=region))):
        _, control = decide(heuristic_policy("window", scenario.problem(), 2.0), observation, KEY)
        turns[name] = float(control[1])
    assert turns["free"] == pytest.approx(0.0, abs=0.2)
    assert turns["bounded"] < -0.5
