"""Times of a file's rows as seconds: counted from zero or from 1970, ISO 8601, or numbers of frames.

A clock that counts from 1970 resolves 0.2 us in float64, and no decimal fraction exactly. So whole seconds are
subtracted from the digits before they become floats: the same recording by a clock from zero gives the same numbers.
"""

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from foveate.errors import InputError

Unit = Literal["time", "time_s", "time_ms", "time_us", "time_ns", "frame"]
"""Unit of a column of times, as `--columns` names it; "time" is ISO 8601 or seconds, whichever it finds."""

MAX_SECONDS = 1e11
"""Larger numbers are no seconds: the year 5138 by a clock from 1970; milliseconds have passed it in 1973."""
MAX_MAGNITUDE = 1e12  # s or m: squares stay finite, and a float64 clock still resolves 0.2 ms
SINCE_1970 = 1e8
"""Least number of seconds of a clock that is taken to count from 1970 (in 1973)."""

_PARTS = {"time_ms": 10**3, "time_us": 10**6, "time_ns": 10**9}
_EPOCH, _SECOND = datetime(1970, 1, 1, tzinfo=UTC), timedelta(seconds=1)
_COMPACT = re.compile(r"^\d{4}-?\d\d-?\d\d[T ]")


class Clock:
    """Turns the texts of times into seconds after `origin_s`, which the first of them sets.

    `origin_s` [s] is 0 for a clock that does not count from 1970. `notes` says what was taken for granted.
    """

    def __init__(self, unit: Unit, fps: float | None = None) -> None:
        self.unit, self._fps = unit, fps
        self.origin_s: int | None = None
        self.notes: tuple[str, ...] = ()

    def seconds(self, texts: Sequence[str]) -> Float[np.ndarray, " rows"]:
        """Seconds after `origin_s`; ValueError where a text is no time, InputError where it has another unit."""
        if self.unit == "time":
            self.unit = "time_iso" if _COMPACT.match(texts[0].strip()) else "time_s"
        if self.unit == "time_iso":
            return self._of_dates([text.strip() for text in texts])
        if self.unit in _PARTS:
            return self._of_parts(texts, _PARTS[self.unit])
        numbers = np.array(list(map(float, texts)))
        if self.unit == "frame":
            assert self._fps is not None, "whoever asks for frames gives their rate"
            self._begin(0)
            return numbers / self._fps
        if np.isfinite(numbers[0]) and np.abs(numbers[0]) >= MAX_SECONDS:
            raise InputError(_looks_like(texts[0], numbers[0]))
        origin_s = self._begin(int(numbers[0]) if SINCE_1970 <= numbers[0] < MAX_SECONDS else 0)
        if not origin_s:
            return numbers
        if "e" in (whole := "".join(texts)) or "E" in whole or not np.isfinite(numbers).all():
            return numbers - origin_s
        return np.array([_after(text, origin_s) for text in texts])

    def after_origin(self, stamps_ns: Int[np.ndarray, " rows"]) -> Float[np.ndarray, " rows"]:
        """Seconds of stamps in whole nanoseconds."""
        first_s = int(stamps_ns[0]) // 10**9
        return (stamps_ns - 10**9 * self._begin(first_s if first_s >= SINCE_1970 else 0)) / 1e9

    def _begin(self, origin_s: int) -> int:
        if self.origin_s is None:
            self.origin_s = origin_s
        return self.origin_s

    def _of_dates(self, texts: Sequence[str]) -> Float[np.ndarray, " rows"]:
        times = list(map(datetime.fromisoformat, texts))
        if all(time.tzinfo is None for time in times):
            self.notes = ("times without a zone are taken as UTC",)
            times = [time.replace(tzinfo=UTC) for time in times]
        if any(time.tzinfo is None for time in times):
            raise InputError("some times have a zone and some have none; give all of them one, as 2026-03-29T01:05:07Z")
        origin = _EPOCH + timedelta(seconds=self._begin((times[0] - _EPOCH) // _SECOND))
        return np.array([(time - origin) / _SECOND for time in times])

    def _of_parts(self, texts: Sequence[str], parts: int) -> Float[np.ndarray, " rows"]:
        try:
            numbers = list(map(int, texts))
        except ValueError:  # written as floats
            floats = np.array(list(map(float, texts))) / parts
            first = float(floats[0])
            return floats - self._begin(int(first) if SINCE_1970 <= first < MAX_SECONDS else 0)
        first_s = numbers[0] // parts
        origin = parts * self._begin(first_s if first_s >= SINCE_1970 else 0)
        return np.array([number - origin for number in numbers], float) / parts


def whole_days(times_s: Float[np.ndarray, " fixes"]) -> bool:
    """True for whole seconds that lie days apart: of a clock in nanoseconds that does not count from 1970."""
    steps = np.diff(np.unique(times_s))
    return len(steps) > 1 and float(np.median(steps)) >= 1e6 and bool((times_s == np.round(times_s)).all())


def _after(text: str, origin_s: int) -> float:
    whole, dot, rest = text.strip().partition(".")
    seconds = int(whole) - origin_s
    return float(f"{seconds}{dot}{rest}") if seconds >= 0 else seconds + float(f"0.{rest or 0}")


def _looks_like(text: str, number: float) -> str:
    """Message for a number that is too large for seconds."""
    names = {"ns": ("nanoseconds", 1e17), "us": ("microseconds", 1e14), "ms": ("milliseconds", MAX_SECONDS)}
    short, name = next((short, name) for short, (name, least) in names.items() if abs(number) >= least)
    power = len(str(_PARTS[f"time_{short}"])) - 1
    remedy = f"divide by 1e{power}, or give --columns time_{short}=COLUMN,id=..,x=..,y=.."
    return f"{text.strip()[:40]!r} looks like {name} since 1970, not seconds; {remedy}"
