"""Recordings of real targets: read the CSV, cut it in time, sample it at control instants, pack its tracks.

A recording is a CSV file with the header `time_s,track_id,x_m,y_m[,z_m]`: one row, a *fix*, says where one
target was at one time. Rows are sorted by time; the clock may be irregular, and targets come and go. All
positions are in the world frame [m], all times in seconds of the recording's own clock.
"""

import csv
import hashlib
import heapq
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import floor, isfinite
from os import PathLike
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from foveate.files import read_text

COLUMNS = ("time_s", "track_id", "x_m", "y_m", "z_m")
MAX_LINE_BYTES = 4096
MAX_MAGNITUDE = 1e12  # s or m: squares stay finite, and a float64 clock still resolves 0.2 ms
MAX_CELLS = 20_000_000  # instants x tracks of one sampled array: about 0.5 GB in space
_HEADER = "the header must be time_s,track_id,x_m,y_m or time_s,track_id,x_m,y_m,z_m"


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
    """Of the file, in hex; empty for one that was made in memory."""

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
class Sampled:
    """A recording at control instants t_k = start + k tau, one column per track.

    Where a track is absent, `positions_m` holds its nearest known position in time, never NaN.
    `dropped` counts the tracks of the recording that are present at no instant and have no column.
    """

    times_s: Float[np.ndarray, " steps"]
    present: Bool[np.ndarray, "steps n"]
    positions_m: Float[np.ndarray, "steps n d"]
    track_ids: tuple[str, ...]
    dropped: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Slots:
    """A sampled recording in few columns, each of which serves one track after another.

    `track_index` is the index into `track_ids` of the track that is present in a column, -1 where none is.
    Where a column is empty, `positions_m` holds its last known position (its first one before that).
    """

    times_s: Float[np.ndarray, " steps"]
    present: Bool[np.ndarray, "steps columns"]
    positions_m: Float[np.ndarray, "steps columns d"]
    track_index: Int[np.ndarray, "steps columns"]
    track_ids: tuple[str, ...]
    dropped: int


class _Piece(NamedTuple):
    """One track from instant `first` on, for as many instants as its fixes span."""

    first: int
    present: np.ndarray
    positions_m: np.ndarray


