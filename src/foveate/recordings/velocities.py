"""Velocities of recorded targets, from pairs of real fixes and their true time differences: any clock will do."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from foveate.recordings.recording import Track


@dataclass(frozen=True, kw_only=True, eq=False)
class Velocities:
    """Mean velocities [m/s] over pairs of fixes of all tracks, and the spans [s] of these pairs.

    `weight` is the time to the next fix [s], so that tracks count by their time, whatever their clocks.
    Each row of `turns` holds the indices of two pairs of which the second starts where the first ends.
    """

    velocity: Float[np.ndarray, "pairs d"]
    dt: Float[np.ndarray, " pairs"]
    weight: Float[np.ndarray, " pairs"]
    turns: np.ndarray


def velocities(tracks: list[Track], spacing_s: float, max_gap_s: float) -> Velocities:
    """Mean velocities over pairs of fixes about `spacing_s` apart, without a gap over `max_gap_s` between them."""
    velocity, dt, weight, turns, offset = [], [], [], [], 0
    for track in tracks:
        start, end = _pairs(track.times_s, spacing_s, max_gap_s)
        weight.append(np.diff(track.times_s)[start])
        span = track.times_s[end] - track.times_s[start]
        velocity.append((track.positions_m[end] - track.positions_m[start]) / span[:, None])
        dt.append(span)
        pair_from = np.full(len(track.times_s), -1)  # the pair that starts at a fix
        pair_from[start] = np.arange(len(start))
        next_pair = pair_from[end]
        first = np.flatnonzero(next_pair >= 0)
        turns.append(offset + np.stack([first, next_pair[first]], axis=1))
        offset += len(start)
    return Velocities(
        velocity=np.concatenate(velocity),
        dt=np.concatenate(dt),
        weight=np.concatenate(weight),
        turns=np.concatenate(turns),
    )


def joined(parts: list[Velocities]) -> Velocities:
    """Pairs of several groups of tracks."""
    offsets = np.cumsum([0, *(len(part.dt) for part in parts[:-1])])
    return Velocities(
        velocity=np.concatenate([part.velocity for part in parts]),
        dt=np.concatenate([part.dt for part in parts]),
        weight=np.concatenate([part.weight for part in parts]),
        turns=np.concatenate([part.turns + offset for part, offset in zip(parts, offsets, strict=True)]),
    )


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
