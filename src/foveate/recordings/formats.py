"""Read recordings from files: tables of text, trajectories, bags of ROS."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import BinaryIO

import numpy as np

from foveate.errors import InputError
from foveate.io.files import read_text
from foveate.recordings.bags import is_bag, read_bag
from foveate.recordings.clock import Clock, whole_days
from foveate.recordings.fixes import Collection, Fixes
from foveate.recordings.layout import HEADER, Layout, layout_of, parsed_columns
from foveate.recordings.recording import Recording, window
from foveate.recordings.rows import RowReader, decoded_line
from foveate.recordings.tables import TableReader
from foveate.scenario.origin import OriginSettings

MAX_SCENE_M = 100.0
"""Whole numbers beyond, with numbers of frames, are taken for pixels."""
AnyPath = str | PathLike[str]


@dataclass(frozen=True, kw_only=True)
class _Given:
    """What the user says about a file."""

    columns: dict[str, str]
    fps: float | None
    scale: float | None
    topics: tuple[str, ...]


def load_recording(
    path: AnyPath | Sequence[AnyPath],
    *,
    columns: str | Mapping[str, str] | None = None,
    fps: float | None = None,
    scale: float | None = None,
    topics: Sequence[str] = (),
    planar: bool = False,
    origin: OriginSettings | None = None,
) -> Recording:
    """Read a recording from one or more files; an InputError names file, line, the value, and what would be right.

    Formats: a CSV file with the header `time_s,track_id,x_m,y_m[,z_m]`; any other table of text with a row a fix, by
    `columns`; MOT challenge text; rows of frame, id, x, y; TUM trajectories, a file each target; bags of ROS 1 and 2
    (extra `ros`: PoseStamped, PoseWithCovarianceStamped, PoseArray and Odometry, by the stamps of their headers).

    Track ids are text, even if they look like numbers ("7" and "07" differ); surrounding blanks are removed. Blank
    lines and a byte-order mark are ignored. Memory grows only with the number of fixes, (d + 2) numbers for each. A
    file of the same name and .sha256 beside a file of text (`sha256sum r.csv > r.csv.sha256`) must match its checksum:
    CSV itself does not show a changed digit.

    Args:
        path: A file, or several, which make one recording; a target may continue in the next file.
        columns: Columns by their names or numbers (from 1): "time=..,id=..,x=..,y=..[,z=..]", or "lat=..,lon=.." in
            degrees; time_ms, time_us, time_ns and frame are times in other units. Without id, a file is a target.
        fps: Frames per second, where times are numbers of frames.
        scale: Metres per unit of x, y and z; metres per pixel on the ground for MOT challenge text.
        topics: Topics of a bag, by default all with poses.
        planar: Leave z out.
        origin: Place of the local coordinates on the map; by default near the fixes, where they are in degrees or far
            from zero (UTM).
    """
    paths = [Path(path)] if isinstance(path, str | PathLike) else [Path(each) for each in path]
    given = _given(columns, fps, scale, topics)
    made = _load(paths, given, origin)
    return _in_plane(made) if planar else made


def _given(
    columns: str | Mapping[str, str] | None, fps: float | None, scale: float | None, topics: Sequence[str]
) -> _Given:
    for name, value in (("fps", fps), ("scale", scale)):
        if value is not None and not 0 < value < float("inf"):
            raise InputError(f"{name} {value}: expected a positive number")
    given = _Given(columns=parsed_columns(columns), fps=fps, scale=scale, topics=tuple(topics))
    if "frame" in given.columns and fps is None:
        raise InputError("columns frame=..: the times are numbers of frames; give fps, frames per second")
    return given


def _load(paths: Sequence[Path], given: _Given, origin: OriginSettings | None) -> Recording:
    if not paths:
        raise InputError("recording: expected a file")
    collection, clock, kinds, digests = Collection(strict=len(paths) == 1), None, set(), []
    for each in paths:
        before = len(collection.blocks)
        clock, layout, digest = _read(each, given, collection, clock)
        kinds.add((layout is not None and layout.positions, collection.blocks[before].positions.shape[1]))
        digests.append(digest)
    if len(kinds) > 1:
        raise InputError(f"{paths[-1]}: other columns than {paths[0]}; files of one recording are of one kind")
    sha256 = digests[0] if len(paths) == 1 else hashlib.sha256("".join(digests).encode()).hexdigest()
    origin_s = (clock.origin_s or 0) if clock is not None else 0
    in_degrees = kinds.pop()[0] == "degrees"
    return collection.recording(", ".join(map(str, paths)), in_degrees, origin_s, origin, sha256)


def load_window(
    recording: Recording | AnyPath | Sequence[AnyPath], start_s: float | None, end_s: float | None
) -> Recording:
    """Cut a recording as `window` does; files are read first."""
    return window(recording if isinstance(recording, Recording) else load_recording(recording), start_s, end_s)


def _in_plane(recording: Recording) -> Recording:
    tracks = [replace(track, positions_m=track.positions_m[:, :2]) for track in recording.tracks]
    origin = recording.origin
    if origin is not None and origin.position_m:
        origin = replace(origin, position_m=origin.position_m[:2])
    return replace(recording, dimension=2, tracks=tuple(tracks), origin=origin)


def _read(path: Path, given: _Given, collection: Collection, clock: Clock | None) -> tuple[Clock, Layout | None, str]:
    """Add the fixes of one file; return the clock, the layout of a table, and the file's digest."""
    try:
        if is_bag(path):
            clock = clock or Clock("time_ns")
            digest = read_bag(path, given.topics, given.scale or 1.0, collection, clock)
            return clock, None, digest
        with path.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest() if path.is_file() else ""
            _check_sum(path, sha256)
            if sha256:
                file.seek(0)
            return *_read_table(path, file, given, collection, clock), sha256
    except IsADirectoryError:
        raise InputError(f"{path}: is a directory; give the path of a recording, a CSV file") from None
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the path of a recording, a CSV file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def _read_table(
    path: Path, file: BinaryIO, given: _Given, collection: Collection, clock: Clock | None
) -> tuple[Clock, Layout]:
    blocks, number = len(collection.blocks), 1
    try:
        number, line = _first_line(file)
        layout = layout_of(line.rstrip("\r\n"), given.columns, given.fps, given.scale)
        if clock is None:
            clock = Clock(layout.unit, given.fps)
        elif clock.unit not in (layout.unit, "time_iso", "time_s"):
            raise InputError("other units of time than the files before")
        first, at = ("", number + 1) if layout.has_header else (line, number)
        rows = RowReader(file, first, at, layout.delimiter, layout.names, not layout.strict)
        TableReader(layout, clock, given.scale or 1.0, collection, path.stem).read(rows)
        _check_meaning(collection.blocks[blocks:], layout, clock, given, rows.line)
    except InputError as error:
        place = "" if str(error).startswith(("line ", "the times", "the pos")) else f"line {number}: "
        raise InputError(f"{path}: {place}{error}") from None
    return clock, layout


