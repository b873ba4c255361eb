"""Every feature of a token against numpy; what must not change them."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.observations import SCENARIOS, moved, scene, seen

from foveate.experiment.presets import QUADROTOR
from foveate.policies.steering import steer
from foveate.policies.tokens import token_size, tokens_of
from foveate.scenario.agent import DifferentialDrive, Quadrotor
from foveate.scenario.field_of_view import FrustumView, TriangleView
from foveate.scenario.scenario import Scenario
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import DriftTarget, VelocityTarget

OWN_NOISE = replace(
    Scenario(),
    sensor=SensorSettings(V=((0.04, 0.01), (0.01, 0.09)), frame="body", range_growth_per_m=0.5),
    scenes=replace(Scenario().scenes, initial_error="consistent"),
)
"""The sensor's noise turns with the agent and grows with the range."""
CASES = {**SCENARIOS, "noise of the body": OWN_NOISE}

tokens = eqx.filter_jit(tokens_of)
"""Compiled once for each scenario and number of targets, so most tests have five."""


def noise_at_standoff(name, turn):
    """V in the world for a target in the middle of the view."""
    if name != "noise of the body":
        return 0.04 * np.eye(len(turn))
    return turn @ np.array([[0.04, 0.01], [0.01, 0.09]]) @ turn.T * (1 + 0.5 * 1.0) ** 2


def limits(d):
    """Depth [m], half angles [rad] and period [s] of a scenario, and its largest speeds: ahead, up, of a turn."""
    if d == 2:
        return 2.0, np.pi / 3, np.pi, 1.0, 4.0, 0.0, np.pi / 3
    return 6.0, np.pi / 4, np.pi / 6, 0.5, 4.0, 2.0, np.pi / 2


def steps_by_hand(q):
    """Steps of turning and of driving until a body-frame point [m] is in view."""
    depth, half_width, half_height, tau, ahead, up, yaw = limits(len(q))
    away, bearing = np.linalg.norm(q[:2]), abs(np.arctan2(q[1], q[0]))
    turn, drive = max(bearing - half_width, 0) / (yaw * tau), max(away - depth, 0) / (ahead * tau)
    if len(q) == 3:
        drive = max(drive, away * max(abs(np.arctan2(q[2], away)) - half_height, 0) / (up * tau))
    return np.array([turn, drive])


