"""Fit of motion to recordings: made-up data with known answers, and the table of the sample recordings."""

from pathlib import Path

import numpy as np
import pytest
from helpers.recordings import recording, track, walk

from foveate.recordings.formats import load_recording
from foveate.recordings.motion import MotionStatistics, default_max_gap_s, fit_statistics, median_fix_interval_s
from foveate.recordings.recording import resample

TRACKS = Path(__file__).resolve().parents[2] / ".." / "shared" / "tracks"


def assert_close_to(estimate, truth, relative):
    assert np.abs(estimate - truth).max() <= relative * np.trace(truth)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("clock", ["regular", "fast", "irregular"])
def test_walk_covariance_of_a_random_walk(dimension, clock):
    rng = np.random.default_rng(3)
    per_s = np.array([[0.5, 0.2, 0.0], [0.2, 0.3, -0.1], [0.0, -0.1, 0.4]])[:dimension, :dimension]
    clocks = {
        "regular": 0.5 * np.arange(1001),
        "fast": 0.1 * np.arange(5001),
        "irregular": np.sort(rng.uniform(0, 500.0, 2500)),
    }
    tracks = [track(clocks[clock], walk(rng, clocks[clock], per_s), str(i)) for i in range(12)]
    fit = fit_statistics(recording(*tracks), 0.5, max_gap_s=10.0)
    # 12 x 1000 independent steps: a relative error of sqrt(2 / 12000) = 1.3 % for a variance.
    assert_close_to(fit.walk_covariance_m2, 0.5 * per_s, 0.04)
    assert fit.persistence == pytest.approx(0.0, abs=0.04)
    assert fit.spikes == 0
    assert fit.trimmed_fraction < 1e-3


def test_slow_clocks_are_scaled_by_the_persistence_of_motion():
    rng = np.random.default_rng(4)
    times = 20.0 * np.arange(400)  # ships: one fix in 20 s, control every 0.5 s
    course = np.array([6.0, 8.0])
    straight = recording(track(times, times[:, None] * course))
    fit = fit_statistics(straight, 0.5)
    assert fit.max_gap_s == default_max_gap_s(straight) == 60.0
    assert fit.fix_interval_s == 20.0
    assert fit.speed_median_m_s == pytest.approx(10.0)
    assert fit.persistence == pytest.approx(1.0)
    np.testing.assert_allclose(course @ fit.walk_covariance_m2 @ course / 100.0, (10.0 * 0.5) ** 2, rtol=1e-3)
    tracks = [track(times, walk(rng, times, np.eye(2)), str(i)) for i in range(10)]
    wandering = fit_statistics(recording(*tracks), 0.5)
    assert_close_to(wandering.walk_covariance_m2, 0.5 * np.eye(2), 0.1)  # interpolation would give 0.0125
    with pytest.raises(ValueError, match="the median fix interval is 20 s: choose max_gap_s above it"):
        fit_statistics(straight, 0.5, max_gap_s=2.0)


def test_constant_velocity_is_persistent_and_hardly_accelerates():
    times = 0.1 * np.arange(300)
    fit = fit_statistics(recording(track(times, times[:, None] * [1.2, -0.9])), 0.5)
    assert fit.speed_median_m_s == pytest.approx(1.5)
    assert fit.speed_p95_m_s == pytest.approx(1.5)
    assert fit.persistence == pytest.approx(1.0)
    assert fit.acceleration_intensity is not None
    assert np.linalg.eigvalsh(fit.acceleration_intensity).max() == pytest.approx(1e-6)  # the floor
    values = np.linalg.eigvalsh(fit.walk_covariance_m2)
    np.testing.assert_allclose(values, [0.75**2 * 1e-4, 0.75**2])  # one straight line, yet definite
    np.testing.assert_array_equal(fit.walk_covariance_m2, fit.walk_covariance_m2.T)


