"""Recordings: cutting, sampling, packing; made-up data with known answers."""

import numpy as np
import pytest
from helpers.recordings import recording, track

from foveate.recordings.recording import MAX_CELLS, Recording, resample, window

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


def test_invalid_sampling_is_rejected():
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
        np.testing.assert_allclose(packed.positions_m[rows, columns], made.tracks[i].positions_m, rtol=1e-12)
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
