"""Tracks of a recording that say little of motion, each with the option that would change it."""

import numpy as np

from foveate.recordings.outliers import LEAST_STEPS, MIN_STEP_M, USUAL, Finding, resolution_m
from foveate.recordings.recording import Recording, Track


def unused(recording: Recording, max_gap_s: float, noise_std_m: float) -> list[Finding]:
    """Find tracks of a single fix, with long gaps, that stand still, or of rounded positions."""
    found = []
    for track in recording.tracks:
        time_s = float(track.times_s[0]) + recording.clock_origin_s
        said = _time(track, time_s, max_gap_s), _place(track, time_s, noise_std_m)
        found += [Finding(kind=each[0], track_id=track.track_id, time_s=time_s, text=each[1]) for each in said if each]
    return found


def _time(track: Track, time_s: float, max_gap_s: float) -> tuple[str, str] | None:
    gaps = np.diff(track.times_s)
    if not len(gaps):
        return "fix", f"{track.track_id}: a single fix at {time_s:.10g} s says nothing of motion"
    long = gaps[gaps > max_gap_s * (1 + 1e-6)]
    if long.sum() <= 0.5 * gaps.sum():
        return None
    return "gap", (
        f"{track.track_id}: {len(gaps) + 1} fixes from {time_s:.10g} s on, up to {gaps.max():.3g} s apart: absent for "
        f"{long.sum() / gaps.sum():.0%} of its time, as --max-gap is {max_gap_s:g} s; --max-gap "
        f"{1.01 * float(np.percentile(long, USUAL)):.3g} keeps it"
    )


def _place(track: Track, time_s: float, noise_std_m: float) -> tuple[str, str] | None:
    if len(track.times_s) <= LEAST_STEPS:
        return None
    low, high = np.percentile(track.positions_m, [2.5, 97.5], axis=0)
    if (high - low).max() <= max(6.0 * noise_std_m, MIN_STEP_M):
        text = f"{track.track_id}: stands still from {time_s:.10g} s to its end; counts as a target that does not move"
        return "still", text
    steps, resolution = np.abs(np.diff(track.positions_m, axis=0)), resolution_m(track)
    if resolution > 0 and (steps < 1e-6).mean() > 0.5:
        return "rounded", f"{track.track_id}: positions come in steps of {resolution:.3g} m, as noise of the fixes"
    return None
