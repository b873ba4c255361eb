"""Read recordings from CSV files."""

import csv
import hashlib
from array import array
from collections.abc import Iterator
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import BinaryIO

import numpy as np

from foveate.errors import InputError
from foveate.io.files import read_text
from foveate.recordings.recording import Recording, Track, window

COLUMNS = ("time_s", "track_id", "x_m", "y_m", "z_m")
MAX_LINE_BYTES = 4096
MAX_MAGNITUDE = 1e12  # s or m: squares stay finite, and a float64 clock still resolves 0.2 ms
_HEADER = "the header must be time_s,track_id,x_m,y_m or time_s,track_id,x_m,y_m,z_m"


def load_recording(path: str | PathLike[str]) -> Recording:
    """Read a recording; an InputError names file, line number, the value, and what would be right.

    Track ids are text, even if they look like numbers ("7" and "07" differ); surrounding blanks are removed. Blank
    lines and a byte-order mark are ignored. Memory grows only with the number of fixes, (d + 2) numbers for each. A
    file of the same name and .sha256 beside the recording (`sha256sum r.csv > r.csv.sha256`) must match its checksum:
    CSV itself does not show a changed digit.
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
        raise InputError(f"{path}: is a directory; give the path of a recording, a CSV file") from None
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the path of a recording, a CSV file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def load_window(recording: Recording | str | Path, start_s: float | None, end_s: float | None) -> Recording:
    """Cut a recording as `window` does; a path is read first."""
    return window(recording if isinstance(recording, Recording) else load_recording(recording), start_s, end_s)


def _check_sum(path: Path, sha256: str) -> None:
    """Raise InputError where a checksum file beside the recording does not match it."""
    beside = path.with_name(f"{path.name}.sha256")
    if sha256 and beside.is_file() and read_text(beside, "SHA-256 sum").split()[:1] != [sha256]:
        raise InputError(f"{path}: is cut short, damaged or changed: {beside.name} says another SHA-256 sum")


def _parse(path: Path, file: BinaryIO) -> Recording:
    reader = csv.reader(_lines(file), strict=True)
    line = 1  # on which a record begins: in quotes it may span several
    try:
        dimension = _header_dimension(next(reader, None))
        times, points, owners = array("d"), array("d"), array("q")
        index_of: dict[str, int] = {}
        latest_s, last_s = -np.inf, []  # of all tracks, and of each: sorted, so a duplicate repeats its track's last
        line = reader.line_num + 1
        for row in reader:
            if row:
                time_s, track_id, *point = _row(row, dimension)
                if time_s < latest_s:
                    raise InputError(f"time_s {time_s!r} comes after {latest_s!r}; rows must be sorted by time")
                owner = index_of.get(track_id)
                if owner is None:
                    owner = index_of[_checked_id(track_id)] = len(last_s)
                    last_s.append(-np.inf)
                if last_s[owner] == time_s:
                    raise InputError(
                        f"track_id {track_id!r} has two rows at time_s {time_s!r}; "
                        "there must be one row for each time and track"
                    )
                latest_s = last_s[owner] = time_s
                times.append(time_s)
                points.extend(point)
                owners.append(owner)
            line = reader.line_num + 1
    except (InputError, csv.Error) as error:
        expected = "; every row must be plain comma-separated text" if isinstance(error, csv.Error) else ""
        raise InputError(f"{path}: line {line}: {error}{expected}") from None
    if not times:
        raise InputError(f"{path}: line {line}: no rows; at least one row must follow the header")
    tracks = _group(np.asarray(times), np.asarray(points).reshape(-1, dimension), np.asarray(owners), index_of)
    return Recording(name=str(path), dimension=dimension, tracks=tracks)


def _lines(file: BinaryIO) -> Iterator[str]:
    """Yield decoded lines of bounded length, so that a binary file does not fill the memory."""
    encoding = "utf-8-sig"
    while raw := file.readline(MAX_LINE_BYTES + 1):
        if len(raw) > MAX_LINE_BYTES:
            raise InputError(f"longer than {MAX_LINE_BYTES} bytes; a row is a time, a track id and a position")
        try:
            yield raw.decode(encoding)
        except UnicodeDecodeError as error:
            byte = raw[error.start : error.start + 1]
            raise InputError(f"byte {byte!r} is not UTF-8; save the file as UTF-8 text") from None
        encoding = "utf-8"


def _header_dimension(header: list[str] | None) -> int:
    names = tuple(header or ())
    if names in (COLUMNS[:4], COLUMNS):
        return len(names) - 2
    problem = f"the columns {','.join(names)} are out of order"
    if header is None:
        problem = "the file is empty"
    elif unexpected := [name for i, name in enumerate(names) if name not in COLUMNS or name in names[:i]]:
        problem = f"unexpected column {_quoted(unexpected[0])}"
    elif missing := [name for name in COLUMNS[:4] if name not in names]:
        problem = f"column {missing[0]!r} is missing"
    raise InputError(f"{problem}; {_HEADER}")


def _row(row: list[str], dimension: int) -> tuple:
    if len(row) != dimension + 2:
        expected = ",".join(COLUMNS[: dimension + 2])
        raise InputError(f"{len(row)} fields; there must be {dimension + 2}: {expected}")
    point = map(_number, row[2:], COLUMNS[2:])
    return _number(row[0], COLUMNS[0]), row[1].strip(), *point


def _number(text: str, column: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    # Python reads "1_000" as a number, a recording does not; NaN fails the comparison.
    if not -MAX_MAGNITUDE <= value <= MAX_MAGNITUDE or "_" in text:
        right = f"a finite number of {'seconds' if column == 'time_s' else 'metres'}, at most {MAX_MAGNITUDE:g} in size"
        raise InputError(f"{column} is {_quoted(text)}; it must be {right}")
    return value


def _checked_id(track_id: str) -> str:
    if not track_id or not track_id.isprintable():
        raise InputError(f"track_id is {_quoted(track_id)}; it must be a name or number of printable characters")
    return track_id


def _quoted(text: str) -> str:
    return repr(text if len(text) <= 40 else text[:37] + "...")


def _group(times: np.ndarray, points: np.ndarray, owners: np.ndarray, ids: dict[str, int]) -> tuple[Track, ...]:
    order = np.argsort(owners, kind="stable")  # stable: the fixes of a track stay sorted by time
    times, points = times[order], points[order]
    times.setflags(write=False)
    points.setflags(write=False)
    bounds = np.searchsorted(owners[order], np.arange(len(ids) + 1))
    spans = zip(ids, bounds[:-1], bounds[1:], strict=True)
    return tuple(Track(track_id=i, times_s=times[a:b], positions_m=points[a:b]) for i, a, b in spans)
