"""Recordings: reading, cutting, sampling, packing, and the fit of motion; made-up data with known answers."""

from pathlib import Path

import numpy as np
import pytest

from foveate.recordings.formats import load_recording
from foveate.recordings.motion import MotionStatistics, default_max_gap_s, fit_statistics, median_fix_interval_s
from foveate.recordings.recording import MAX_CELLS, Recording, Track, resample, window

HEADER = "time_s,track_id,x_m,y_m\n"
TRACKS = Path(__file__).resolve().parents[2] / ".." / "shared" / "tracks"


def track(times, positions, track_id="a") -> Track:
    return Track(track_id=track_id, times_s=np.asarray(times, float), positions_m=np.asarray(positions, float))


def recording(*tracks: Track) -> Recording:
    return Recording(name="made up", dimension=tracks[0].positions_m.shape[1], tracks=tracks)


def walk(rng, times, covariance_per_s, start: float | np.ndarray = 0.0) -> np.ndarray:
    """A random walk whose displacement over dt has covariance dt * covariance_per_s."""
    root = np.linalg.cholesky(covariance_per_s)
    steps = rng.standard_normal((len(times) - 1, len(root))) @ root.T * np.sqrt(np.diff(times))[:, None]
    return start + np.concatenate([np.zeros((1, len(root))), np.cumsum(steps, axis=0)])


def write(tmp_path, content: str | bytes) -> Path:
    path = tmp_path / "recording.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


# Reading


def test_reads_planar_and_spatial_files(tmp_path):
    path = write(tmp_path, "\ufeff" + HEADER + '0.0,07,1,2\r\n0.5,7,-1e1,4\r\n\r\n1.0, 07 ,3,4\r\n1.0,"a,b",0,0\r\n')
    planar = load_recording(path)
    assert planar.dimension == 2
    assert planar.name == str(path)
    assert [t.track_id for t in planar.tracks] == ["07", "7", "a,b"]
    np.testing.assert_array_equal(planar.tracks[0].times_s, [0.0, 1.0])
    np.testing.assert_array_equal(planar.tracks[0].positions_m, [[1.0, 2.0], [3.0, 4.0]])
    np.testing.assert_array_equal(planar.tracks[1].positions_m, [[-10.0, 4.0]])
    assert (planar.start_s, planar.end_s) == (0.0, 1.0)
    np.testing.assert_array_equal(planar.extent, [[-10.0, 0.0], [3.0, 4.0]])

    spatial = load_recording(write(tmp_path, "time_s,track_id,x_m,y_m,z_m\n-3,drone 1,1,2,3"))
    assert spatial.dimension == 3
    np.testing.assert_array_equal(spatial.tracks[0].positions_m, [[1.0, 2.0, 3.0]])


GOOD = HEADER + "0.0,1,0,0\n"
RIGHT_HEADER = "the header must be time_s,track_id,x_m,y_m or time_s,track_id,x_m,y_m,z_m"


