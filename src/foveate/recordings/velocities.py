"""Velocities of recorded targets, from pairs of real fixes and their true time differences: any clock will do."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from foveate.recordings.recording import Track

_SPIKE_STEPS = 10.0  # times the median step around it
_SPIKE_DETOUR = 3.0  # times the step that skips the fix
_SPIKE_NEIGHBOURS = 5  # steps on each side
_MIN_STEP_M = 1e-3  # below what any tracker resolves: a target that stands still has a median step of zero


@dataclass(frozen=True, kw_only=True, eq=False)
class Velocities:
    """Mean velocities [m/s] over pairs of fixes of all tracks, and the spans [s] of these pairs.

    Each row of `turns` holds the indices of two pairs of which the second starts where the first ends.
    """

    velocity: Float[np.ndarray, "pairs d"]
    dt: Float[np.ndarray, " pairs"]
    turns: np.ndarray


def without_spikes(track: Track) -> Track:
    """Leave out fixes that are *out and back*: both steps far above the median around them, and the direct step."""
    steps = np.linalg.norm(np.diff(track.positions_m, axis=0), axis=1)
    if len(steps) < 2:
        return track
    # Reflected at the ends, so that the first and last steps have as many neighbours as the others.
    padded = np.pad(steps, _SPIKE_NEIGHBOURS, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _SPIKE_NEIGHBOURS + 1)
    typical = np.median(windows, axis=1)
    skipping = np.linalg.norm(track.positions_m[2:] - track.positions_m[:-2], axis=1)
    shorter = np.minimum(steps[:-1], steps[1:])
    usual_step = np.maximum(np.maximum(typical[:-1], typical[1:]), _MIN_STEP_M)
    spike = (shorter > _SPIKE_STEPS * usual_step) & (shorter > _SPIKE_DETOUR * skipping)
    kept = np.concatenate([[True], ~spike, [True]])
    return Track(track_id=track.track_id, times_s=track.times_s[kept], positions_m=track.positions_m[kept])


def velocities(tracks: list[Track], spacing_s: float, max_gap_s: float) -> Velocities:
    """Mean velocities over pairs of fixes about `spacing_s` apart, without a gap over `max_gap_s` between them."""
    velocity, dt, turns, offset = [], [], [], 0
    for track in tracks:
        start, end = _pairs(track.times_s, spacing_s, max_gap_s)
        span = track.times_s[end] - track.times_s[start]
        velocity.append((track.positions_m[end] - track.positions_m[start]) / span[:, None])
        dt.append(span)
        pair_from = np.full(len(track.times_s), -1)  # the pair that starts at a fix
        pair_from[start] = np.arange(len(start))
        next_pair = pair_from[end]
        first = np.flatnonzero(next_pair >= 0)
        turns.append(offset + np.stack([first, next_pair[first]], axis=1))
        offset += len(start)
    return Velocities(velocity=np.concatenate(velocity), dt=np.concatenate(dt), turns=np.concatenate(turns))


def _pairs(times: np.ndarray, spacing_s: float, max_gap_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Pair each fix with the one nearest to `spacing_s` later, 1/2 to 2 spacings away and no long gap between."""
    last, start = len(times) - 1, np.arange(len(times) - 1)
    goal = times[:-1] + spacing_s
    after = np.clip(np.searchsorted(times, goal), start + 1, last)
    before = np.maximum(after - 1, start + 1)
    end = np.where(goal - times[before] <= times[after] - goal, before, after)
    dt = times[end] - times[start]
    long_gaps = np.concatenate([[0], np.cumsum(np.diff(times) > max_gap_s * (1 + 1e-6))])
    valid = (dt >= 0.5 * spacing_s) & (dt <= 2.0 * spacing_s) & (long_gaps[start] == long_gaps[end])
    return start[valid], end[valid]
