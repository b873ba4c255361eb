"""The Poisson multi-Bernoulli filter: the Kalman filter in the limit, and honest in number and error over many runs."""

import itertools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from helpers.crowds import Crowd, draw, run
from scipy.optimize import linear_sum_assignment

from foveate.evaluation.metrics import chi_square_band
from foveate.models.detections import filter as pmb
from foveate.models.detections.records import Scan, Tracks
from foveate.scenario.agent import DifferentialDrive, Quadrotor
from foveate.scenario.detections import BirthSettings, DetectionSettings
from foveate.scenario.field_of_view import BallView, SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.target import VelocityTarget

SETTINGS = DetectionSettings(low_m=(-10.0, -10.0), high_m=(10.0, 10.0), cells=(16, 16), tracks=12, detections=10)
STILL = SceneSettings(drift_m_s=(0.0, 0.0))
IN_SPACE = SceneSettings(drift_m_s=(0.0,) * 3, half_side_m=(0.0,) * 3, centre_m=(0.0,) * 3, initial_error="consistent")
SLOW = VelocityTarget(acceleration_m2_s3=0.01, initial_velocity_variance_m2_s2=0.05)


@pytest.mark.parametrize("d", [2, 3])
def test_known_targets_always_detected_are_those_of_kalman_filters(d):
    """p_D = 1 in a view of everything, no clutter, four targets far apart, detections in any order; filterpy's."""
    ball = BallView(radius_m=1000.0, center_m=(0.0,) * d)
    agent, scenes = (Quadrotor(), IN_SPACE) if d == 3 else (DifferentialDrive(), STILL)
    scenario = Scenario(agent=agent, view=ball, target=SLOW, scenes=scenes)
    problem, rng = scenario.problem(), np.random.default_rng(0)
    corner = (10.0,) * d
    settings = DetectionSettings(
        low_m=tuple(-x for x in corner), high_m=corner, probability=1.0, tracks=6, detections=5
    )
    model, size = settings.model(problem), 2 * d
    A, W, H, V = (np.asarray(x) for x in (problem.motion.A, problem.motion.W, problem.sensor.H, problem.sensor.V))
    places = np.array(list(itertools.product([-50.0, 50.0], repeat=d))[:4])
    state = np.concatenate([places, np.zeros((4, d))], axis=1)
    prior = np.linalg.inv(np.asarray(problem.prior_information))
    tracks = Tracks(
        jnp.ones(4), jnp.asarray(state), jnp.broadcast_to(jnp.asarray(prior), (4, size, size)), jnp.arange(4)
    )
    pose = problem.agent.space.upright(jnp.zeros(d), jnp.zeros(()))
    theirs = [KalmanFilter(dim_x=size, dim_z=d) for _ in range(4)]
    for one, first in zip(theirs, state, strict=True):
        one.x, one.P, one.F, one.Q, one.H, one.R = first, prior, A, W, H, V

    @jax.jit
    def step(population, z):
        population = pmb.predict(problem, model, population, jnp.zeros((6, problem.motion.input_size)))
        return pmb.update(problem, model, population, pose, Scan(z, jnp.arange(5) < 4))

    population = pmb.start(problem, model, pose, tracks)
    for _ in range(8):
        state = state @ A.T + rng.multivariate_normal(np.zeros(size), W, 4)
        z = state @ H.T + rng.multivariate_normal(np.zeros(d), V, 4)
        population = step(population, jnp.asarray(np.append(rng.permutation(z), np.zeros((1, d)), axis=0)))
        for one, measured in zip(theirs, z, strict=True):
            one.predict()
            one.update(measured)
    np.testing.assert_allclose(population.tracks.existence, [1, 1, 1, 1, 0, 0], atol=1e-9)
    np.testing.assert_allclose(population.tracks.mean[:4], [one.x for one in theirs], atol=1e-8)
    np.testing.assert_allclose(population.tracks.covariance[:4], [one.P for one in theirs], atol=1e-8)
    np.testing.assert_array_equal(population.tracks.identity, [0, 1, 2, 3, -1, -1])