@pytest.mark.parametrize(
    ("content", "line", "value", "expected"),
    [
        ("", 1, "the file is empty", RIGHT_HEADER),
        ("\n" + GOOD, 1, "'time_s' is missing", RIGHT_HEADER),
        ("0.0,1,0,0\n", 1, "'0.0'", RIGHT_HEADER),
        ("time_s,track_id,x_m\n0,1,0\n", 1, "'y_m' is missing", RIGHT_HEADER),
        ("time_s,track_id,x_m,y_m,speed\n", 1, "'speed'", RIGHT_HEADER),
        ("time_s,track_id,x_m,y_m,y_m\n", 1, "'y_m'", RIGHT_HEADER),
        ("track_id,time_s,x_m,y_m\n", 1, "track_id,time_s,x_m,y_m", RIGHT_HEADER),
        ("q" * 500 + "\n", 1, "'qqqq", RIGHT_HEADER),
        (HEADER, 2, "no rows", "at least one row must follow the header"),
        (HEADER + "\n\n", 4, "no rows", "at least one row must follow the header"),
        (GOOD + "0.1,1,0\n", 3, "3 fields", "there must be 4: time_s,track_id,x_m,y_m"),
        (GOOD + "\n0.1,1,0,0,0\n", 4, "5 fields", "there must be 4: time_s,track_id,x_m,y_m"),
        (GOOD + "0.1,1,zero,0\n", 3, "x_m is 'zero'", "finite number of metres"),
        (GOOD + "0.1,1,0,\n", 3, "y_m is ''", "finite number of metres"),
        (GOOD + "now,1,0,0\n", 3, "time_s is 'now'", "finite number of seconds"),
        (GOOD + "1_0,1,0,0\n", 3, "time_s is '1_0'", "finite number of seconds"),
        (GOOD + "nan,1,0,0\n", 3, "time_s is 'nan'", "finite number of seconds"),
        (GOOD + "0.1,1,0,-inf\n", 3, "y_m is '-inf'", "finite number of metres"),
        (GOOD + "0.1,1,1e13,0\n", 3, "x_m is '1e13'", "at most 1e+12"),
        (GOOD + "0.1,1," + "7" * 400 + ",0\n", 3, "x_m is '777", "at most 1e+12"),
        (GOOD + "0.1, ,0,0\n", 3, "track_id is ''", "name or number"),
        (GOOD + '0.1,"a\nb",0,0\n', 3, "track_id is 'a\\nb'", "printable characters"),
        (GOOD + "0.1,a\0b,0,0\n", 3, "track_id is 'a\\x00b'", "printable characters"),
        (GOOD + '0.1,"a,0,0\n', 3, "unexpected end of data", "plain comma-separated text"),
        (GOOD + '0.1,"a' + "\nb" * 100_000, 3, "field limit", "plain comma-separated text"),
        (GOOD + "-0.1,1,0,0\n", 3, "-0.1 comes after 0.0", "sorted by time"),
        (GOOD + "0.0,2,0,0\n0,1,1,1\n", 4, "'1' has two rows at time_s 0.0", "one row for each"),
        (GOOD + "0.1," + "i" * 5000 + ",0,0\n", 3, "4096 bytes", "a time, a track id and a position"),
        (GOOD.encode() + b"0.1,caf\xe9,0,0\n", 3, "byte b'\\xe9' is not UTF-8", "save the file as UTF-8"),
        (
            (HEADER + "0.0,1,0,0\n").encode("utf-16"),
            1,
            "byte b'\\xff' is not UTF-8",
            "save the file as UTF-8",
        ),
    ],
)
def test_bad_files_are_told_in_one_line(tmp_path, content, line, value, expected):
    path = write(tmp_path, content)
    with pytest.raises(ValueError, match=r": line \d+: ") as caught:
        load_recording(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: line {line}: ")
    assert value in message
    assert expected in message
    assert "\n" not in message
    assert len(message) < 400 + len(str(path))


def test_bad_paths_are_told_in_one_line(tmp_path):
    with pytest.raises(ValueError, match=r"^.*nowhere\.csv: no such file; give the path of a recording"):
        load_recording(tmp_path / "nowhere.csv")
    with pytest.raises(ValueError, match=r"^.*: is a directory; give the path of a recording"):
        load_recording(tmp_path)
    path = write(tmp_path, GOOD)
    with pytest.raises(ValueError, match=r"^.*: cannot be read: Not a directory"):
        load_recording(path / "inside")


# Cutting


def test_window_keeps_the_fixes_inside_and_drops_empty_tracks():
    whole = recording(track([0, 1, 2, 3], np.arange(8).reshape(4, 2)), track([0, 0.5], np.zeros((2, 2)), "early"))
    cut = window(whole, 1.0, 2.5)
    assert [t.track_id for t in cut.tracks] == ["a"]
    np.testing.assert_array_equal(cut.tracks[0].times_s, [1.0, 2.0])
    np.testing.assert_array_equal(cut.tracks[0].positions_m, [[2.0, 3.0], [4.0, 5.0]])
    assert window(whole).end_s == 3.0
    assert window(whole, end_s=0.0).end_s == 0.0
    for start_s, end_s in ((4.0, None), (2.0, 1.0), (1.2, 1.8), (float("nan"), None)):
        with pytest.raises(ValueError, match="the recording spans 0 s to 3 s"):
            window(whole, start_s, end_s)


# Sampling


def test_interpolation_agrees_with_numpy_on_irregular_clocks():
    rng = np.random.default_rng(1)
    tracks = []
    for i in range(5):
        times = 1.7e9 + np.sort(rng.uniform(0.0, 60.0, 80))
        tracks.append(track(times, rng.normal(size=(80, 3)), str(i)))
    sampled = resample(recording(*tracks), 0.37, max_gap_s=100.0)
    start, end = min(t.times_s[0] for t in tracks), max(t.times_s[-1] for t in tracks)
    np.testing.assert_array_equal(sampled.times_s, start + 0.37 * np.arange(int((end - start) / 0.37) + 1))
    assert sampled.track_ids == ("0", "1", "2", "3", "4")
    for i, t in enumerate(tracks):
        inside = (sampled.times_s >= t.times_s[0]) & (sampled.times_s <= t.times_s[-1])
        rows, columns = np.nonzero(sampled.track_index == i)
        np.testing.assert_array_equal(rows, np.flatnonzero(inside))
        for axis in range(3):
            expected = np.interp(sampled.times_s[inside], t.times_s, t.positions_m[:, axis])
            np.testing.assert_allclose(sampled.positions_m[rows, columns, axis], expected, atol=1e-12)


def test_a_long_gap_is_absent_and_holds_the_nearest_fix():
    gappy = track([0, 1, 3, 6, 7], [[0, 0], [1, 0], [3, 0], [6, 0], [7, 0]])
    sampled = resample(recording(gappy, track([0, 9], [[5, 5], [5, 5]], "b")), 0.5, max_gap_s=2.0)
    t = sampled.times_s
    absent = ((t > 3) & (t < 6)) | (t > 7)  # the gap of 2 s is bridged, the one of 3 s is not
    np.testing.assert_array_equal(sampled.present[:, 0], ~absent)
    expected = np.where((t > 3) & (t <= 4.5), 3.0, np.where((t > 4.5) & (t < 6), 6.0, np.minimum(t, 7.0)))
    away = t != 4.5  # both fixes are equally near there
    np.testing.assert_allclose(sampled.positions_m[away, 0, 0], expected[away], atol=1e-12)
    np.testing.assert_array_equal(np.flatnonzero(sampled.present[:, 1]), [0, 18])


def test_instants_are_not_lost_to_rounding():
    clock = np.round(np.arange(0, 1201) * 0.1, 3)
    for offset in (0.0, 1.7e9):
        sampled = resample(recording(track(offset + clock, np.zeros((1201, 2)))), 0.3, max_gap_s=0.05)
        assert len(sampled.times_s) == 401
        assert sampled.present.all()  # every instant is a fix, whatever 3 * 0.1 is


def test_single_fixes_are_present_only_where_they_coincide():
    carrier = track([0, 4], [[0, 0], [4, 0]])
    hit, miss = track([2.0], [[9, 9]], "hit"), track([2.2], [[8, 8]], "miss")
    sampled = resample(recording(carrier, miss, hit), 0.5, max_gap_s=5.0)
    assert sampled.track_ids == ("a", "hit")
    assert sampled.dropped == 1
    np.testing.assert_array_equal(np.flatnonzero(sampled.present[:, 1]), [4])
    np.testing.assert_array_equal(sampled.positions_m[:, 1], np.full((9, 2), 9.0))


def test_sampling_refuses_what_makes_no_sense():
    short = recording(track([0.0, 1.0], np.zeros((2, 2))))
    for tau_s in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match=r"^tau_s is .*; it must be a positive, finite number of seconds$"):
            resample(short, tau_s)
    for max_gap_s in (0.0, float("nan")):
        with pytest.raises(ValueError, match=r"^max_gap_s is .*; it must be a positive"):
            resample(short, 0.5, max_gap_s)
    with pytest.raises(ValueError, match=r"spans 1 s; it must span one step of 1.5 s at least"):
        resample(short, 1.5)
    with pytest.raises(ValueError, match=f"at most {MAX_CELLS} in all .* wrong times"):
        resample(recording(track([0.0, 1.7e9], np.zeros((2, 2)))), 0.5)


