"""The estimate of what rounding costs, against episodes in float32 beside the same in float64."""

import logging
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.experiment.presets import PRESETS
from foveate.geometry.linalg import log_det_spd
from foveate.io.jax_settings import quick_compilation
from foveate.models.belief import predict_information, update_information
from foveate.models.precision import _Motion, _unseen, rounding_error, rounds_alike, warn_of_rounding
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import AccelerationTarget, DriftTarget, LinearTarget, VelocityTarget


def in_precision(x64, scenario, reversible=True):
    """The problem; unless `reversible`, with predictions by inverses, as of motions that cannot be reversed.

    None leaves that to the problem.
    """
    with jax.enable_x64(x64):
        problem = scenario.problem()
        if reversible is None:
            return problem
        return replace(problem, motion=replace(problem.motion, is_reversible=reversible))


def log_dets(problem, times_unseen, x64):
    """log det of a target that is unseen for some steps and then seen at every step, for each of these times."""
    with jax.enable_x64(x64):
        gain = problem.sensor.H.T @ jnp.linalg.inv(problem.sensor.V) @ problem.sensor.H

        @jax.jit
        def seen_after(unseen):
            def step(information, k):
                information = predict_information(information, problem.motion)
                information = update_information(information, gain, (k >= unseen).astype(gain.dtype))
                return information, log_det_spd(information)

            steps = jnp.arange(max(times_unseen) + 3)
            found = jax.lax.scan(step, problem.prior_information, steps)[1]
            return jax.lax.dynamic_slice(found, (unseen,), (3,))

        return np.array([seen_after(unseen) for unseen in times_unseen], float)


def errors_in_float32(scenario, times_unseen, reversible):
    both = [log_dets(in_precision(x64, scenario, reversible), times_unseen, x64) for x64 in (False, True)]
    return np.abs(both[0] - both[1]).max(axis=1)


@pytest.mark.slow
def test_the_estimate_is_of_the_size_of_the_error_in_float32():
    scenario, times = Scenario(target=AccelerationTarget()), [100, 200, 300, 500, 1000]
    wrong = errors_in_float32(scenario, times, False)
    problem = in_precision(False, scenario, False)
    for unseen, error in zip(times, wrong, strict=True):
        estimate, when = rounding_error(problem, unseen)
        assert when == unseen, "the longest is the worst"
        if estimate < 1.0:
            assert 0.02 * estimate < error < 5 * estimate
        else:
            assert np.isnan(error) or error > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("jerk", [0.1, 1e-3, 0.0])
def test_reversible_motion_keeps_digits_within_the_estimate(jerk):
    """Accelerations without noise are the worst: after 300 steps unseen no float32 resolves them."""
    scenario, times = Scenario(target=AccelerationTarget(jerk_m2_s5=jerk)), [10, 100, 300, 1000]
    wrong = errors_in_float32(scenario, times, True)
    estimates = [rounding_error(in_precision(False, scenario), unseen)[0] for unseen in times]
    assert (wrong < np.array(estimates) + 1e-4).all()
    assert np.isinf(estimates[-1]) == (jerk == 0.0)


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.parametrize("target", [DriftTarget(), VelocityTarget(), VelocityTarget(memory_s=10.0)])
def test_other_targets_keep_their_digits_for_ten_thousand_steps(target, caplog):
    scenario = Scenario(target=target)
    warn_of_rounding(in_precision(False, scenario), 10_000)
    assert not caplog.records
    assert errors_in_float32(scenario, [10_000], scenario.problem().motion.is_reversible).max() < 0.05


def test_presets_keep_their_digits():
    for name, experiment in PRESETS.items():
        problem, horizon = in_precision(False, experiment.scenario), experiment.scenario.scenes.horizon(8)
        assert rounding_error(problem, horizon)[0] < 0.01, name


@pytest.mark.parametrize(("steps", "said"), [(60, ""), (200, "off by some 0.3 nat"), (2000, "wrong or not finite")])
def test_one_line_says_it_and_what_to_do(steps, said, caplog):
    problem = in_precision(False, Scenario(target=AccelerationTarget()), False)
    with caplog.at_level(logging.WARNING, "foveate"):
        warn_of_rounding(problem, steps)
    assert bool(caplog.records) == bool(said)
    for record in caplog.records:
        assert said in record.message
        assert "float32" in record.message
        assert "JAX_ENABLE_X64=1" in record.message
        assert f"unseen for {steps} steps" in record.message


