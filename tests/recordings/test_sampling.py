"""Tracks sampled many at once are those sampled by numpy's interpolation one by one; a great many within seconds."""

import time

import numpy as np
import pytest

from foveate.recordings import sampling
from foveate.recordings.formats import load_recording
from foveate.recordings.recording import resample


def tracks_of(rng, count):
    """Tracks of 1 to 9 fixes, some of them at instants, with gaps."""
    for _ in range(count):
        size = int(rng.integers(1, 10))
        times = np.unique(np.where(rng.random(size) < 0.3, rng.integers(0, 40, size) * 0.5, rng.uniform(0, 20, size)))
        yield times, rng.normal(size=(len(times), 2))


@pytest.mark.parametrize("group", [1, 50, 1 << 16])
def test_tracks_in_groups_agree_with_numpy_one_by_one(group, monkeypatch):
    monkeypatch.setattr(sampling, "GROUP", group)
    rng, instants, tau, gap = np.random.default_rng(4), np.arange(41) * 0.5, 0.5, 3.0
    tracks = list(tracks_of(rng, 200))
    pieces = list(sampling.sample(tracks, instants, tau, gap))
    assert len(pieces) == len(tracks)
    for (times, positions), piece in zip(tracks, pieces, strict=True):
        span = np.flatnonzero((instants >= times[0]) & (instants <= times[-1]))
        assert len(piece.present) == len(span)
        if not len(span):
            continue
        assert piece.first == span[0]
        for t, present, position in zip(instants[span], piece.present, piece.positions_m, strict=True):
            near = np.abs(times - t)
            before, after = times[times <= t].max(), times[times >= t].min()
            assert present == (near.min() == 0 or after - before <= gap)
            linear = [np.interp(t, times, axis) for axis in positions.T]
            np.testing.assert_allclose(position, linear if present else positions[near.argmin()], atol=1e-12)


def written(path, tracks, fixes, rng):
    """A recording of this many tracks, all at once."""
    places = rng.uniform(-50, 50, (tracks, 2)).round(3).tolist()
    with path.open("w") as file:
        file.write("time_s,track_id,x_m,y_m\n")
        for k in range(fixes):
            file.writelines(f"{0.1 * k:.1f},t{i},{x},{y}\n" for i, (x, y) in enumerate(places))
    return path


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.parametrize(("tracks", "fixes", "most_s"), [(100, 2_000, 1.0), (20_000, 10, 2.0)])
def test_many_rows_and_many_tracks_at_once_are_read_and_sampled_within_seconds(tmp_path, tracks, fixes, most_s):
    path = written(tmp_path / "r.csv", tracks, fixes, np.random.default_rng(0))
    began = time.thread_time()
    slots = resample(load_recording(path), 0.1)
    took = time.thread_time() - began
    assert slots.present.shape == (fixes, tracks)
    assert slots.present.all()
    # A fifth of a million rows and of 10^5 tracks, in a fifth of 5 and 10 s. Here every annotation is checked, too,
    # lines are counted, and machines are of different speeds.
    assert took < 4 * most_s, f"{took:.1f} s"