# Packing


def random_lives(rng, n) -> Recording:
    tracks = []
    for i in range(n):
        first = rng.integers(0, 60)
        times = np.arange(first, first + rng.integers(1, 25))
        kept = np.ones(len(times), bool)
        kept[1:-1] = rng.random(max(len(times) - 2, 0)) > 0.6  # inner gaps
        tracks.append(track(times[kept], rng.normal(size=(kept.sum(), 2)), f"id {i}"))
    return recording(*tracks)


@pytest.mark.parametrize("seed", range(8))
def test_columns_are_as_few_as_the_rule_allows(seed):
    made = random_lives(np.random.default_rng(seed), 40)
    packed = resample(made, 1.0, max_gap_s=1.5)
    # Fixes are at whole seconds, and no gap is bridged: a track is present where it has a fix.
    fixes = [(t.times_s - made.start_s).astype(int) for t in made.tracks]
    lives = [instants[[0, -1]] for instants in fixes]
    # A column is free again two instants after a life's last one: count lives that are one longer.
    needed = max(sum(a <= k <= b + 1 for a, b in lives) for k in range(len(packed.times_s)))
    assert packed.present.shape == (len(packed.times_s), needed)
    assert (packed.track_ids, packed.dropped) == (tuple(t.track_id for t in made.tracks), 0)
    np.testing.assert_array_equal(packed.present, packed.track_index >= 0)
    assert np.isfinite(packed.positions_m).all()
    for i, (first, last) in enumerate(lives):
        rows, columns = np.nonzero(packed.track_index == i)
        np.testing.assert_array_equal(rows, fixes[i])
        assert len(set(columns)) == 1
        np.testing.assert_array_equal(packed.positions_m[rows, columns], made.tracks[i].positions_m)
        column = packed.track_index[:, columns[0]]
        assert set(column[first : last + 1]) <= {i, -1}  # nobody moves in during an inner gap
        assert (column[max(first - 1, 0) : first] == -1).all()
        assert (column[last + 1 : last + 2] == -1).all()


