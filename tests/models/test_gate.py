"""The gate against scipy's Gaussian and filterpy; what it rejects, and when it gives in."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.spatial.distance import mahalanobis
from scipy.stats import chi2

from foveate.deploy.tracker import Tracker
from foveate.models.belief import Belief
from foveate.models.gate import RESTART_AFTER, gate_limit, one_point, squared_distance
from foveate.names import GATE
from foveate.planning.named import heuristic_policy
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.sensor import SensorSettings
from foveate.simulation.records import TRUE, Episode, Truth
from foveate.simulation.rollout import rollout

SCENARIO = Scenario(view=SectorView(depth_m=1e6, angle_deg=360.0))
LIMIT = gate_limit(GATE, 2)


def test_distance_is_mahalanobis():
    rng = np.random.default_rng(0)
    root, noise, H = rng.normal(size=(4, 4)), rng.normal(size=(2, 2)), rng.normal(size=(2, 4))
    P, V, mean, z = root @ root.T, noise @ noise.T, rng.normal(size=4), rng.normal(size=2)
    found = squared_distance(Belief(jnp.asarray(mean), jnp.linalg.inv(P)), *map(jnp.asarray, (z, H, V)))
    expected = mahalanobis(z, H @ mean, np.linalg.inv(H @ P @ H.T + V)) ** 2
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_limit_is_the_quantile():
    assert gate_limit(0.99, 3) == chi2.ppf(0.99, 3)
    assert gate_limit(None, 3) is None
    with pytest.raises(ValueError, match=r"gate = 1\.0: expected a probability between 0 and 1, or None"):
        gate_limit(1.0, 2)


def test_one_point_is_the_update_of_a_flat_prior_on_position():
    H, V, P_0 = np.eye(2, 4), np.array([[0.04, 0.01], [0.01, 0.09]]), np.diag([2.0, 3.0, 0.5, 0.7])
    z = np.array([1.0, -2.0])
    found = one_point(*map(jnp.asarray, (np.linalg.inv(P_0), z, H, V)))
    theirs = KalmanFilter(dim_x=4, dim_z=2)
    theirs.P, theirs.H = np.diag([1e10, 1e10, 0.5, 0.7]), H
    theirs.update(z[:, None], R=V)
    np.testing.assert_allclose(found.mean, theirs.x[:, 0], atol=1e-8)
    np.testing.assert_allclose(np.linalg.inv(found.information), theirs.P, atol=1e-8)


def drive(steps, wild, gate=LIMIT):
    """A target in view that stands still; `wild` are jumps [m] of its place, by step."""
    problem = SCENARIO.problem()
    state = np.zeros((steps + 1, 1, 2))
    for step, jump in wild.items():
        state[step + 1, 0, 0] += jump
    noise = np.random.default_rng(2).normal(size=(steps, 1, 2))
    episode = Episode(
        pose=jnp.zeros(3),
        mean=jnp.zeros((1, 2)),
        present=jnp.ones(1, bool),
        inputs=jnp.zeros((steps, 1, problem.motion.input_size)),
        horizon=jnp.asarray(steps),
        truth=Truth(jnp.asarray(state), jnp.asarray(noise)),
    )
    still = heuristic_policy("still", problem, 2.0)
    run = jax.jit(lambda: rollout(problem, still, episode, TRUE._replace(gate=gate), jax.random.key(0)))
    return jax.tree.map(np.asarray, run())


def test_an_outlier_of_100_sigma_is_rejected_without_effect():
    clean, disturbed, open_to_all = drive(12, {}), drive(12, {6: 100.0}), drive(12, {6: 100.0}, gate=None)
    assert disturbed.rejections[:, 0].tolist() == [0] * 6 + [1] + [0] * 5
    assert disturbed.visible[:, 0].tolist() == [True] * 6 + [False] + [True] * 5
    np.testing.assert_array_equal(disturbed.mean[:7], clean.mean[:7])
    np.testing.assert_array_equal(disturbed.mean[7], clean.mean[6], "only predicted, and nothing pushes it")
    assert np.abs(disturbed.mean[7:]).max() < 0.5
    assert np.abs(open_to_all.mean[7]).max() > 5.0, "without the gate it would have been pulled away"
    assert open_to_all.rejections is None
    np.testing.assert_array_equal(clean.mean, drive(12, {}, gate=None).mean, "an honest measurement is as it was")


def test_a_target_that_jumps_restarts_its_belief():
    jump = dict.fromkeys(range(6, 16), 100.0)
    trace = drive(16, jump)
    assert trace.rejections[6:12, 0].tolist() == [1, 2, 3, 4, 0, 0]
    assert RESTART_AFTER == 5
    assert trace.visible[6:12, 0].tolist() == [False] * 4 + [True] * 2
    np.testing.assert_allclose(trace.mean[11:, 0], [[100.0, 0.0]] * 6, atol=1.0)
    V = np.asarray(SCENARIO.problem().sensor.V)
    np.testing.assert_allclose(trace.information[11, 0], np.linalg.inv(V), rtol=1e-9)


def test_the_tracker_does_the_same():
    tracker = Tracker(SCENARIO)
    tracker.add("a", [0.0, 0.0])
    tracker.add("b", [1.0, 0.0])
    seen = []
    for _ in range(RESTART_AFTER):
        tracker.predict()
        seen.append(tracker.update(np.zeros(3), {"a": [100.0, 0.0], "b": [1.0, 0.0]}))
    assert [one.rejected for one in seen] == [("a",)] * 4 + [()]
    assert seen[-1].appeared == ("a",)
    assert tracker.ids == ("a", "b")
    assert tracker.rejected == {"a": 4}
    np.testing.assert_allclose(tracker.mean[0], [100.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(tracker.covariance[0], SCENARIO.problem().sensor.V, rtol=1e-6)
    assert tracker.unseen_s.tolist() == [0.0, 0.0]


def test_a_restart_has_the_noise_of_the_place_where_it_was_measured():
    """1.70 m at 15 m with 0.1 + 0.107 a metre; at the mean that was rejected, on the agent, it would be 0.1 m."""
    sensor = SensorSettings(std_m=0.1, range_growth_per_m=1.0667)
    problem = replace(SCENARIO, sensor=sensor).problem()
    jump, steps = 15.0, RESTART_AFTER
    state = np.zeros((steps + 1, 1, 2))
    state[1:, 0, 0] = jump
    episode = Episode(
        pose=jnp.zeros(3),
        mean=jnp.zeros((1, 2)),
        present=jnp.ones(1, bool),
        inputs=jnp.zeros((steps, 1, 2)),
        horizon=jnp.array(steps),
        truth=Truth(jnp.asarray(state), jnp.zeros((steps, 1, 2))),
    )
    protocol = TRUE._replace(gate=1e-3)
    problem = eqx.tree_at(lambda p: p.prior_information, problem, 1e4 * jnp.eye(2))
    trace = rollout(problem, heuristic_policy("still", problem, 1.0), episode, protocol, jax.random.key(0))
    deviation = np.sqrt(np.diag(np.linalg.inv(trace.information[-1, 0])))
    np.testing.assert_allclose(deviation, 0.1 * (1 + 1.0667 * jump), rtol=1e-6)
    np.testing.assert_allclose(trace.mean[-1, 0], [jump, 0.0], atol=1e-9)