def triangle_distance(q):
    """Signed distance [m] to the triangle of depth 2 m and 120 degrees."""
    corners = np.array([[0, 0], [2, -2 * np.sqrt(3)], [2, 2 * np.sqrt(3)]])
    ends = np.roll(corners, -1, axis=0)
    share = [np.clip((q - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1) for a, b in zip(corners, ends, strict=True)]
    away = min(np.linalg.norm(q - a - s * (b - a)) for s, a, b in zip(share, corners, ends, strict=True))
    return -away if q[0] <= 2 and abs(q[1]) <= np.sqrt(3) * q[0] else away


def log_det(matrix):
    return np.linalg.slogdet(matrix)[1]


def by_hand(name, turn, place, mean, information, known_input, left):
    """Target by target, feature by feature."""
    problem, d = CASES[name].problem(), len(place)
    depth, half_width, _, tau, *_ = limits(d)
    A, B, W = (np.asarray(getattr(problem.motion, matrix)) for matrix in "ABW")
    H, V = np.asarray(problem.sensor.H), np.asarray(problem.sensor.V)
    q = (mean[:, :d] - place) @ turn
    gain = [log_det(Y + H.T @ np.linalg.inv(noise_at_standoff(name, turn)) @ H) - log_det(Y) for Y in information]
    worst, rows = min(map(log_det, information)), []
    for i, (p, Y, xi) in enumerate(zip(mean, information, known_input, strict=True)):
        away = np.sqrt(q[i] @ q[i] / depth**2 + 0.05**2)
        covariance = np.linalg.inv(Y)
        root = np.linalg.cholesky(turn.T @ covariance[:d, :d] @ turn)
        std = np.linalg.det(root) ** (1 / d)
        sensor_std = np.prod(np.diag(V)) ** (0.5 / d)
        moves = tau * np.sqrt(np.trace(covariance[d:, d:])) / depth
        others = [j for j in range(len(mean)) if j != i]
        near = [[np.exp(-0.5 * np.sum((q[i] - q[j]) ** 2) / (r * depth) ** 2) for j in others] for r in (0.5, 2.0)]
        distance = triangle_distance(q[i]) if d == 2 else float(problem.sensor.view.signed_distance(jnp.asarray(q[i])))
        rows.append(
            [
                *(q[i] / depth / away),
                np.log(away),
                np.tanh(away / 4),
                *np.arcsinh(q[i] / depth),
                *(turn.T @ (A @ p + B @ xi - p)[:d] / depth),
                *(np.log(np.diag(root) / depth) / 3),
                *(root[j, k] / root[j, j] for j in range(d) for k in range(j)),
                np.log(std / sensor_std) / 2,
                np.arcsinh(10 * moves),
                min(std / depth, 2.0),
                *np.log1p(steps_by_hand(q[i])),
                np.clip(distance / depth, -1, 2),
                gain[i] / 4,
                (log_det(Y) + log_det(A @ covariance @ A.T + W)) / 4,
                (log_det(Y) - worst) / 4,
                *(np.log1p(np.dot(weights, [gain[j] for j in others])) for weights in near),
                np.log1p(len(mean)),
                *np.exp(-left / np.array([3.0, 10.0, 40.0])),
                *(0.0, 0.0),  # for the score at the end
                # In views, ahead and back: the vehicle drives by two and turns by one, the quadrotor moves by a third.
                *(np.log(np.add((2, 0, 1, 0, 0, 1) if d == 2 else 2 * (1 / 3, 1 / 3, 1 / 6, 0, 0, 1), 1e-3)) / 3),
                np.log(np.sqrt(np.mean(np.diag(V))) / depth + 1e-4) / 3,
                np.log(np.sqrt(np.mean(np.diag(W)[:d])) / depth + 1e-4) / 3,
                np.log(np.sqrt(2.0) / depth) / 3,
                half_width / np.pi,
                *np.zeros(2 * d),  # no region
            ]
        )
    return np.array(rows), q


@pytest.mark.parametrize("name", CASES)
def test_features_aim_and_urgency(name):
    scenario = CASES[name]
    problem, d = scenario.problem(), scenario.dimension
    for seed in range(3):
        parts = scene(d, 5, seed, reach_m=(1.0, 4.0, 12.0)[seed])
        found = tokens(seen(scenario, *parts), "terminal", True)
        expected, q = by_hand(name, *parts, left=7)
        np.testing.assert_allclose(found.features, expected, atol=1e-9)
        urgency = [[log_det(Y), steps_by_hand(point).sum()] for Y, point in zip(parts[3], q, strict=True)]
        np.testing.assert_allclose(found.urgency, urgency, atol=1e-9)
        aim = [steer(problem.agent, problem.tau, jnp.asarray(x), limits(d)[0] / 2) for x in q]
        axes = list(problem.agent.axes)
        np.testing.assert_allclose(found.aim[:, axes], aim, atol=1e-9)
        np.testing.assert_array_equal(np.delete(found.aim, axes, axis=1), 0)
        assert found.features.shape[1] == token_size(problem)
    # A view in half the range of a step: 2 of 2 m, 60 of 60 degrees; 6 of 2 m (of 1 m: at most 3), 45 of 45 degrees.
    np.testing.assert_allclose(found.unit, [1, 0, 1] if d == 2 else [3, 3, 3, 0, 0, 1], rtol=1e-12)


@pytest.mark.parametrize("name", SCENARIOS)
def test_only_who_is_told_the_time_knows_it(name):
    scenario = SCENARIOS[name]
    parts = scene(scenario.dimension, 5)
    early, late = (seen(scenario, *parts, left=left) for left in (9, 2))
    told = tokens(early, "terminal", True).features
    plain = tokens(early, "terminal", False).features
    assert plain.shape == told.shape
    np.testing.assert_array_equal(plain, tokens(late, "terminal", False).features)
    differing = np.flatnonzero((told != tokens(late, "terminal", True).features).all(axis=0))
    others = (np.delete(features, differing, axis=1) for features in (told, plain))
    np.testing.assert_allclose(*others, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(plain[:, differing], 0)
    assert len(differing) == 3
    # Steps after the end, in padded batches.
    np.testing.assert_array_equal(
        tokens(seen(scenario, *parts, left=-30), "terminal", True).features,
        tokens(seen(scenario, *parts, left=0), "terminal", True).features,
    )


SEVENFOLD = {
    "plane": replace(
        Scenario(),
        agent=DifferentialDrive(v_max_m_s=28.0),
        view=TriangleView(depth_m=14.0),
        sensor=SensorSettings(std_m=1.4),
        target=DriftTarget(process_std_m=0.35, initial_variance_m2=98.0),
    ),
    "space": replace(
        QUADROTOR,
        agent=Quadrotor(kind="quadrotor", v_max_m_s=28.0, climb_max_m_s=14.0),
        view=FrustumView(shape="frustum", near_m=2.1, depth_m=42.0),
        sensor=SensorSettings(std_m=1.4),
        target=VelocityTarget(
            kind="constant_velocity",
            acceleration_m2_s3=0.02 * 49,
            initial_variance_m2=98.0,
            initial_velocity_variance_m2_s2=0.16 * 49,
        ),
    ),
}


@pytest.mark.parametrize("name", SCENARIOS)
def test_scale_of_lengths_does_not_matter(name):
    turn, place, mean, information, known_input = scene(SCENARIOS[name].dimension, 5)
    here = tokens(seen(SCENARIOS[name], turn, place, mean, information, known_input), "terminal", True)
    large = seen(SEVENFOLD[name], turn, 7 * place, 7 * mean, information / 49, 7 * known_input)
    there = tokens(large, "terminal", True)
    for part in ("features", "aim", "unit"):
        np.testing.assert_allclose(getattr(there, part), getattr(here, part), atol=1e-9)
    steps = np.asarray(here.urgency[:, 1])
    np.testing.assert_allclose(there.urgency[:, 1], steps, atol=1e-9)
    np.testing.assert_allclose(np.ptp(there.urgency[:, 0] - here.urgency[:, 0]), 0, atol=1e-9)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_world_frame_does_not_matter(name):
    parts = scene(SCENARIOS[name].dimension, 5)
    here, there = (tokens(seen(SCENARIOS[name], *each), "terminal", True) for each in (parts, moved(*parts)))
    for part in ("features", "aim", "urgency"):
        np.testing.assert_allclose(getattr(there, part), getattr(here, part), atol=1e-9)


@pytest.mark.parametrize("name", SCENARIOS)
def test_padding_may_hold_anything(name):
    scenario = SCENARIOS[name]
    turn, place, *targets = scene(scenario.dimension, 7)
    few = tokens(seen(scenario, turn, place, *(part[:5] for part in targets)), "terminal", True)
    mean, information, known_input = (np.array(part) for part in targets)
    for left_over in (0.0, 1e6, np.nan):
        mean[5:], information[5:], known_input[5:] = left_over, left_over, 0.0
        padded = seen(scenario, turn, place, mean, information, known_input, np.arange(7) < 5)
        found = tokens(padded, "terminal", True)
        for part in ("features", "aim", "urgency"):
            np.testing.assert_allclose(getattr(found, part)[:5], getattr(few, part), atol=1e-12)
            assert np.isfinite(getattr(found, part)).all()
        np.testing.assert_array_equal(found.features[5:], 0)


@pytest.mark.parametrize("name", SCENARIOS)
def test_extremes_are_finite_in_float32(name):
    """Nobody there, a target at the agent itself, one far away and hardly known, one known to a hair."""
    scenario = SCENARIOS[name]
    turn, place, mean, information, known_input = scene(scenario.dimension, 5)
    mean[0, : len(place)], mean[1, : len(place)] = place, 1e4
    information[1], information[2] = 1e-4 * np.eye(mean.shape[1]), 1e6 * np.eye(mean.shape[1])
    for present in (np.ones(5, bool), np.zeros(5, bool)):
        exact = tokens(seen(scenario, turn, place, mean, information, known_input, present), "terminal", True)
        with jax.enable_x64(False):
            narrow = seen(scenario, turn, place, mean, information, known_input, present)
            found = tokens(narrow, "terminal", True)
        assert found.features.dtype == jnp.float32
        # Of the target known to a hair: the prediction is the difference of two numbers 1e5 times as large.
        np.testing.assert_allclose(found.features, exact.features, atol=1e-2)
        for part in (found.features, found.aim, found.urgency):
            assert np.isfinite(part).all()
            assert np.abs(part).max() < 2100


def test_without_a_robot_it_says_so():
    observation = replace(seen(Scenario(), *scene(2, 2)), robot=None)
    with pytest.raises(ValueError, match=r"observation\.robot = None: expected the robot"):
        tokens_of(observation, "terminal", True)