def test_empty_columns_hold_the_last_known_position():
    made = recording(
        track([0, 8], [[0, 0], [0, 0]], "long"),
        track([1, 2], [[1, 1], [2, 2]], "first"),
        track([5, 6], [[5, 5], [6, 6]], "second"),
    )
    packed = resample(made, 1.0, max_gap_s=10.0)
    np.testing.assert_array_equal(packed.track_index[:, 1], [-1, 1, 1, -1, -1, 2, 2, -1, -1])
    np.testing.assert_array_equal(packed.positions_m[:, 1, 0], [1, 1, 2, 2, 2, 5, 6, 6, 6])


# Fitting


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


def test_slow_clocks_are_scaled_by_how_the_motion_goes_on():
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
def test_acceleration_intensity_of_integrated_white_noise_and_its_bias(clock):
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
        biased = fit_statistics(recording(*noisy), 0.5)
        assert_close_to(biased.acceleration_intensity, q + 9 * 0.1**2 / 0.5**3 * np.eye(2), 0.05)


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
    fit = fit_statistics(recording(track(times, positions)), 0.5)
    assert_close_to(fit.walk_covariance_m2, 0.1 * np.eye(2), 0.1)
    assert fit.spikes == 0
    assert fit.trimmed_fraction == pytest.approx(2 / 2000)


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
