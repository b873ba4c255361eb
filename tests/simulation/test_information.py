"""The information of a plan: a textbook filter, finite differences, the rollout of training."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.plans import PROBLEM, SPATIAL, TWO, future_of, spatial_future

from foveate.evaluation.evaluate import prepare
from foveate.experiment.presets import PRESETS
from foveate.models.sensor import PAPER_SOFTNESS, Softness
from foveate.planning.receding import FixedActions
from foveate.scenario.field_of_view import BallView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import ScheduleSettings, SensorSettings
from foveate.scenario.target import VelocityTarget
from foveate.simulation.information import Future, final_log_det, looks, mean_score, score
from foveate.simulation.records import SURROGATE
from foveate.simulation.rollout import log_dets

VELOCITY = VelocityTarget(kind="constant_velocity", acceleration_m2_s3=0.02)


def covariance_filter(problem, future, action, weight, mates=(0.0, 0.0)):
    """log det Y by the textbook covariance filter, with V / weight as the noise of a target that counts so much.

    In each step each target is measured by the others of a team, too, with the noise V / `mates`.
    """
    rotation_of, motion, sensor = problem.agent.space.rotation, problem.motion, problem.sensor
    A, W, H = (np.asarray(x) for x in (motion.A, motion.W, sensor.H))
    pose = future.pose
    covariances = [np.linalg.inv(Y) for Y in np.asarray(future.information)]
    for k in range(len(action)):
        pose = problem.agent.move(pose, action[k], problem.tau)
        points = problem.agent.space.to_body(pose, motion.position(future.state[k]))
        for j, P in enumerate(covariances):
            P = P if k == 0 else A @ P @ A.T + W
            w = float(weight(sensor.view.signed_distance(points[j])))
            if w > 0:
                V = np.asarray(sensor.covariance(rotation_of(pose), points[j])) / w
                gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + V)
                P = P - gain @ H @ P
            if mates[j] > 0:
                gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.asarray(sensor.V) / mates[j])
                P = P - gain @ H @ P
            covariances[j] = P
    return -np.array([np.linalg.slogdet(P)[1] for P in covariances])


@pytest.mark.parametrize("hard", [True, False])
def test_score_is_that_of_a_textbook_filter(hard):
    from scipy.special import erfc

    future = spatial_future()
    action = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, (4, 3)))
    level = None if hard else Softness(0.7, 0.5)
    weight = (lambda d: float(d <= 0)) if hard else (lambda d: 0.5 * erfc(float(d) / (np.sqrt(2) * 0.5) - 0.7))
    expected = covariance_filter(SPATIAL, future, action, weight)
    found = jax.jit(lambda f: final_log_det(SPATIAL, f, action, level))(future)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_mean_score_is_the_mean_over_the_steps_of_a_textbook_filter():
    future, weight = spatial_future(), lambda distance: float(distance <= 0)
    action = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, (4, 3)))
    for horizon in (1, 3, 4):
        after = [covariance_filter(SPATIAL, future, action[: k + 1], weight).mean() for k in range(horizon)]
        short = eqx.tree_at(lambda f: f.horizon, future, jnp.array(horizon))
        found = jax.jit(lambda f: mean_score(SPATIAL, f, action, None))(short)
        assert float(found) == pytest.approx(np.mean(after), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("problem", ["planar", "spatial"])
def test_gradient_through_a_plan(problem):
    level, rng = Softness(1.0, 0.6), np.random.default_rng(1)
    if problem == "spatial":
        problem, future, action = SPATIAL, spatial_future(), rng.uniform(-0.8, 0.8, (4, 3))
    else:
        problem = PROBLEM
        future = future_of(PROBLEM, [0, 0, 0.3], rng.uniform(-3, 3, (5, 3, 2)), horizon=4)
        action = rng.uniform(-0.8, 0.8, (5, 2))
    value = jax.jit(lambda a: score(problem, future, a, level))
    gradient = np.asarray(jax.jit(jax.grad(value))(jnp.asarray(action)))
    assert np.abs(gradient).max() > 0.01
    for index in np.ndindex(*action.shape):
        step = np.zeros_like(action)
        step[index] = 1e-5
        difference = (float(value(action + step)) - float(value(action - step))) / 2e-5
        np.testing.assert_allclose(gradient[index], difference, atol=1e-6, rtol=1e-5)


def test_steps_after_the_horizon_and_absent_targets_do_not_count():
    rng = np.random.default_rng(2)
    state, action = rng.uniform(-3, 3, (5, 3, 2)), jnp.asarray(rng.uniform(-1, 1, (5, 2)))
    long = eqx.tree_at(
        lambda f: f.present, future_of(PROBLEM, [0, 0, 0], state, horizon=3), jnp.array([True, True, False])
    )
    short = future_of(PROBLEM, [0, 0, 0], state[:3, :2])
    worth = jax.jit(lambda f, a: score(PROBLEM, f, a, PAPER_SOFTNESS))
    np.testing.assert_allclose(worth(long, action), worth(short, action[:3]), rtol=1e-12)


def test_score_is_that_of_the_one_simulation():
    """The noise-free rollout of training, with the same actions."""
    suite = prepare(PROBLEM, PRESETS["paper"].scenario.scenes, [TWO], seed=3)
    episode = jax.tree.map(lambda x: x[0], suite.episodes)
    episode = eqx.tree_at(lambda e: e.truth, episode, None)
    action = jnp.asarray(np.random.default_rng(4).uniform(-1, 1, (TWO.horizon, 2)))
    simulated = jax.jit(lambda e: log_dets(PROBLEM, FixedActions(action), e, SURROGATE, jax.random.key(0)))(episode)
    mean = [episode.mean]
    for known_input in episode.inputs:
        mean.append(PROBLEM.motion.advance(mean[-1], known_input))
    Y = np.asarray(PROBLEM.prior_information)
    future = future_of(PROBLEM, episode.pose, mean[1:], np.linalg.inv(np.linalg.inv(Y) + np.asarray(PROBLEM.motion.W)))
    found = jax.jit(lambda f: final_log_det(PROBLEM, f, action, PAPER_SOFTNESS))(future)
    np.testing.assert_allclose(found, simulated[-1], rtol=1e-12)


def test_looks_of_a_team_are_measurements_and_what_is_told_is_the_share_of_steps_in_view():
    future, mates = spatial_future(), (0.25, 1.5)
    action = jnp.asarray(np.random.default_rng(5).uniform(-1, 1, (4, 3)))
    added = jnp.asarray(mates)[:, None, None] * SPATIAL.sensor.information(SPATIAL.sensor.V)
    found = jax.jit(lambda f: final_log_det(SPATIAL, f, action, None))(replace(future, mates=added))
    expected = covariance_filter(SPATIAL, future, action, lambda distance: distance <= 0, mates)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    pose, in_view = future.pose, []
    for k in range(4):
        pose = SPATIAL.agent.move(pose, action[k], SPATIAL.tau)
        in_view.append(SPATIAL.sees(pose, SPATIAL.motion.position(future.state[k])))
    mean = np.mean(in_view[:3], axis=0)
    assert 0 < mean.max() <= 1
    short = replace(future, horizon=jnp.array(3), present=jnp.array([True, False]))
    np.testing.assert_allclose(jax.jit(lambda f: looks(SPATIAL, f, action, None))(short), mean * [1, 0])


def test_no_measurement_counts_that_a_filter_of_ranges_and_bearings_would_not_take():
    """A robot at rest; three steps of a textbook filter, without what is then less well known than half its range."""
    sensor = SensorSettings(measures="range-bearing", std_range_m=0.2, std_bearing_rad=0.02)
    view, scenes = BallView(radius_m=9.0, center_m=(0.0, 0.0)), SceneSettings(initial_error="consistent")
    problem = Scenario(view=view, sensor=sensor, target=VELOCITY, scenes=scenes).problem()
    positions = np.array([[4.0, 2.0], [0.02, 0.01], [-0.3, 0.2], [12.0, 0.0]])
    state = np.broadcast_to(np.hstack([positions, np.zeros((4, 2))]), (3, 4, 4))
    future, still = future_of(problem, [0, 0, 0], state), jnp.zeros((3, 2)).at[:, 0].set(-1.0)
    A, W, P0 = (np.asarray(x) for x in (problem.motion.A, problem.motion.W, problem.prior_information))
    expected, taken = [], []
    for x, y in positions:
        P, r, log_det = np.linalg.inv(P0), np.hypot(x, y), []
        H = np.array([[x / r, y / r, 0, 0], [-y / r**2, x / r**2, 0, 0]])
        for k in range(3):
            P = P if k == 0 else A @ P @ A.T + W
            gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag([0.2**2, 0.02**2]))
            after = P - gain @ H @ P
            taken.append(np.trace(after[:2, :2]) <= 0.25 * r**2 and r < 9)
            P = after if taken[-1] else P
            log_det.append(-np.linalg.slogdet(P)[1])
        expected.append(log_det)
    assert taken == [True] * 3 + [False] * 9
    found = jax.jit(lambda f: final_log_det(problem, f, still, None))(future)
    np.testing.assert_allclose(found, np.array(expected)[:, -1], rtol=1e-6)
    mean = jax.jit(lambda f: mean_score(problem, f, still, None))(future)
    assert float(mean) == pytest.approx(np.mean(expected), rel=1e-6)


def test_a_schedule_is_rejected():
    changing = Scenario(schedule=ScheduleSettings(tau_s=(1.0, 0.5))).problem()
    future = Future(
        pose=jnp.zeros(3),
        state=jnp.ones((2, 1, 2)),
        information=0.5 * jnp.eye(2)[None],
        present=jnp.array([True]),
        horizon=jnp.array(2),
    )
    with pytest.raises(ValueError, match="the scenario has a schedule"):
        score(changing, future, jnp.zeros((2, 2)), None)
