"""Parts of a recording in time: one to train on, one to choose among policies, one to judge the chosen one.

The best of several seeds on the scenes that also judge it is flattered by chance. So the parts follow one another, and
share no fix. A target that is present at a border belongs to both sides, each with its own fixes.
"""

from collections.abc import Sequence
from math import isfinite

import numpy as np

from foveate.errors import InputError
from foveate.io.validate import require
from foveate.names import PARTS, Part
from foveate.recordings.recording import Recording, window

Shares = tuple[float, float, float]
"""Shares of the time to train, to choose and to judge; they add up to 1."""


def parsed_split(split: str | Sequence[float]) -> Shares:
    """Shares from "60,20,20" or three numbers, of any sum. Raises InputError for others."""
    parts = split.split(",") if isinstance(split, str) else list(split)
    try:
        numbers = [float(part) for part in parts]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != 3 or not all(isfinite(x) and x > 0 for x in numbers):
        shown = split if isinstance(split, str) else ",".join(map(str, parts))
        raise InputError(f"split {shown}: expected three shares > 0, to train, choose and judge, as 60,20,20")
    train, choose, judge = (x / sum(numbers) for x in numbers)
    return train, choose, judge


def part_of(recording: Recording, shares: Shares, part: Part) -> Recording:
    """Cut one part out of a recording. Raises InputError where it has no fix."""
    require(part in PARTS, "part", part, f"expected one of {', '.join(PARTS)}")
    i = PARTS.index(part)
    span_s = recording.end_s - recording.start_s
    first_s, end_s = (recording.start_s + span_s * sum(shares[:k]) for k in (i, i + 1))
    # The border itself belongs to the later part.
    return window(recording, first_s if i else None, None if part == PARTS[-1] else float(np.nextafter(end_s, -np.inf)))


def span_of(recording: Recording) -> str:
    """First and last time in words, by the recording's own clock."""
    first, last = (time_s + recording.clock_origin_s for time_s in (recording.start_s, recording.end_s))
    return f"{first:.10g} to {last:.10g} s"