def test_float64_has_enough():
    assert rounding_error(in_precision(True, Scenario(target=AccelerationTarget())), 2000)[0] < 1e-5


RANGE, BEARING, ELEVATION = {"std_range_m": 0.3}, {"std_bearing_rad": 0.05}, {"std_elevation_rad": 0.05}


@pytest.mark.parametrize(
    ("measures", "stds", "preset"),
    [
        ("range-bearing", RANGE | BEARING, "paper"),
        ("bearing", BEARING, "paper"),
        ("range", RANGE, "paper"),
        ("range", RANGE, "quadrotor"),
        ("azimuth-elevation-range", RANGE | BEARING | ELEVATION, "quadrotor"),
        ("azimuth-elevation", BEARING | ELEVATION, "quadrotor"),
    ],
)
def test_every_sensor_has_an_estimate(measures, stds, preset):
    scenario = PRESETS[preset].scenario
    scenes = replace(scenario.scenes, initial_error="consistent")
    scenario = replace(scenario, sensor=SensorSettings(measures=measures, **stds), scenes=scenes)
    assert 0 < rounding_error(in_precision(False, scenario), 100)[0] < 0.01


def test_a_sensor_of_range_and_bearing_counts_as_one_of_positions_in_mid_view():
    """The paper's view is 2 m deep: at 1 m a bearing's error of 0.05 rad is one of 0.05 m to the side."""
    scenario = Scenario(target=AccelerationTarget(jerk_m2_s5=1e-3))
    polar = replace(
        scenario,
        sensor=SensorSettings(measures="range-bearing", std_range_m=0.3, std_bearing_rad=0.05),
        scenes=replace(scenario.scenes, initial_error="consistent"),
    )
    position = replace(scenario, sensor=SensorSettings(V=((0.09, 0.0), (0.0, 0.0025))))
    found, expected = (rounding_error(in_precision(False, each), 500)[0] for each in (polar, position))
    assert found == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("steps", [1, 2, 3, 7, 12, 100])
def test_times_of_a_schedule_are_those_step_by_step(steps):
    """The covariance after whole periods, by squaring, is that of the steps one after the other."""
    rng = np.random.default_rng(0)
    motions = [_Motion(np.eye(2) + 0.1 * rng.normal(size=(2, 2)), (k + 1) * np.eye(2)) for k in range(3)]
    expected, covariance = {}, np.eye(2)
    for k in range(steps):
        A, W = motions[k % 3]
        covariance = expected[k + 1] = A @ covariance @ A.T + W
    found = list(_unseen(np.eye(2), motions, steps))
    assert {k for k, _ in found} >= {min(steps, 3), steps // 3 * 3 or steps}
    for k, value in found:
        np.testing.assert_allclose(value, expected[k], rtol=1e-9)


def test_an_ill_conditioned_system_is_told_in_float64_too():
    """The chain of six integrators, far from a detection of the first: no float64 resolves the last."""

    def rows(array):
        return tuple(map(tuple, array.tolist()))

    A, B, Z = np.eye(6) + np.eye(6, k=1), np.zeros((6, 2)), np.eye(2, 6)
    target = LinearTarget(A=rows(A), B=rows(B), W=rows(1e-6 * np.eye(6)), Z=rows(Z), prior=rows(np.eye(6)))
    scenario = Scenario(target=target)
    assert rounding_error(in_precision(True, scenario), 10_000)[0] > 0.05


SLOW_GROWTH = VelocityTarget(kind="constant_velocity", acceleration_m2_s3=1e-3)
FORGETFUL = replace(SLOW_GROWTH, memory_s=10.0)
QUICK = quick_compilation() | {"xla_backend_optimization_level": 1}


def test_what_is_compiled_quickly():
    for target, expected in ((DriftTarget(), True), (SLOW_GROWTH, True), (replace(FORGETFUL, memory_s=0.5), False)):
        assert rounds_alike(Scenario(tau_s=1.0, target=target).problem()) == expected


@pytest.mark.parametrize("target", [DriftTarget(), SLOW_GROWTH, FORGETFUL])
def test_beliefs_are_predicted_rightly_with_the_options_of_their_compilation(target):
    """In float32, whitened by the exact covariance: targets that were measured once, 0 to 20 s ago."""
    problem, rng = Scenario(tau_s=0.5, target=target).problem(), np.random.default_rng(0)
    options, n_y = QUICK if rounds_alike(problem) else {}, problem.motion.state_size
    informations = []
    for _ in range(500):
        t, speed, place = rng.uniform(0, 20), 10 ** rng.uniform(-1, 1.5), 10 ** rng.uniform(-3, 0)
        moved = [[place + speed * t**2, speed * t], [speed * t, speed]]
        grown = 1e-3 * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
        covariance = np.kron(moved + grown, np.eye(2))[:n_y, :n_y]
        turn = np.eye(n_y) + 0.02 * rng.normal(size=(n_y, n_y))
        informations.append(np.linalg.inv(turn @ covariance @ turn.T))
    single = np.array(informations, np.float32)
    A, W = np.asarray(problem.motion.A, np.float32), np.asarray(problem.motion.W, np.float32)
    exact = A.astype(float) @ np.linalg.inv(single.astype(float)) @ A.T.astype(float) + W
    motion = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), problem.motion)
    found = jax.jit(jax.vmap(lambda Y: predict_information(Y, motion)), compiler_options=options)(single)
    root = np.linalg.cholesky(exact)
    whitened = root.swapaxes(-1, -2) @ np.asarray(found, float) @ root
    assert np.abs(np.linalg.eigvalsh(whitened) - 1.0).max() < 0.02


