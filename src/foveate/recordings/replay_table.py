"""Table of a replay: means of each method over the starts."""

from collections.abc import Sequence

import numpy as np

from foveate.io.grouping import group_by
from foveate.io.tables import Table, counted
from foveate.recordings.replay import ReplayRow

COLUMNS: dict[str, tuple[str, str]] = {
    "in view": ("seen_time_fraction", ".1%"),
    "detected": ("seen_fraction", ".0%"),
    "longest gap [s]": ("longest_unseen_s", ".1f"),
    "log det [nat]": ("log_det_mean", ".2f"),
    "RMSE [m]": ("rmse_m", ".2f"),
    "NEES": ("nees", ".2f"),
    "NEES of detected": ("nees_seen", ".2f"),
    "NEES of undetected": ("nees_unseen", ".2f"),
    "lost": ("lost", ".1f"),
    "rejected": ("rejected", ".1f"),
    "contacts": ("contacts", ".1f"),
    "in obstacles": ("in_obstacles", ".1f"),
}
"""Heading of each mean in the table: the field of `ReplayRow`, and its format."""
DETAILS = ("NEES of detected", "NEES of undetected", "rejected")
NOTE = (
    "in view: share of all target-steps with a measurement. detected: tracks measured at least once. longest gap: the "
    "longest time without a measurement of any track. log det of the information, RMSE and NEES: means over tracks and "
    "steps. lost: tracks not in view at their end, with an error above the depth of the view."
)
OF_OBSTACLES = ("contacts", "in obstacles")
NOTE_OF_OBSTACLES = (
    " contacts: steps that an obstacle has ended. in obstacles: instants at which a recorded target is inside of one "
    "by the map."
)


def replay_table(recording: str, rows: Sequence[ReplayRow]) -> Table:
    """Means of each method over the starts, of the rows of a recording of this name."""
    by_method = group_by(rows, lambda row: row.method)
    has_obstacles = rows[0].contacts is not None
    shown = {name: column for name, column in COLUMNS.items() if has_obstacles or name not in OF_OBSTACLES}
    lines = [
        (method, *(_mean([getattr(row, name) for row in ours], form) for name, form in shown.values()))
        for method, ours in by_method.items()
    ]
    starts = counted(max(map(len, by_method.values())), "start")
    title = f"{recording}: {counted(rows[0].targets, 'track')}, mean of {starts}"
    note = NOTE + NOTE_OF_OBSTACLES * has_obstacles
    return Table(title=title, note=note, header=("method", *shown), rows=tuple(lines), details=DETAILS)


def _mean(values: Sequence[float | int | None], form: str) -> str:
    numbers = [value for value in values if value is not None]
    if numbers and all(isinstance(value, int) and value == numbers[0] for value in numbers):
        return str(numbers[0])  # a count is not shown as a mean
    return f"{np.mean(numbers):{form}}" if numbers else "-"