def _check_meaning(blocks: list[Fixes], layout: Layout, clock: Clock, given: _Given, line: int) -> None:
    """Raise InputError for a file without rows, and for numbers that look like nanoseconds or pixels."""
    if not any(len(block.times_s) for block in blocks):
        raise InputError(f"line {line}: no rows; at least one row must follow the header")
    if clock.unit == "time_s" and all(whole_days(block.times_s) for block in blocks):
        raise InputError(
            "the times are whole numbers, days apart if they were seconds: they look like nanoseconds or "
            "microseconds; give --columns time_ns=.. (or time_us=..),id=..,x=..,y=.."
        )
    if clock.unit == "frame" and layout.positions == "metres" and given.scale is None:
        largest = max(float(np.abs(block.positions).max()) for block in blocks if len(block.positions))
        if largest > MAX_SCENE_M and all((2 * block.positions % 1 == 0).all() for block in blocks):
            raise InputError(
                f"the positions are whole numbers up to {largest:g}, as pixels are; give --scale METRES_PER_UNIT, 1 if "
                "they are metres"
            )


def _first_line(file: BinaryIO) -> tuple[int, str]:
    """The header or first row, and the number of its line; skips comments before it, except for names of columns."""
    number, line = 0, "#"
    while line.startswith("#") and not _names_columns(line):
        number += 1
        if (line := decoded_line(file, is_first=number == 1)) == "":
            raise InputError(f"the file is empty; {HEADER}")
    return number, line


def _names_columns(comment: str) -> bool:
    return "," in comment or comment.lstrip("# ").startswith("timestamp tx")


def _check_sum(path: Path, sha256: str) -> None:
    """Raise InputError where a checksum file beside the recording does not match it."""
    beside = path.with_name(f"{path.name}.sha256")
    if sha256 and beside.is_file() and read_text(beside, "SHA-256 sum").split()[:1] != [sha256]:
        raise InputError(f"{path}: is cut short, damaged or changed: {beside.name} says another SHA-256 sum")