def world(**changes) -> tuple[Scenario, DetectionSettings]:
    births = (BirthSettings(rate=0.1),)
    scenario = Scenario(view=SectorView(depth_m=6.0, angle_deg=120.0), target=SLOW, scenes=STILL)
    return scenario, replace(SETTINGS, survival=0.98, undetected=5.0, births=births, **changes)


def watched(scenario: Scenario, settings: DetectionSettings, runs: int, steps: int):
    """Runs of a world that an agent circles in, and what the filter makes of them."""
    problem, time = scenario.problem(), np.arange(steps)
    poses = np.stack([3 * np.cos(0.2 * time), 3 * np.sin(0.2 * time), 0.5 * time], axis=-1)
    crowd = draw(problem, settings, poses, runs, seed=0, slots=16)
    parts = (crowd.pose, crowd.measurement, crowd.valid)
    return crowd, run(problem, settings.model(problem), *map(jnp.asarray, parts))


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.parametrize("changes", [{"probability": 0.9, "clutter": 0.5}, {"probability": 0.6, "clutter": 1.5}])
def test_the_expected_number_is_honest_over_a_thousand_runs(changes):
    """At every step within 3 standard errors of the real number of targets, seen and never seen."""
    crowd, found = watched(*world(**changes), runs=1000, steps=12)
    expected = np.asarray(found.tracks.existence).sum(axis=-1) + np.asarray(found.undetected).sum(axis=(-2, -1))
    error = expected - crowd.alive.sum(axis=-1)
    within = np.abs(error.mean(axis=0)) / (error.std(axis=0) / np.sqrt(1000))
    assert within.max() < 3.0
    assert np.abs(expected[:, -1] - expected.mean()).max() > 1.0  # it follows what is seen, not the mean alone


def errors(crowd: Crowd, found, threshold: float, near_m: float) -> np.ndarray:
    """e^T P^-1 e of tracks above a threshold, each paired with the target nearest to it within a distance."""
    values, tracks = [], found.tracks
    existence, mean, covariance = (np.asarray(x) for x in (tracks.existence, tracks.mean, tracks.covariance))
    for which in np.ndindex(existence.shape[:2]):
        reported, alive = np.flatnonzero(existence[which] > threshold), np.flatnonzero(crowd.alive[which])
        away = mean[which][reported][:, None] - crowd.state[which][alive]
        distance = np.minimum(np.linalg.norm(away[..., :2], axis=-1), near_m)
        for i, j in zip(*linear_sum_assignment(distance), strict=True):
            if distance[i, j] < near_m:
                P = covariance[which][reported[i]]
                values.append(away[i, j] @ np.linalg.solve(P, away[i, j]))
    return np.array(values)


@pytest.mark.exhaustive
@pytest.mark.slow
def test_confirmed_tracks_are_as_wrong_as_they_claim():
    """NEES of certain tracks after ten looks at everything, with misses and false alarms; four numbers a state.

    Where two targets have crossed, a track may be of the other one: NEES above 25, by chance 5 in 100,000.
    """
    scenario = Scenario(view=BallView(radius_m=15.0, center_m=(0.0, 0.0)), target=SLOW, scenes=STILL)
    settings = replace(SETTINGS, probability=0.9, clutter=1.0, undetected=3.0)
    problem, poses = scenario.problem(), np.zeros((10, 3))
    crowd = draw(problem, settings, poses, runs=150, seed=0, slots=12)
    parts = (crowd.pose, crowd.measurement, crowd.valid)
    found = run(problem, settings.model(problem), *map(jnp.asarray, parts))
    last = jax.tree.map(lambda x: x[:, -1:], found)
    nees = errors(crowd._replace(state=crowd.state[:, -1:], alive=crowd.alive[:, -1:]), last, 0.99, 2.0)
    low, high = chi_square_band(4, len(nees))
    assert len(nees) > 200
    assert np.mean(nees > 25) < 0.01
    assert low < nees[nees <= 25].mean() < high
