"""Fixes of the rows of a text file, by its layout; says on which line something is wrong."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from foveate.errors import InputError
from foveate.recordings.clock import MAX_MAGNITUDE, Clock
from foveate.recordings.fixes import Collection, Fixes
from foveate.recordings.layout import Layout, quoted
from foveate.recordings.rows import RowReader

Columns = list[Sequence[str]]


class TableReader:
    """Adds the rows of one file to a collection."""

    def __init__(self, layout: Layout, clock: Clock, scale: float, collection: Collection, stem: str) -> None:
        self._layout, self._clock, self._scale, self._stem = layout, clock, scale, stem
        self._collection = collection
        self._names: dict[str, int] = {}  # index of the track by its text in this file
        self._latest_s, self._last_s = -np.inf, np.zeros(0)  # of all tracks, and of each, of sorted rows
        self._ignored, self._unplaced = 0, 0
        collection.strict &= layout.strict

    def read(self, rows: RowReader) -> None:
        """Read all rows. Raises InputError, without the name of the file, for the first wrong one."""
        for block in rows:
            self._add(block.columns, block.starts, block.has_underscores)
        notes, layout = self._collection.notes, self._layout
        notes += self._clock.notes
        if layout.positions == "box":
            notes.append("positions are the foot points of boxes: x to the right, y up the image")
        if self._ignored:
            notes.append(f"{self._ignored} rows have conf 0, which MOT challenge ignores")
        if self._unplaced:
            notes.append(f"{self._unplaced} rows have no position (latitude 91, longitude 181)")

    def _add(self, columns: Columns, starts: Int[np.ndarray, " rows"], has_underscores: bool = True) -> None:
        if not len(starts):
            return
        layout, numbers = self._layout, []
        try:
            times = self._clock.seconds(columns[layout.time])
            numbers = [_floats(columns[i], has_underscores) for i in layout.position]
            ok = all((np.abs(each) <= MAX_MAGNITUDE).all() for each in (times, *numbers))
            ok = ok and not (has_underscores and "_" in "".join(columns[layout.time]))
        except InputError as error:
            raise self._at(starts[0], f"{layout.names[layout.time]} {error}") from None
        except (ValueError, OverflowError):
            times, ok = np.zeros(0), False
        if not ok:
            self._find(columns, starts)
        owners = self._owners(columns, starts)
        if layout.strict:
            self._check_order(times, owners, columns, starts)
        self._keep(times, owners, np.stack(numbers, axis=1), columns, starts)

    def _find(self, columns: Columns, starts: np.ndarray) -> None:
        """Raise for the first row with a wrong time or number; rows before it are checked in full first."""
        for i in range(len(starts)):
            for column in (self._layout.time, *self._layout.position):
                if (problem := self._problem(columns[column][i], column)) is not None:
                    self._add([texts[:i] for texts in columns], starts[:i])
                    raise self._at(starts[i], problem)

    def _problem(self, text: str, column: int) -> str | None:
        name, is_time = self._layout.names[column], column == self._layout.time
        try:
            value = self._clock.seconds([text])[0] if is_time else _floats([text])[0]
        except InputError as error:
            return f"{name} {error}"
        except (ValueError, OverflowError):
            value = np.nan
        # Python reads "1_000" as a number, a recording does not; NaN fails the comparison.
        if -MAX_MAGNITUDE <= value <= MAX_MAGNITUDE and not (is_time and "_" in text):
            return None
        if is_time and self._clock.unit == "time_iso":
            return f"{name} is {quoted(text)}; it must be a time as 2026-03-29T01:05:07Z"
        unit = "seconds" if is_time else "degrees" if self._layout.positions == "degrees" else "metres"
        right = f"a finite number of {unit}, at most {MAX_MAGNITUDE:g} in size"
        return f"{name} is {quoted(text)}; it must be {right}"

    def _owners(self, columns: Columns, starts: np.ndarray) -> Int[np.ndarray, " rows"]:
        """Index of each row's track; a new id is checked."""
        if self._layout.identity is None:
            return np.full(len(columns[0]), self._collection.owner(self._stem))
        texts, known = columns[self._layout.identity], self._names
        for text in dict.fromkeys(texts):
            if text not in known:
                known[text] = self._collection.owner(self._checked(text, texts, starts))
        return np.array([known[text] for text in texts])

    def _checked(self, text: str, texts: Sequence[str], starts: np.ndarray) -> str:
        name = text.strip()
        if self._layout.unit == "frame" and name.endswith(".0") and name[:-2].lstrip("-").isdecimal():
            name = name[:-2]  # trajectory predictors write 1.0 for pedestrian 1
        if not name or not name.isprintable():
            column = self._layout.names[self._layout.identity or 0]
            right = "it must be a name or number of printable characters"
            raise self._at(starts[list(texts).index(text)], f"{column} is {quoted(name)}; {right}")
        if self._layout.positions == "box" and name.startswith("-"):
            raise self._at(
                starts[list(texts).index(text)], f"id is {name}: detections without ids; run a tracker first"
            )
        return name

    def _check_order(self, times: np.ndarray, owners: np.ndarray, columns: Columns, starts: np.ndarray) -> None:
        """Raise for the first row that is not in the order of times, or repeats the time of its track."""
        before = np.concatenate([[self._latest_s], times[:-1]])
        self._last_s = np.append(self._last_s, np.full(len(self._collection.index_of) - len(self._last_s), -np.inf))
        order = np.argsort(owners, kind="stable")
        own = np.concatenate([[np.nan], times[order][:-1]])
        begins = np.concatenate([[True], np.diff(owners[order]) != 0])
        own[begins] = self._last_s[owners[order][begins]]
        repeats = np.zeros(len(times), bool)
        repeats[order] = own == times[order]
        if (wrong := (times < before) | repeats).any():
            i = int(np.argmax(wrong))
            time_s, origin_s = columns[self._layout.time][i], self._clock.origin_s or 0
            shown = repr(float(time_s))
            if times[i] < before[i]:
                raise self._at(starts[i], f"time_s {shown} comes after {float(before[i]) + origin_s!r}; "
                               "rows must be sorted by time")  # fmt: skip
            track_id = list(self._collection.index_of)[owners[i]]
            raise self._at(
                starts[i],
                f"track_id {track_id!r} has two rows at time_s {shown}; there must be one row for each time and track",
            )
        self._latest_s = times[-1]
        np.maximum.at(self._last_s, owners, times)

    def _keep(
        self, times: np.ndarray, owners: np.ndarray, numbers: np.ndarray, columns: Columns, starts: np.ndarray
    ) -> None:
        layout, kept = self._layout, np.ones(len(times), bool)
        if layout.positions == "box":
            left, top, width, height = numbers.T
            # The foot point; the rows of an image count downwards.
            numbers = np.column_stack([left + 0.5 * width, -(top + height)])
            if "conf" in layout.names:
                kept = _floats(columns[layout.names.index("conf")]) != 0
                self._ignored += int((~kept).sum())
        if layout.positions == "degrees":
            kept = (numbers[:, 0] != 91) | (numbers[:, 1] != 181)  # as AIS says: not available
            self._unplaced += int((~kept).sum())
            wrong = kept & ((np.abs(numbers[:, 0]) > 89) | (numbers[:, 1] < -180) | (numbers[:, 1] > 360))
            if wrong.any():
                pair = numbers[np.argmax(wrong), :2].tolist()
                right = "expected -89 to 89, and -180 to 360 degrees"
                raise self._at(starts[np.argmax(wrong)], f"latitude and longitude {pair}: {right}")
        else:
            numbers = self._scale * numbers
        self._collection.blocks.append(Fixes(times_s=times[kept], owners=owners[kept], positions=numbers[kept]))

    def _at(self, line: np.integer, problem: str) -> InputError:
        return InputError(f"line {line}: {problem}")


def _floats(texts: Sequence[str], has_underscores: bool = True) -> Float[np.ndarray, " rows"]:
    """Numbers of texts; ValueError for one that is none, as "1_0", which Python would read."""
    if has_underscores and "_" in "".join(texts):
        raise ValueError
    return np.fromiter(map(float, texts), float, len(texts))