@pytest.mark.parametrize("target", [SLOW_GROWTH, FORGETFUL])
def test_beliefs_measured_at_random_stay_right_in_float32(target):
    """Within 0.1 nat for 200 steps, from velocities that are unknown by 5.5 m/s, with a sensor of range and bearing.

    Without W a target measured once from 0.3 m has position and velocity correlated to more digits than float32 has.
    """
    target = replace(target, initial_variance_m2=30.0, initial_velocity_variance_m2_s2=30.0)
    rng, targets = np.random.default_rng(0), 300
    ahead = rng.normal(size=(targets, 2))
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True)
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
    lateral_std = 0.01 * rng.uniform(0.3, 10.0, (targets, 1, 1))
    gain = np.zeros((targets, 4, 4))
    gain[:, :2, :2] = ahead[:, :, None] * ahead[:, None] / 0.2**2 + aside[:, :, None] * aside[:, None] / lateral_std**2
    seen = rng.random((200, targets)) < rng.choice([0.01, 0.05, 0.3], targets)

    def log_dets_of(x64, options):
        with jax.enable_x64(x64):
            problem = Scenario(tau_s=0.5, target=target).problem()
            assert rounds_alike(problem)

            def step(information, given):
                ahead = jax.vmap(predict_information, (0, None))(information, problem.motion)
                return ahead + given[:, None, None] * jnp.asarray(gain, float), log_det_spd(ahead)

            first = jnp.broadcast_to(problem.prior_information, (targets, 4, 4))
            run = jax.jit(lambda given: jax.lax.scan(step, first, given)[1], compiler_options=options)
            return np.asarray(run(jnp.asarray(seen, float)))

    exact = log_dets_of(True, {})
    for options in ({}, QUICK):
        np.testing.assert_allclose(log_dets_of(False, options), exact, atol=0.1)


def near_and_far(rng):
    """H and V of a range and a bearing taken at 0.05 to 10 m in a random direction, errors of 0.2 m and 0.02 rad."""
    angle, r = rng.uniform(0, 2 * np.pi), 10 ** rng.uniform(-1.3, 1)
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s, 0, 0], [-s / r, c / r, 0, 0]]), np.diag([0.2**2, 0.02**2])


def fine(rng):
    """H and V of a position with errors of 2 mm, as of a motion capture."""
    return np.eye(2, 4), 0.002**2 * np.eye(2)


