"""Sensors with coordinates of their own in the simulation: its claims, its gradient, its robot's filter."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.episodes import training_episode

from foveate.deploy.tracker import Tracker
from foveate.models.gate import gate_limit
from foveate.names import GATE
from foveate.planning.named import heuristic_policy
from foveate.scenario.agent import DifferentialDrive
from foveate.scenario.field_of_view import BallView, SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import DriftTarget, VelocityTarget
from foveate.simulation.records import SURROGATE, TRUE
from foveate.simulation.rollout import log_dets, rollout

SENSOR = SensorSettings(measures="range-bearing", std_range_m=0.2, std_bearing_rad=0.02, range_growth_per_m=0.1)
SCENES = SceneSettings(
    targets_min=3, targets_max=3, initial_error="consistent", steps=12, drift_m_s=(0.0, 0.0), half_side_m=(6.0, 6.0),
    half_side_per_target_m=0.0,
)  # fmt: skip
SCENARIO = Scenario(
    agent=DifferentialDrive(v_max_m_s=1.0),
    view=BallView(radius_m=12.0, center_m=(0.0, 0.0)),
    sensor=SENSOR,
    target=DriftTarget(process_std_m=0.05, initial_variance_m2=1.0),
    scenes=SCENES,
)


def episodes(problem, count):
    return jax.jit(jax.vmap(lambda key: training_episode(problem, SCENES, key, True)))(
        jax.random.split(jax.random.key(2), count)
    )


def test_the_filters_claims_are_true_over_many_episodes():
    """100 episodes of 3 targets, all in view: NEES of 2 numbers, 2.0 in the mean, with and without the gate."""
    problem = SCENARIO.problem()
    policy, batch = heuristic_policy("nearest", problem, 5.0), episodes(problem, 100)
    for gate in (None, gate_limit(GATE, 2)):
        run = jax.jit(jax.vmap(lambda e, g=gate: rollout(problem, policy, e, TRUE._replace(gate=g), jax.random.key(0))))
        trace = run(batch)
        error = np.asarray(trace.mean) - np.asarray(batch.truth.state)
        nees = np.einsum("ekni,eknij,eknj->ekn", error, np.asarray(trace.information), error)[:, 1:]
        assert 1.7 < nees.mean() < 2.4, gate
        assert nees[:, -1].mean() < 2.4
        assert trace.visible.mean() > 0.95  # a few are beyond 12 m


def test_without_truth_the_gradient_is_that_of_finite_differences():
    """The paper's gradient: a soft view, information linearised at the predicted mean."""
    problem = replace(SCENARIO, view=SectorView(shape="sector", depth_m=4.0, angle_deg=90.0)).problem()
    episode = training_episode(problem, SCENES, jax.random.key(4), False)

    def score(start):
        moved = replace(episode, pose=episode.pose + start)
        return jnp.sum(
            log_dets(problem, heuristic_policy("still", problem, 5.0), moved, SURROGATE, jax.random.key(0))[-1]
        )

    compiled, step = jax.jit(score), 1e-5
    slope = jax.jit(jax.grad(score))(jnp.zeros(3))
    differences = [float(compiled(step * e) - compiled(-step * e)) / (2 * step) for e in np.eye(3)]
    np.testing.assert_allclose(slope, differences, rtol=1e-5, atol=1e-6)
    assert np.abs(slope).max() > 0.1


@pytest.mark.parametrize("measures", ["range-bearing", "bearing"])
def test_the_robots_filter_is_that_of_the_simulation(measures):
    own = {"std_range_m": 0.2, "range_growth_per_m": 0.1} if measures == "range-bearing" else {}
    sensor = SensorSettings(measures=measures, std_bearing_rad=0.02, **own)
    target = VelocityTarget(kind="constant_velocity", initial_variance_m2=1.0)
    scenario = replace(SCENARIO, sensor=sensor, target=target)
    problem = scenario.problem()
    episode = training_episode(problem, SCENES, jax.random.key(6), True)
    policy = heuristic_policy("nearest", problem, 5.0)
    limit = gate_limit(GATE, problem.sensor.size)
    trace = jax.jit(lambda e: rollout(problem, policy, e, TRUE._replace(gate=limit), jax.random.key(0)))(episode)
    tracker = Tracker(scenario, forget_after_s=1e9)
    for i in range(3):
        tracker.add(i, np.zeros(2))
    tracker.mean = np.array(episode.mean, float)
    R, p = problem.agent.space.rotation, problem.agent.space.position
    for k in range(12):
        tracker.predict()
        pose = trace.pose[k + 1]
        q = (np.asarray(episode.truth.state[k + 1, :, :2]) - np.asarray(p(pose))) @ np.asarray(R(pose))
        r, b = np.linalg.norm(q, axis=1), np.arctan2(q[:, 1], q[:, 0])
        noise = np.asarray(episode.truth.measurement_noise[k])
        if measures == "bearing":
            z = (b + 0.02 * noise[:, 0])[:, None]
        else:
            z = np.stack([r + 0.2 * (1 + 0.1 * r) * noise[:, 0], b + 0.02 * noise[:, 1]], axis=1)
        there = np.flatnonzero(problem.sensor.view.contains(jnp.asarray(q)))  # the gate may reject some of these
        seen = tracker.update(np.asarray(pose), {int(i): z[i] for i in there})
        assert seen.updated == tuple(np.flatnonzero(trace.visible[k]))
        np.testing.assert_allclose(tracker.mean, trace.mean[k + 1], rtol=1e-7, atol=1e-7)
        expected = np.linalg.inv(np.asarray(trace.information[k + 1]))
        np.testing.assert_allclose(tracker.covariance, expected, rtol=1e-6, atol=1e-8)
    assert trace.visible.any()


@pytest.mark.parametrize("measures", ["range-bearing", "bearing", "range"])
def test_no_finite_detection_poisons_a_belief(measures):
    stds = {"std_range_m": 0.2} if "range" in measures else {}
    stds |= {"std_bearing_rad": 0.02} if "bearing" in measures else {}
    sensor = SensorSettings(measures=measures, **stds)
    rng = np.random.default_rng(0)
    for gate in (GATE, None):
        tracker = Tracker(replace(SCENARIO, sensor=sensor), gate=gate, forget_after_s=1e9)
        for number in (0.0, -5.0, 1e-300, 1e9, 1e200, -1e308, np.pi, 3.0, np.nan, np.inf):
            for target in ("a", number if number == number else "nan"):
                tracker.update(rng.normal(0, 3, 3), {target: [number] * problem_size(measures)})
                tracker.predict()
        assert np.isfinite(tracker.mean).all()
        assert (np.linalg.eigvalsh(tracker.covariance) > 0).all()
        assert (tracker.belief().information > -np.inf).all()


def problem_size(measures):
    return 2 if measures == "range-bearing" else 1