@pytest.mark.parametrize("clock", ["regular", "irregular"])
def test_acceleration_intensity_of_integrated_white_noise_with_noisy_fixes(clock):
    rng = np.random.default_rng(5)
    q = np.array([[0.4, 0.1], [0.1, 0.2]])
    dense = 0.02 * np.arange(50_001)
    tracks, noisy = [], []
    for i in range(8):
        velocity = walk(rng, dense, q, start=3.0 * rng.standard_normal(2))
        position = np.cumsum(velocity * 0.02, axis=0)
        stride = np.unique(np.concatenate([np.arange(0, 50_001, 25), rng.integers(0, 50_001, 1000)]))
        kept = np.arange(0, 50_001, 25) if clock == "regular" else stride
        tracks.append(track(dense[kept], position[kept], str(i)))
        noise = 0.1 * rng.standard_normal((len(kept), 2))
        noisy.append(track(dense[kept], position[kept] + noise, str(i)))
    fit = fit_statistics(recording(*tracks), 0.5)
    assert_close_to(fit.acceleration_intensity, q, 0.05)
    if clock == "regular":
        assert fit.fix_noise_std_m == pytest.approx(0.0, abs=0.03)
        freed = fit_statistics(recording(*noisy), 0.5)  # at one spacing it would be 0.72 on each axis more
        assert_close_to(freed.acceleration_intensity, q, 0.1)
        assert freed.fix_noise_std_m == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize("noise_m", [0.02, 0.05, 0.2])
@pytest.mark.parametrize("tau_s", [0.1, 0.5])
def test_noise_of_fixes_is_not_taken_for_motion(noise_m, tau_s):
    """Walkers at 10 Hz with a memory of 10 s: simulated exactly, by the transition of an Ornstein-Uhlenbeck process."""
    rng, q, memory_s, dt = np.random.default_rng(11), 0.2, 10.0, 0.1
    times, tracks = dt * np.arange(600), []
    decay = np.exp(-dt / memory_s)
    for i in range(60):
        v, positions = rng.normal(0, np.sqrt(q * memory_s / 2), 2), [np.zeros(2)]
        for _ in times[1:]:
            before, v = v, decay * v + rng.normal(0, np.sqrt(q * memory_s / 2 * (1 - decay**2)), 2)
            positions.append(positions[-1] + 0.5 * dt * (before + v))
        tracks.append(track(times, np.array(positions) + rng.normal(0, noise_m, (len(times), 2)), str(i)))
    fit = fit_statistics(recording(*tracks), tau_s)
    assert_close_to(fit.acceleration_intensity, q * np.eye(2), 0.12)
    assert fit.fix_noise_std_m == pytest.approx(noise_m, abs=0.02)


@pytest.mark.parametrize("share", [0.002, 0.02])
def test_outliers_do_not_dominate(share):
    rng = np.random.default_rng(6)
    times = 0.1 * np.arange(3001)
    tracks = []
    for i in range(6):
        positions = walk(rng, times, 0.2 * np.eye(2))
        wild = rng.random(3001) < share
        positions[wild] += 100.0 * rng.standard_normal((wild.sum(), 2))
        tracks.append(track(times, positions, str(i)))
    fit = fit_statistics(recording(*tracks), 0.5)
    assert_close_to(fit.walk_covariance_m2, 0.1 * np.eye(2), 0.1)
    assert fit.spikes > 0.7 * share * 6 * 3001
    assert np.abs([fit.extent_lower_m, fit.extent_upper_m]).max() > 100.0
    assert np.abs([fit.robust_lower_m, fit.robust_upper_m]).max() < 40.0


def test_a_step_that_is_no_spike_is_trimmed():
    rng = np.random.default_rng(7)
    times = 0.5 * np.arange(2001)
    positions = walk(rng, times, 0.2 * np.eye(2))
    positions[700:703] += 100.0  # three wrong fixes in a row
    made = recording(track(times, positions))
    for limit in (None, np.inf):  # cut at jumps, or only left out of the moments
        fit = fit_statistics(made, 0.5, max_speed_m_s=limit)
        assert_close_to(fit.walk_covariance_m2, 0.1 * np.eye(2), 0.1)
        assert fit.spikes == 0
        assert fit.trimmed_fraction == pytest.approx(0 if limit is None else 2 / 2000)