def load_recording(path: str | PathLike[str]) -> Recording:
    """Read a recording, strictly.

    Track ids are text, numbers too ("7" and "07" differ; blanks around them do not count). Blank lines and a
    byte-order mark are passed over. Memory grows only with the number of fixes, (d + 2) numbers for each. Where a file
    of the same name with .sha256 behind it lies beside the recording (`sha256sum r.csv > r.csv.sha256` makes it), the
    recording must be what that says: CSV itself does not show a changed digit.

    Raises:
        ValueError: one line with file, line number, the value, and what would be right.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest() if path.is_file() else ""
            _check_sum(path, sha256)
            if sha256:
                file.seek(0)
            return replace(_parse(path, file), sha256=sha256)
    except IsADirectoryError:
        raise ValueError(f"{path}: is a directory; give the path of a recording, a CSV file") from None
    except FileNotFoundError:
        raise ValueError(f"{path}: no such file; give the path of a recording, a CSV file") from None
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}") from None


def _check_sum(path: Path, sha256: str) -> None:
    """Raise ValueError where a sum lies beside the recording, and is another."""
    beside = path.with_name(f"{path.name}.sha256")
    if not sha256 or not beside.is_file():
        return
    wanted = read_text(beside, "SHA-256 sum").split()[:1]
    if wanted != [sha256]:
        raise ValueError(f"{path}: is cut short, damaged or changed: {beside.name} says another SHA-256 sum")


def _parse(path: Path, file: BinaryIO) -> Recording:
    reader = csv.reader(_lines(file), strict=True)
    line = 1
    try:
        dimension = _header_dimension(next(reader, None))
        times, points, owners = array("d"), array("d"), array("q")
        index_of: dict[str, int] = {}
        # Times are sorted, so a duplicate can only repeat its track's last time.
        last_s: list[float] = []
        now_s = -np.inf
        line = reader.line_num + 1
        for row in reader:
            if row:
                time_s, track_id, *point = _row(row, dimension)
                if time_s < now_s:
                    raise ValueError(f"time_s {time_s!r} comes after {now_s!r}; rows must be sorted by time")
                now_s = time_s
                owner = index_of.get(track_id)
                if owner is None:
                    owner = index_of[_checked_id(track_id)] = len(last_s)
                    last_s.append(-np.inf)
                if last_s[owner] == time_s:
                    raise ValueError(
                        f"track_id {track_id!r} has two rows at time_s {time_s!r}; "
                        "there must be one row for each time and track"
                    )
                last_s[owner] = time_s
                times.append(time_s)
                points.extend(point)
                owners.append(owner)
            line = reader.line_num + 1
    except (ValueError, csv.Error) as error:
        expected = "; every row must be plain comma-separated text" if isinstance(error, csv.Error) else ""
        raise ValueError(f"{path}: line {line}: {error}{expected}") from None
    if not times:
        raise ValueError(f"{path}: line {line}: no rows; at least one row must follow the header")
    tracks = _group(np.asarray(times), np.asarray(points).reshape(-1, dimension), np.asarray(owners), index_of)
    return Recording(name=str(path), dimension=dimension, tracks=tracks)


def _lines(file: BinaryIO) -> Iterator[str]:
    """Decoded lines, each one bounded: a file that is no text at all must not fill the memory."""
    encoding = "utf-8-sig"
    while raw := file.readline(MAX_LINE_BYTES + 1):
        if len(raw) > MAX_LINE_BYTES:
            raise ValueError(f"longer than {MAX_LINE_BYTES} bytes; a row is a time, a track id and a position")
        try:
            yield raw.decode(encoding)
        except UnicodeDecodeError as error:
            bad = raw[error.start : error.start + 1]
            raise ValueError(f"byte {bad!r} is not UTF-8; save the file as UTF-8 text") from None
        encoding = "utf-8"


def _header_dimension(header: list[str] | None) -> int:
    if header is None:
        raise ValueError(f"the file is empty; {_HEADER}")
    names = tuple(header)
    if names in (COLUMNS[:4], COLUMNS):
        return len(names) - 2
    unexpected = [name for i, name in enumerate(names) if name not in COLUMNS or name in names[:i]]
    missing = [name for name in COLUMNS[:4] if name not in names]
    if unexpected:
        raise ValueError(f"unexpected column {_shown(unexpected[0])}; {_HEADER}")
    if missing:
        raise ValueError(f"column {missing[0]!r} is missing; {_HEADER}")
    raise ValueError(f"the columns {','.join(names)} are out of order; {_HEADER}")


def _row(row: list[str], dimension: int) -> tuple:
    if len(row) != dimension + 2:
        expected = ",".join(COLUMNS[: dimension + 2])
        raise ValueError(f"{len(row)} fields; there must be {dimension + 2}: {expected}")
    point = map(_number, row[2:], COLUMNS[2:])
    return _number(row[0], COLUMNS[0]), row[1].strip(), *point


def _number(text: str, column: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    # Python reads "1_000" as a number, a recording does not; NaN fails the comparison.
    if not -MAX_MAGNITUDE <= value <= MAX_MAGNITUDE or "_" in text:
        unit = "seconds" if column == "time_s" else "metres"
        limit = f"at most {MAX_MAGNITUDE:g} in size"
        raise ValueError(f"{column} is {_shown(text)}; it must be a finite number of {unit}, {limit}")
    return value


def _checked_id(track_id: str) -> str:
    if not track_id or not track_id.isprintable():
        raise ValueError(f"track_id is {_shown(track_id)}; it must be a name or number of printable characters")
    return track_id


def _shown(text: str) -> str:
    return repr(text if len(text) <= 40 else text[:37] + "...")


def _group(times: np.ndarray, points: np.ndarray, owners: np.ndarray, ids: dict[str, int]) -> tuple[Track, ...]:
    order = np.argsort(owners, kind="stable")  # stable: the fixes of a track stay sorted by time
    times, points = times[order], points[order]
    times.setflags(write=False)
    points.setflags(write=False)
    bounds = np.searchsorted(owners[order], np.arange(len(ids) + 1))
    spans = zip(ids, bounds[:-1], bounds[1:], strict=True)
    return tuple(Track(track_id=i, times_s=times[a:b], positions_m=points[a:b]) for i, a, b in spans)


def window(recording: Recording, start_s: float | None = None, end_s: float | None = None) -> Recording:
    """The fixes with start_s <= time <= end_s; None leaves that side open.

    The result starts at its own first fix, which may be later than `start_s`.

    Raises:
        ValueError: no fix is left; names the span of the recording.
    """
    lower = -np.inf if start_s is None else start_s
    upper = np.inf if end_s is None else end_s
    kept = []
    for track in recording.tracks:
        inside = (track.times_s >= lower) & (track.times_s <= upper)
        if inside.any():
            kept.append(replace(track, times_s=track.times_s[inside], positions_m=track.positions_m[inside]))
    if not kept:
        raise ValueError(
            f"{recording.name}: no fix between start {lower:g} s and end {upper:g} s; "
            f"the recording spans {recording.start_s:.10g} s to {recording.end_s:.10g} s"
        )
    return replace(recording, tracks=tuple(kept))


def resample(recording: Recording, tau_s: float, max_gap_s: float = 2.0) -> Sampled:
    """Positions of every track at the instants t_k = start + k tau, k = 0..K, t_K <= end.

    Between two fixes at most `max_gap_s` apart the position is interpolated linearly, the track present.
    It is absent before its first fix, after its last, and between fixes further apart than that, except where
    an instant coincides with a fix (to within 1e-6 tau). A track with one fix is therefore present at one
    instant or, far more often, at none: nothing says how long it was there.

    Raises:
        ValueError: tau or max_gap not positive and finite, a recording shorter than tau, or a result of more
            than `MAX_CELLS` instants x tracks (`resample_slots` needs far less).
    """
    times, tracks, pieces = _sampled_tracks(recording, tau_s, max_gap_s)
    _check_size(recording.name, len(times), len(tracks))
    present = np.zeros((len(times), len(tracks)), dtype=bool)
    positions = np.empty((len(times), len(tracks), recording.dimension))
    for column, (track, piece) in enumerate(zip(tracks, pieces, strict=True)):
        stop = piece.first + len(piece.present)
        present[piece.first : stop, column] = piece.present
        positions[: piece.first, column] = track.positions_m[0]
        positions[piece.first : stop, column] = piece.positions_m
        positions[stop:, column] = track.positions_m[-1]
    return Sampled(
        times_s=times,
        present=present,
        positions_m=positions,
        track_ids=tuple(track.track_id for track in tracks),
        dropped=len(recording.tracks) - len(tracks),
    )


def slots(sampled: Sampled) -> Slots:
    """Pack the tracks into as few columns as possible, by greedy colouring of their intervals.

    A column serves a later track only after the earlier one has left for good, with at least one absent
    instant between, so that the later one is seen as a new target. A track keeps its column over inner gaps.
    """
    columns = zip(sampled.present.T, sampled.positions_m.swapaxes(0, 1), strict=True)
    pieces = [_Piece(0, present, positions) for present, positions in columns]
    return _pack(
        "a sampled recording", pieces, sampled.times_s, sampled.positions_m.shape[2], sampled.track_ids, sampled.dropped
    )


def resample_slots(recording: Recording, tau_s: float, max_gap_s: float = 2.0) -> Slots:
    """`slots(resample(...))` without the array of all tracks: for recordings of thousands of short tracks.

    Raises:
        ValueError: as `resample`, but for more than `MAX_CELLS` instants x columns.
    """
    times, tracks, pieces = _sampled_tracks(recording, tau_s, max_gap_s)
    ids = tuple(track.track_id for track in tracks)
    return _pack(recording.name, pieces, times, recording.dimension, ids, len(recording.tracks) - len(tracks))


def _sampled_tracks(
    recording: Recording, tau_s: float, max_gap_s: float
) -> tuple[np.ndarray, list[Track], list[_Piece]]:
    """The instants, the tracks that are present at one of them, and these tracks sampled."""
    for name, value in (("tau_s", tau_s), ("max_gap_s", max_gap_s)):
        if not (isfinite(value) and value > 0):
            raise ValueError(f"{name} is {value!r}; it must be a positive, finite number of seconds")
    start_s, span_s = recording.start_s, recording.end_s - recording.start_s
    steps = floor(span_s / tau_s + 1e-6)  # the tolerance keeps an end that falls on an instant
    if steps < 1:
        raise ValueError(f"{recording.name}: spans {span_s:g} s; it must span one step of {tau_s:g} s at least")
    _check_size(recording.name, steps + 1, 1)
    times = start_s + tau_s * np.arange(steps + 1)
    pieces = [_sample(track, times, tau_s, max_gap_s) for track in recording.tracks]
    kept = [i for i, piece in enumerate(pieces) if piece.present.any()]
    return times, [recording.tracks[i] for i in kept], [pieces[i] for i in kept]


def _check_size(name: str, steps: int, columns: int) -> None:
    if steps * columns > MAX_CELLS:
        raise ValueError(
            f"{name}: {steps} instants x {columns} columns to sample; at most {MAX_CELLS} in all are possible: "
            "cut the recording in time, choose a longer tau_s, or look for wrong times in it"
        )


def _sample(track: Track, times: np.ndarray, tau_s: float, max_gap_s: float) -> _Piece:
    fixes, last = track.times_s, len(track.times_s) - 1
    # What a clock of this magnitude can resolve: 3 * 0.1 is not 0.3, and Unix time is known to 0.2 us.
    tolerance = 1e-6 * tau_s + 4 * np.spacing(np.abs(times[[0, -1]]).max())
    first = int(np.searchsorted(times, fixes[0] - tolerance, "left"))
    stop = int(np.searchsorted(times, fixes[-1] + tolerance, "right"))
    instants = np.clip(times[first:stop], fixes[0], fixes[-1])
    after = np.clip(np.searchsorted(fixes, instants, "right"), min(1, last), last)
    before = np.maximum(after - 1, 0)
    gap = fixes[after] - fixes[before]
    fraction = (instants - fixes[before]) / np.where(gap > 0, gap, 1.0)
    bridged = gap <= max_gap_s + tolerance
    on_fix = np.minimum(instants - fixes[before], fixes[after] - instants) <= tolerance
    fraction = np.where(bridged, fraction, np.round(fraction))[:, None]
    start, end = track.positions_m[before], track.positions_m[after]
    return _Piece(first, bridged | on_fix, start + fraction * (end - start))


def _pack(
    name: str, pieces: Sequence[_Piece], times: np.ndarray, dimension: int, ids: tuple[str, ...], dropped: int
) -> Slots:
    lives = [piece.first + np.flatnonzero(piece.present)[[0, -1]] for piece in pieces]
    column_of, columns = _colour([(int(first), int(last)) for first, last in lives])
    _check_size(name, len(times), columns)
    present = np.zeros((len(times), columns), dtype=bool)
    index = np.full((len(times), columns), -1)
    positions = np.zeros((len(times), columns, dimension))
    for i in sorted(range(len(pieces)), key=lambda i: lives[i][0]):
        piece, column, (first, last) = pieces[i], column_of[i], lives[i]
        life = slice(first - piece.first, last + 1 - piece.first)
        if not present[:, column].any():
            positions[:first, column] = piece.positions_m[life][0]
        present[first : last + 1, column] = piece.present[life]
        index[first : last + 1, column] = np.where(piece.present[life], i, -1)
        positions[first : last + 1, column] = piece.positions_m[life]
        positions[last + 1 :, column] = positions[last, column]  # until the next track takes the column
    return Slots(
        times_s=times,
        present=present,
        positions_m=positions,
        track_index=index,
        track_ids=ids,
        dropped=dropped,
    )


def _colour(lives: list[tuple[int, int]]) -> tuple[list[int], int]:
    """Column of each interval [first, last], and how many columns: the fewest, as starts are in order."""
    column_of = [0] * len(lives)
    taken: list[tuple[int, int]] = []  # heap of (last instant, column)
    columns = 0
    for i in sorted(range(len(lives)), key=lambda i: lives[i][0]):
        first, last = lives[i]
        if taken and taken[0][0] <= first - 2:
            column = heapq.heappop(taken)[1]
        else:
            column, columns = columns, columns + 1
        column_of[i] = column
        heapq.heappush(taken, (last, column))
    return column_of, columns
