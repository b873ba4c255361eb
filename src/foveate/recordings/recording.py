"""Recordings of real targets: cut in time, sample at control instants, pack tracks into few columns.

A recording is a CSV file with the header `time_s,track_id,x_m,y_m[,z_m]`. Each row is a *fix*: the position of one
target at one time. Rows are sorted by time; the clock may be irregular, and targets come and go. All positions are in
the world frame [m], all times in seconds of the recording's own clock, less its origin.
"""

import heapq
from dataclasses import dataclass, replace
from math import floor, isfinite
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from foveate.errors import InputError
from foveate.recordings.clock import SINCE_1970
from foveate.recordings.sampling import Piece, sample
from foveate.scenario.origin import OriginSettings

MAX_CELLS = 20_000_000  # instants x tracks of one sampled array: about 0.5 GB in space


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """The fixes of one target: strictly increasing times [s] and world positions [m], one row per fix."""

    track_id: str
    times_s: Float[np.ndarray, " m"]
    positions_m: Float[np.ndarray, "m d"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Tracks of real targets, in the order in which they first appear; at least one, each with a fix."""

    name: str
    dimension: int
    tracks: tuple[Track, ...]
    sha256: str = ""
    """Digest of the file, in hex; empty for a recording made in memory. Of several files, that of their digests."""
    clock_origin_s: int = 0
    """Seconds of the recording's own clock at time 0: subtracted from a clock that counts from 1970."""
    origin: OriginSettings | None = None
    """Place of the local coordinates on the map that the file was in; None for those of the file."""
    notes: tuple[str, ...] = ()
    """What its reader took for granted, a line each."""

    @property
    def short_name(self) -> str:
        """Names of the files, without their folders."""
        return ", ".join(Path(part).name for part in self.name.split(", "))

    @property
    def start_s(self) -> float:
        """Time of the first fix [s]."""
        return float(min(track.times_s[0] for track in self.tracks))

    @property
    def end_s(self) -> float:
        """Time of the last fix [s]."""
        return float(max(track.times_s[-1] for track in self.tracks))

    @property
    def extent(self) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, " d"]]:
        """Lower and upper corner of the box around all fixes [m]."""
        lower = np.min([track.positions_m.min(axis=0) for track in self.tracks], axis=0)
        return lower, np.max([track.positions_m.max(axis=0) for track in self.tracks], axis=0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Slots:
    """Recording at control instants t_k = start + k tau, in few columns, each of which holds one track after another.

    `track_index` is the index into `track_ids` of the track that is present in a column, -1 where none is. Where a
    column is empty, `positions_m` holds its latest position (its first one before that), never NaN. `dropped` counts
    the tracks of the recording that are present at no instant and have no column.
    """

    times_s: Float[np.ndarray, " steps"]
    present: Bool[np.ndarray, "steps columns"]
    positions_m: Float[np.ndarray, "steps columns d"]
    track_index: Int[np.ndarray, "steps columns"]
    track_ids: tuple[str, ...]
    dropped: int


def window(recording: Recording, start_s: float | None = None, end_s: float | None = None) -> Recording:
    """Cut a recording to the fixes with start_s <= time <= end_s; None leaves that side open.

    Times are those of the recording's clock; where it counts from 1970, small ones count from its origin. The result
    starts at its own first fix, which may be later than `start_s`. Raises InputError where no fix is left.
    """
    lower = -np.inf if start_s is None else _after_origin(recording, start_s)
    upper = np.inf if end_s is None else _after_origin(recording, end_s)
    kept = []
    for track in recording.tracks:
        inside = (track.times_s >= lower) & (track.times_s <= upper)
        if inside.any():
            kept.append(replace(track, times_s=track.times_s[inside], positions_m=track.positions_m[inside]))
    if not kept:
        raise InputError(
            f"{recording.name}: no fix between start {lower:g} s and end {upper:g} s; "
            f"the recording spans {recording.start_s:.10g} s to {recording.end_s:.10g} s"
        )
    return replace(recording, tracks=tuple(kept))


def _after_origin(recording: Recording, time_s: float) -> float:
    return time_s - recording.clock_origin_s if recording.clock_origin_s and time_s >= SINCE_1970 else time_s


def moved(recording: Recording, origin: OriginSettings | None) -> Recording:
    """Move a recording that was on a map to local coordinates about another origin; others stay as they are."""
    if origin is None or recording.origin is None or origin == recording.origin:
        return recording
    if origin.in_degrees != recording.origin.in_degrees:
        raise InputError(f"{recording.name}: is on a map with origin {recording.origin}, the scenario at {origin}")
    here = recording.origin
    tracks = [replace(t, positions_m=origin.local(here.on_map(t.positions_m))) for t in recording.tracks]
    return replace(recording, tracks=tuple(tracks), origin=origin)


def resample(recording: Recording, tau_s: float, max_gap_s: float = 2.0) -> Slots:
    """Sample a recording at the instants t_k = start + k tau, k = 0..K, t_K <= end, and pack its tracks into columns.

    Between two fixes at most `max_gap_s` apart the position is interpolated linearly, and the track is present. It is
    absent before its first fix, after its last, and between fixes further apart than that, where its position is that
    of the nearest fix; but present where an instant coincides with a fix (to within 1e-6 tau). A track with one fix is
    therefore present at one instant or, far more often, at none: its duration is unknown.

    Columns are as few as possible, by greedy colouring of the tracks' intervals. A column holds a later track only
    after the earlier one has left for good, with at least one absent instant between, so that the later one counts as a
    new target. A track keeps its column over inner gaps.

    Raises InputError where tau or max_gap is not positive and finite, for a recording shorter than tau, and for more
    than `MAX_CELLS` instants x columns.
    """
    times, tracks, pieces = _sampled_tracks(recording, tau_s, max_gap_s)
    lives = [(piece.first + np.flatnonzero(piece.present)[[0, -1]]).tolist() for piece in pieces]
    column_of, columns = _colour(lives)
    _check_size(recording.name, len(times), columns)
    present = np.zeros((len(times), columns), dtype=bool)
    index = np.full((len(times), columns), -1)
    positions = np.zeros((len(times), columns, recording.dimension))
    # In the order of their starts: each keeps its last position to the end, until the next track of the column.
    for i in sorted(range(len(pieces)), key=lambda i: lives[i][0]):
        piece, column, (first, last) = pieces[i], column_of[i], lives[i]
        life = slice(first - piece.first, last + 1 - piece.first)
        if not present[:, column].any():
            positions[:first, column] = piece.positions_m[life][0]
        present[first : last + 1, column] = piece.present[life]
        index[first : last + 1, column] = np.where(piece.present[life], i, -1)
        positions[first : last + 1, column] = piece.positions_m[life]
        positions[last + 1 :, column] = positions[last, column]
    return Slots(
        times_s=times,
        present=present,
        positions_m=positions,
        track_index=index,
        track_ids=tuple(track.track_id for track in tracks),
        dropped=len(recording.tracks) - len(tracks),
    )


def _sampled_tracks(
    recording: Recording, tau_s: float, max_gap_s: float
) -> tuple[np.ndarray, list[Track], list[Piece]]:
    """Return the instants, the tracks that are present at any of them, and these tracks sampled."""
    for name, value in (("tau_s", tau_s), ("max_gap_s", max_gap_s)):
        if not (isfinite(value) and value > 0):
            raise InputError(f"{name} is {value!r}; it must be a positive, finite number of seconds")
    start_s, span_s = recording.start_s, recording.end_s - recording.start_s
    steps = floor(span_s / tau_s + 1e-6)  # the tolerance keeps an end that falls on an instant
    if steps < 1:
        raise InputError(f"{recording.name}: spans {span_s:g} s; it must span one step of {tau_s:g} s at least")
    _check_size(recording.name, steps + 1, 1)
    times = start_s + tau_s * np.arange(steps + 1)
    fixes = [(track.times_s, track.positions_m) for track in recording.tracks]
    pieces = sample(fixes, times, tau_s, max_gap_s)
    kept = [i for i, piece in enumerate(pieces) if piece.present.any()]
    return times, [recording.tracks[i] for i in kept], [pieces[i] for i in kept]


def _check_size(name: str, steps: int, columns: int) -> None:
    if steps * columns > MAX_CELLS:
        raise InputError(
            f"{name}: {steps} instants x {columns} columns to sample; at most {MAX_CELLS} in all are possible: "
            "cut the recording in time, choose a longer tau_s, or look for wrong times in it"
        )


def _colour(lives: list[list[int]]) -> tuple[list[int], int]:
    """Assign a column to each interval [first, last], the fewest as starts are in order; return also their number."""
    column_of = [0] * len(lives)
    columns: list[tuple[int, int]] = []  # heap of (last instant, column)
    for i in sorted(range(len(lives)), key=lambda i: lives[i][0]):
        first, last = lives[i]
        is_free = columns and columns[0][0] <= first - 2
        column_of[i] = heapq.heappop(columns)[1] if is_free else len(columns)
        heapq.heappush(columns, (last, column_of[i]))
    return column_of, len(columns)