@pytest.mark.parametrize(
    ("sensor", "acceleration_m2_s3", "measurement"),
    [
        (SensorSettings(measures="range-bearing", std_range_m=0.2, std_bearing_rad=0.02), 0.02, near_and_far),
        (SensorSettings(std_m=0.002), 0.3, fine),
    ],
)
def test_a_prediction_keeps_its_digits_after_measurements_much_finer_than_the_motions_noise(
    sensor, acceleration_m2_s3, measurement
):
    """2,000 beliefs about a target that was unseen for up to 40 steps, and then measured."""
    target = VelocityTarget(acceleration_m2_s3=acceleration_m2_s3)
    scenario = Scenario(sensor=sensor, target=target, scenes=SceneSettings(initial_error="consistent"))
    motion = in_precision(False, scenario, None).motion
    A, W, rng, beliefs = np.asarray(motion.A, float), np.asarray(motion.W, float), np.random.default_rng(0), []
    for _ in range(2_000):
        covariance = np.diag([2.0, 2.0, 1.0, 1.0])
        for _ in range(rng.integers(40)):
            covariance = A @ covariance @ A.T + W
        H, V = measurement(rng)
        beliefs.append(np.linalg.inv(covariance) + H.T @ np.linalg.inv(V) @ H)
    exact = -np.linalg.slogdet(A @ np.linalg.inv(beliefs) @ A.T + W)[1]
    with jax.enable_x64(False):
        predict = jax.jit(jax.vmap(lambda information: predict_information(information, motion)))
        found = np.asarray(predict(jnp.asarray(beliefs)), float)
    sign, log_det = np.linalg.slogdet(found)
    assert (sign > 0).all()
    assert np.abs(log_det - exact).max() < 0.05


@pytest.mark.parametrize(("acceleration_m2_s3", "keep_off_m"), [(0.001, 1.0), (1.0, 1.0), (0.001, None)])
def test_bearings_are_predicted_as_keeps_their_digits(acceleration_m2_s3, keep_off_m):
    """Of the sensor of scalableMARL's worlds, from 1 to 10 m: by reversal, unless the motion's noise is far greater.

    A robot that does not keep off comes as near as 3 cm, and has two inverses. The other way loses more, or all.
    """
    target = VelocityTarget(
        acceleration_m2_s3=acceleration_m2_s3, initial_variance_m2=30.0, initial_velocity_variance_m2_s2=30.0
    )
    sensor = SensorSettings(measures="range-bearing", std_range_m=0.2, std_bearing_rad=0.01)
    scenes = SceneSettings(initial_error="consistent")
    world = Scenario(tau_s=0.5, view=SectorView(), sensor=sensor, target=target, scenes=scenes)
    scenario = replace(world, keep_off_m=keep_off_m)
    # Where reversal is chosen, a program may compute a number several times, and round it otherwise each time.
    options = {} if keep_off_m is None else QUICK
    chosen = scenario.problem().motion.is_reversible
    assert chosen == (acceleration_m2_s3 == 0.001 and keep_off_m is not None)
    rng, targets = np.random.default_rng(1), 300
    nearest = -1.5 if keep_off_m is None else 0.0
    angle, r = rng.uniform(0, 2 * np.pi, targets), 10 ** rng.uniform(nearest, 1, targets)
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros(targets)
    H = np.moveaxis(np.array([[c, s, zero, zero], [-s / r, c / r, zero, zero]]), -1, 0)
    gains = np.swapaxes(H, 1, 2) @ np.diag([0.2**-2, 0.01**-2]) @ H

    def log_dets(x64, reversible):
        problem = in_precision(x64, scenario, reversible)
        with jax.enable_x64(x64):

            def step(information, _):
                ahead = predict_information(information, problem.motion)
                return ahead, log_det_spd(ahead)

            def unseen(gain):
                seen = predict_information(problem.prior_information, problem.motion) + gain
                return jax.lax.scan(step, seen, length=60)[1]

            run = jax.jit(jax.vmap(unseen), compiler_options=options)
            return np.asarray(run(jnp.asarray(gains, float)), float)

    exact = log_dets(True, False)
    error = {way: np.abs(log_dets(False, way) - exact).max() for way in (True, False)}
    assert error[chosen] < (0.05 if keep_off_m else 0.5)
    assert not error[not chosen] < 2 * error[chosen]
