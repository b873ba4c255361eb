"""Layouts of text files: which column of a row is the time, the id and the position, and in which units."""

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from foveate.errors import InputError
from foveate.recordings.clock import Unit

OWN = ("time_s", "track_id", "x_m", "y_m", "z_m")
HEADER = "the header must be time_s,track_id,x_m,y_m or time_s,track_id,x_m,y_m,z_m"
TIMES: tuple[Unit, ...] = ("time", "time_s", "time_ms", "time_us", "time_ns", "frame")
KEYS = (*TIMES, "id", "x", "y", "z", "lat", "lon")
"""Keys of `--columns`."""
Positions = Literal["metres", "degrees", "box"]
"""Meaning of the position's columns; a box is left, top, width, height in pixels, of which the foot point counts."""

_SYNONYMS = {
    "time": r"(base)?_?(date)?_?(time|stamp|timestamp)(_?s|_?utc)?|date|ts|t|secs?|seconds",
    "frame": r"frame(_?(id|no|number|idx|index))?",
    "id": r"((track|object|obj|agent|target|vehicle|ped(estrian)?|person|animal|tag)_?)?id|mmsi|name|label|individual",
    "lat": r"lat(itude)?(_?deg)?|location[-_]lat",
    "lon": r"(lon|lng|long)(itude)?(_?deg)?|location[-_]long",
    "x": r"x(_?m)?|pos(ition)?_?x|easting|utm_?(e|x)|t_?x",
    "y": r"y(_?m)?|pos(ition)?_?y|northing|utm_?(n|y)|t_?y",
    "z": r"z(_?m)?|pos(ition)?_?z|alt(itude)?(_?m)?|height(_?m)?|t_?z",
}
_DEGREES = re.compile(r"(^|[^a-z])(lat|lon|lng|latitude|longitude)([^a-z]|$)|deg(rees)?$", re.IGNORECASE)
_PIXELS = re.compile(r"(^|[^a-z])(px|pix|pixels?|bb|bbox|left|top|xmin|ymin|u|v)([^a-z]|$)", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Columns of a text file; numbers of columns count from 0. No `identity`: the file is one target."""

    names: tuple[str, ...]
    """Names of all columns, as messages call them."""
    time: int
    unit: Unit
    identity: int | None
    position: tuple[int, ...]
    positions: Positions = "metres"
    delimiter: str | None = ","
    """None: any number of blanks and tabs."""
    has_header: bool = True
    strict: bool = False
    """Rows sorted by time, one for each time and track."""

    @property
    def dimension(self) -> int:
        """Numbers of a position."""
        return 2 if self.positions == "box" else len(self.position)


def parsed_columns(columns: str | Mapping[str, str] | None) -> dict[str, str]:
    """Columns by key, from "time=..,id=..,x=..,y=..". Raises InputError for unknown keys and missing ones."""
    if columns is None:
        return {}
    pairs = list(columns.items()) if isinstance(columns, Mapping) else [_pair(part) for part in columns.split(",")]
    given = dict(pairs)
    expected = "expected time=..,id=..,x=..,y=.. or lat=..,lon=.. with the file's names or numbers of columns"
    for key in given:
        if key not in KEYS:
            raise InputError(f"columns {key}=: unknown; {expected}; known are {', '.join(KEYS)}")
    times = [key for key in TIMES if key in given]
    if len(pairs) > len(given) or len(times) != 1:
        raise InputError(f"columns {','.join(key for key, _ in pairs)}: {expected}, one time, each once")
    planes = [plane for plane in (("x", "y"), ("lat", "lon")) if set(plane) & set(given)]
    if len(planes) != 1 or not set(planes[0]) <= set(given):
        raise InputError(f"columns {','.join(given)}: {expected}")
    return given


def _pair(part: str) -> tuple[str, str]:
    key, _, name = part.partition("=")
    return key.strip(), name.strip()


def layout_of(line: str, columns: Mapping[str, str], fps: float | None, scale: float | None) -> Layout:
    """Layout of a file that begins with this line. Raises InputError where it is not clear, with what would say it."""
    delimiter = _delimiter(line)
    fields = [field.strip() for field in _split(line.lstrip("#"), delimiter)]
    if columns:
        return _mapped(fields, columns, delimiter, scale)
    own = tuple(fields)
    if delimiter == "," and own in (OWN[:4], OWN):
        return Layout(names=own, time=0, unit="time_s", identity=1, position=tuple(range(2, len(own))), strict=True)
    is_data = bool(fields) and all(map(_is_number, fields))
    if is_data and delimiter == "," and 7 <= len(fields) <= 10:
        return _mot(len(fields), fps, scale)
    if (is_data and len(fields) == 8) or _split(line.lstrip("# "), None)[:4] == ["timestamp", "tx", "ty", "tz"]:
        names = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
        return Layout(names=names, time=0, unit="time_s", identity=None, position=(1, 2, 3), delimiter=None,
                      has_header=not is_data)  # fmt: skip
    if is_data and len(fields) == 4 and (fps is not None or delimiter != ","):
        if fps is None:
            raise InputError(
                "four numbers a row and no header, as frame,id,x,y; give --fps FRAMES_PER_S (and --scale METRES where "
                "x and y are no metres), or name the columns: --columns time=1,id=2,x=3,y=4"
            )
        names = ("frame", "id", "x", "y")
        return Layout(names=names, time=0, unit="frame", identity=1, position=(2, 3), has_header=False,
                      delimiter=None if delimiter == "\t" else delimiter)  # fmt: skip
    raise InputError(_unknown(own, is_data))


def _mot(fields: int, fps: float | None, scale: float | None) -> Layout:
    if fps is None or scale is None:
        raise InputError(
            "frame,id,left,top,width,height,.. in pixels, as MOT challenge text; give --fps FRAMES_PER_S and --scale "
            "METRES_PER_PIXEL of the ground, or convert it to time_s,track_id,x_m,y_m by the camera's homography"
        )
    names = ("frame", "id", "left", "top", "width", "height", "conf", "class", "visibility", "z")[:fields]
    return Layout(names=names, time=0, unit="frame", identity=1, position=(2, 3, 4, 5), positions="box",
                  has_header=False)  # fmt: skip


def _mapped(fields: list[str], columns: Mapping[str, str], delimiter: str | None, scale: float | None) -> Layout:
    """Layout by the names, or the numbers from 1, of the file's columns."""
    place, by_number = {}, all(name.isdecimal() for name in columns.values())
    for key, name in columns.items():
        if name in fields and not by_number:
            place[key] = fields.index(name)
        elif name.isdecimal() and 1 <= int(name) <= len(fields):
            place[key] = int(name) - 1
        else:
            raise InputError(f"columns {key}={name}: no such column; the file has {','.join(fields)[:200]}")
    first = fields[place["lat" if "lat" in place else "x"]]
    is_header = not by_number or not _is_number(first)
    for key in ("x", "y"):
        name = fields[place[key]] if key in place and is_header else ""
        if _DEGREES.search(name):
            raise InputError(f"columns {key}={name}: looks like degrees, not metres; give lat=..,lon=..")
        if _PIXELS.search(name) and scale is None:
            raise InputError(f"columns {key}={name}: looks like pixels, not metres; give --scale METRES_PER_PIXEL")
    plane = ("lat", "lon") if "lat" in place else ("x", "y")
    unit: Unit = next(each for each in TIMES if each in columns)
    return Layout(
        names=tuple(fields) if is_header else tuple(f"column {i + 1}" for i in range(len(fields))),
        time=place[unit],
        unit=unit,
        identity=place.get("id"),
        position=tuple(place[key] for key in (*plane, "z") if key in place),
        positions="degrees" if "lat" in place else "metres",
        delimiter=delimiter,
        has_header=is_header,
    )  # fmt: skip


def _unknown(fields: tuple[str, ...], is_data: bool) -> str:
    """What is wrong with a header, and the options by which the file could be read."""
    problem = f"the columns {','.join(fields)[:80]} are out of order"
    if unexpected := [name for i, name in enumerate(fields) if name not in OWN or name in fields[:i]]:
        problem = f"unexpected column {quoted(unexpected[0])}"
    elif missing := [name for name in OWN[:4] if name not in fields]:
        problem = f"column {missing[0]!r} is missing"
    if is_data:
        return f"{problem}; {HEADER}, or give --columns time=1,id=2,x=3,y=4"
    return f"{problem}; {HEADER}, or give --columns {_suggestion(fields)}"


def _suggestion(fields: tuple[str, ...]) -> str:
    found = {key: next((name for name in fields if re.fullmatch(pattern, name, re.IGNORECASE)), None)
             for key, pattern in _SYNONYMS.items()}  # fmt: skip
    time = "frame" if found["frame"] and not found["time"] else "time"
    plane = ("lat", "lon") if found["lat"] and found["lon"] else ("x", "y")
    keys = (time, "id", *plane, *(["z"] if found["z"] and plane == ("x", "y") else []))
    rate = " --fps FRAMES_PER_S" if time == "frame" else ""
    return ",".join(f"{key}={(found[key] or '..')[:30]}" for key in keys) + rate


def _delimiter(line: str) -> str | None:
    return next((each for each in (",", "\t", ";") if each in line), None if line.strip() else ",")


def _split(line: str, delimiter: str | None) -> list[str]:
    try:
        return line.split() if delimiter is None else next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:  # as a carriage return in a name; the reader of the rows says where
        return [line]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def quoted(text: str) -> str:
    """`text` in quotes, cut to fit in a line."""
    return repr(text if len(text) <= 40 else text[:37] + "...")