def test_animals_that_stop_for_minutes_keep_their_motion():
    times = np.arange(0.0, 4000.0)
    moving = (times % 400) < 40
    path = np.cumsum(np.where(moving, 2.0, 0.0))
    fit = fit_statistics(recording(track(times, np.stack([path, 0.0 * path], axis=1))), 1.0)
    assert fit.spikes == 0
    assert fit.trimmed_fraction == 0.0
    assert fit.speed_median_m_s == 0.0
    assert fit.speed_p95_m_s == pytest.approx(2.0)
    assert fit.walk_covariance_m2[0, 0] == pytest.approx(0.1 * 2.0**2, rel=0.02)


def test_counts_lives_and_gaps():
    made = recording(
        track(np.arange(0.0, 10.5, 0.5), np.zeros((21, 2)), "a"),
        track(np.arange(5.0, 8.5, 0.5), np.ones((7, 2)), "b"),
        track(np.arange(30.0, 34.5, 0.5), np.ones((9, 2)), "c"),
    )
    fit = fit_statistics(made, 0.5, 2.0)
    assert (fit.tracks, fit.span_s, fit.fix_interval_s) == (3, 34.0, 0.5)
    assert (fit.at_once_min, fit.at_once_median, fit.at_once_max) == (1, 1.0, 2)
    assert fit.at_once_p95 == np.percentile([1] * 14 + [2] * 7 + [1] * 9, 95)
    assert fit.occupied_fraction == pytest.approx(30 / 69)
    assert (fit.lifetime_s, fit.lifetime_steps) == (4.0, 8)
    assert fit.persistence == 0.0  # nothing moves
    np.testing.assert_allclose(fit.walk_covariance_m2, 1e-6 * np.eye(2))  # definite all the same


def test_no_motion_without_two_fixes_and_no_turn_without_three():
    with pytest.raises(ValueError, match="no track has two fixes"):
        median_fix_interval_s(recording(track([0.0], [[0, 0]]), track([1.0], [[0, 0]], "b")))
    fit = fit_statistics(recording(track([0.0, 0.5], [[0, 0], [1, 0]])), 0.5)
    assert fit.persistence is None
    assert fit.acceleration_intensity is None
    assert fit.walk_covariance_m2[0, 0] == pytest.approx(1.0)


# Real recordings: the table of SOURCES.md


@pytest.mark.parametrize(
    ("name", "tracks", "span_s", "median_m_s", "p95_m_s", "at_once", "at_most", "extent_m"),
    [
        ("ped_sind_chongqing", 40, 1120, 1.1, 1.7, 2, 5, (58, 72)),
        ("ped_ucy_zara01", 148, 360, 1.2, 1.6, 5, 20, (14, 16)),
        ("drones3d_uzh_fpv", 6, 67, 4.6, 9.5, 2, 6, (22, 16, 3.5)),
    ],
)
def test_real_recordings_match_their_description(name, tracks, span_s, median_m_s, p95_m_s, at_once, at_most, extent_m):
    path = TRACKS / f"{name}.csv"
    if not path.exists():
        pytest.skip(f"the sample recordings are not here: {path}")
    real = load_recording(path)
    fit = fit_statistics(real, 0.5)
    assert isinstance(fit, MotionStatistics)
    assert fit.tracks == tracks
    assert fit.span_s == pytest.approx(span_s, abs=0.5)
    assert fit.speed_median_m_s == pytest.approx(median_m_s, abs=0.05)
    assert fit.speed_p95_m_s == pytest.approx(p95_m_s, rel=0.06)
    assert (fit.at_once_median, fit.at_once_max) == (at_once, at_most)
    lower, upper = real.extent
    np.testing.assert_allclose(upper - lower, extent_m, atol=0.6)
    packed = resample(real, 0.5)
    assert at_most <= packed.present.shape[1] <= at_most + 2
