"""Positions of tracks at control instants, of many short tracks at once."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

Fixes = tuple[np.ndarray, np.ndarray]
"""Times (m,) [s], increasing, and positions (m, d) [m] of one track; m >= 1."""
GROUP = 1 << 16
"""Fixes and instants of the tracks that are sampled at once: enough that numpy does the work, in little memory."""


class Piece(NamedTuple):
    """One track at the instants that its fixes span, from instant `first` on."""

    first: int
    present: Bool[np.ndarray, " instants"]
    positions_m: Float[np.ndarray, "instants d"]


def sample(tracks: Sequence[Fixes], times: Float[np.ndarray, " steps"], tau_s: float, max_gap_s: float) -> list[Piece]:
    """Sample each track at those of the instants `times` that its fixes span, as `resample` explains."""
    # The resolution of a clock of this magnitude: 3 * 0.1 is not 0.3, and Unix time is accurate to 0.2 us.
    tolerance = 1e-6 * tau_s + 4 * np.spacing(np.abs(times[[0, -1]]).max())
    counts = np.array([len(fixes) for fixes, _ in tracks])
    first = np.searchsorted(times, np.array([fixes[0] for fixes, _ in tracks]) - tolerance, "left")
    stop = np.searchsorted(times, np.array([fixes[-1] for fixes, _ in tracks]) + tolerance, "right")
    group = np.cumsum(counts + stop - first) // GROUP
    bounds = np.append(np.flatnonzero(np.diff(group, prepend=-1)), len(tracks))
    pieces = []
    for begin, end in pairwise(bounds.tolist()):
        pieces += _group(tracks[begin:end], times, first[begin:end], stop[begin:end], tolerance, max_gap_s)
    return pieces


def _group(
    tracks: Sequence[Fixes],
    times: Float[np.ndarray, " steps"],
    first: Int[np.ndarray, " n"],
    stop: Int[np.ndarray, " n"],
    tolerance: float,
    max_gap_s: float,
) -> list[Piece]:
    fixes, positions = (np.concatenate(parts) for parts in zip(*tracks, strict=True))
    counts, spans = np.array([len(fixes) for fixes, _ in tracks]), stop - first
    begins, ends = np.cumsum(counts) - counts, np.cumsum(spans)
    owner = np.repeat(np.arange(len(tracks)), spans)
    begin, last = begins[owner], begins[owner] + counts[owner] - 1
    instants = times[np.arange(len(owner)) - (ends - spans)[owner] + first[owner]]
    instants = np.clip(instants, fixes[begin], fixes[last])
    # Fixes of a track at or before an instant, by one search: complex numbers are in the order of (track, time).
    passed = np.searchsorted(_keys(np.repeat(np.arange(len(tracks)), counts), fixes), _keys(owner, instants), "right")
    after = np.clip(passed, np.minimum(begin + 1, last), last)
    before = np.maximum(after - 1, begin)
    gap = fixes[after] - fixes[before]
    # A track of one fix has no gap to divide by: the fixes before and after an instant are the same.
    fraction = (instants - fixes[before]) / np.where(gap > 0, gap, 1.0)
    bridged = gap <= max_gap_s + tolerance
    on_fix = np.minimum(instants - fixes[before], fixes[after] - instants) <= tolerance
    fraction = np.where(bridged, fraction, np.round(fraction))[:, None]
    start = positions[before]
    present, sampled = bridged | on_fix, start + fraction * (positions[after] - start)
    cuts = zip(first.tolist(), (ends - spans).tolist(), ends.tolist(), strict=True)
    return [Piece(instant, present[begin:end], sampled[begin:end]) for instant, begin, end in cuts]


def _keys(owner: Int[np.ndarray, " m"], times: Float[np.ndarray, " m"]) -> np.ndarray:
    keys = np.empty(len(times), complex)
    keys.real, keys.imag = owner, times
    return keys
