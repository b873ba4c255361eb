"""Robots of different kinds in one team: own limits, views and decisions, and the sender's noise."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.teams import kalman, known_measurements

from foveate.planning.named import heuristic_in
from foveate.scenario.agent import DifferentialDrive
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.kinds import RobotSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import ScheduleSettings, SensorSettings
from foveate.scenario.target import VelocityTarget
from foveate.scenario.team import RadioSettings, TeamSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import SURROGATE, TRUE
from foveate.simulation.rollout import rollout
from foveate.simulation.team.rollout import first_observations

M, K, N, TAU = 3, 10, 2, 0.5
FAST = RobotSettings(
    agent=DifferentialDrive(v_max_m_s=3.0, w_max_rad_s=2.0),
    view=SectorView(depth_m=3.0, angle_deg=140.0),
    sensor=SensorSettings(std_m=0.1),
)
FAR = RobotSettings(
    agent=DifferentialDrive(v_max_m_s=0.5, w_max_rad_s=0.6),
    view=SectorView(depth_m=9.0, angle_deg=70.0),
    sensor=SensorSettings(std_m=0.6),
)
STDS, DEPTHS, ANGLES = (0.1, 0.6, 0.1), (3.0, 9.0, 3.0), (140.0, 70.0, 140.0)
SCENARIO = Scenario(
    tau_s=TAU,
    view=SectorView(depth_m=6.0, angle_deg=120.0),
    target=VelocityTarget(kind="constant_velocity", acceleration_m2_s3=0.1, initial_velocity_variance_m2_s2=0.2),
    scenes=SceneSettings(
        targets_min=N, targets_max=N, half_side_m=(5.0, 5.0), half_side_per_target_m=0.0, drift_m_s=(0.3, 0.3),
        steps=K, initial_error="consistent",
    ),
    team=TeamSettings(agents=M, robots=(FAST, FAR)),
)  # fmt: skip
SILENT = RadioSettings(loss=1.0)


def with_radio(radio):
    return replace(SCENARIO, team=TeamSettings(agents=M, robots=(FAST, FAR), radio=radio))


def run(scenario, problem, policy, key, protocol=TRUE):
    episode = training_episode(problem, scenario.scenes, key, noise=True)
    return episode, rollout(problem, policy, episode, protocol, key)


@functools.lru_cache
def play(scenario, name="nearest", protocol=TRUE):
    problem, policy = scenario.problem(), heuristic_in(scenario, name)
    played = jax.jit(lambda key: run(scenario, problem, policy, key, protocol))(jax.random.key(4))
    return problem, *jax.tree.map(np.asarray, played)


@pytest.mark.parametrize(
    "radio", [RadioSettings(), RadioSettings(loss=0.5, delay_steps=1, memory_steps=K)], ids=["always", "lossy and late"]
)
def test_beliefs_are_those_of_one_filter_with_the_noise_of_each_sender(radio):
    problem, episode, trace = play(with_radio(radio))
    assert (trace.team.visible.sum(axis=(0, 2)) > 1).sum() >= 2
    noises = [std**2 * np.eye(2) for std in STDS]
    known = known_measurements(trace, radio.delay_steps)
    everything = {(k, m) for k in range(K) for m in range(M)}
    for k, target in np.ndindex(K, N):
        mean, P = kalman(problem, episode, trace, everything, k, target, noises)
        np.testing.assert_allclose(trace.mean[k + 1, target], mean, atol=1e-8)
        np.testing.assert_allclose(trace.log_det[k, target], -np.linalg.slogdet(P)[1], atol=1e-8)
        for m in range(M):
            mean, P = kalman(problem, episode, trace, known[k][m], k, target, noises)
            error = mean - episode.truth.state[k + 1, target]
            np.testing.assert_allclose(trace.team.log_det[k, m, target], -np.linalg.slogdet(P)[1], atol=1e-8)
            np.testing.assert_allclose(trace.team.nees[k, m, target], error @ np.linalg.solve(P, error), atol=1e-6)
            if radio.loss == 0:
                np.testing.assert_allclose(trace.team.log_det[k, m], trace.log_det[k], atol=1e-12)


def test_every_robot_keeps_its_own_limits_and_sees_by_its_own_view():
    _, episode, trace = play(SCENARIO)
    pose = trace.team.pose
    speed = np.linalg.norm(np.diff(pose[..., :2], axis=0), axis=-1) / TAU
    turn = np.abs((np.diff(pose[..., 2], axis=0) + np.pi) % (2 * np.pi) - np.pi) / TAU
    assert np.all(speed <= np.array([3.0, 0.5, 3.0]) + 1e-9)
    assert np.all(turn <= np.array([2.0, 0.6, 2.0]) + 1e-9)
    assert speed[:, [0, 2]].max() > 2.0
    for k, m, target in np.ndindex(K, M, N):
        away = episode.truth.state[k + 1, target, :2] - pose[k + 1, m, :2]
        bearing = np.arctan2(away[1], away[0]) - pose[k + 1, m, 2]
        bearing = np.degrees(np.abs((bearing + np.pi) % (2 * np.pi) - np.pi))
        inside = np.hypot(*away) <= DEPTHS[m] and bearing <= ANGLES[m] / 2
        assert trace.team.visible[k, m, target] == inside


def test_a_policy_is_told_its_own_robot_and_that_of_every_mate():
    problem = SCENARIO.problem()
    episode = training_episode(problem, SCENARIO.scenes, jax.random.key(0), noise=True)
    seen = jax.jit(lambda episode: first_observations(problem, episode, TRUE))(episode)
    robot = seen.robot
    np.testing.assert_allclose(robot.problem.agent.upper, [[3.0, 2.0], [0.5, 0.6], [3.0, 2.0]])
    np.testing.assert_allclose(robot.extent.ahead_m, DEPTHS)
    np.testing.assert_allclose(robot.problem.sensor.V[:, 0, 0], np.square(STDS))
    own = jax.tree.map(lambda x: x[0], robot.problem)
    for m in range(M):
        mate = own.of_robot(m)
        np.testing.assert_allclose(mate.sensor.view.extent.ahead_m, DEPTHS[m])
        np.testing.assert_allclose(mate.sensor.V, STDS[m] ** 2 * np.eye(2))


@pytest.mark.parametrize(("name", "protocol"), [("nearest", SURROGATE), ("window", TRUE), ("post", TRUE)])
def test_without_a_radio_each_is_the_single_robot_of_its_kind(name, protocol):
    _, episode, trace = play(with_radio(SILENT), name, protocol)
    episode = jax.tree.map(jnp.asarray, episode)
    for m in range(M):
        alone = replace(SCENARIO.of_robot(m), team=None)
        problem, policy = alone.problem(), heuristic_in(alone, name)
        noise = episode.truth.measurement_noise if m == 0 else episode.team.measurement_noise[:, m - 1]
        start = episode.pose if m == 0 else episode.team.poses[m - 1]
        truth = replace(episode.truth, measurement_noise=noise)
        own = replace(episode, pose=start, truth=truth, team=None)
        single = jax.jit(lambda own, p=problem, policy=policy: rollout(p, policy, own, protocol, jax.random.key(4)))(
            own
        )
        np.testing.assert_array_equal(trace.team.visible[:, m], single.visible)
        np.testing.assert_allclose(trace.team.log_det[:, m], single.log_det, atol=1e-10)
        np.testing.assert_allclose(trace.team.pose[:, m], single.pose, atol=1e-10)


def program(scenario, name="nearest"):
    problem, policy = scenario.problem(), heuristic_in(scenario, name)
    return str(jax.make_jaxpr(lambda key: run(scenario, problem, policy, key))(jax.random.key(0)))


def test_listed_robots_that_are_alike_compile_to_the_program_of_a_team_of_such_robots():
    listed = replace(SCENARIO, team=TeamSettings(agents=M, robots=(FAR, FAR)))
    assert listed.of_robot(0) == replace(SCENARIO.of_robot(1), team=TeamSettings(agents=M))
    assert program(listed) == program(listed.of_robot(0))
    assert program(SCENARIO) != program(listed)


def test_a_schedule_keeps_the_noise_of_each_robot():
    """Steps of different lengths: after one step the information is that of each robot's own measurements."""
    scenario = replace(with_radio(SILENT), schedule=ScheduleSettings(tau_s=(0.5, 0.25)))
    problem = scenario.problem()
    for m, std in enumerate(STDS):
        for step in range(3):
            own = problem.of_robot(m).at(jnp.asarray(step))
            np.testing.assert_allclose(own.sensor.V, std**2 * np.eye(2))
            assert float(own.tau) == (0.5, 0.25)[step % 2]
    V = ((0.04, 0.0), (0.0, 0.09))
    agents = TeamSettings(agents=M, robots=(RobotSettings(agent=FAST.agent), RobotSettings()))
    scheduled = replace(SCENARIO, schedule=ScheduleSettings(V=(V,)), team=agents).problem()
    for m in range(2):
        np.testing.assert_allclose(scheduled.of_robot(m).at(jnp.asarray(1)).sensor.V, V)
