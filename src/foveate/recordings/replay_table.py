"""Table of a replay: means of each method over the starts."""

from collections.abc import Sequence

import numpy as np

from foveate.evaluation.statistics import mean_interval
from foveate.evaluation.summary_table import plus_minus
from foveate.io.grouping import group_by
from foveate.io.tables import Table, counted
from foveate.recordings.measures import ReplayRow

GOSPA = "GOSPA [m]"
COLUMNS: dict[str, tuple[str, str]] = {
    GOSPA: ("gospa", ".2f"),
    "errors": ("gospa_localisation", ".2f"),
    "missed": ("gospa_missed", ".2f"),
    "false": ("gospa_false", ".2f"),
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
    "dropped": ("dropped", ".1f"),
    "robots": ("agents", ".1f"),
    "worst log det": ("worst_log_det_mean", ".2f"),
    "robots' NEES": ("members_nees", ".2f"),
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
WITHOUT_IDS = (GOSPA, "errors", "missed", "false", "dropped")
"""Columns of detections without ids alone."""
DETAILS_WITHOUT_IDS = ("longest gap [s]", "log det [nat]", "RMSE [m]", "NEES", "dropped")
NOTE_WITHOUT_IDS = (
    "GOSPA: of confirmed tracks, the mean over the steps, with its parts, and of several starts ± half of its 95 % "
    "interval; less is better. in view: share of all target-steps with a detection. detected: targets detected at "
    "least once. lost: targets not in view at their end, with no confirmed track within the depth of the view. log det "
    "of the information, RMSE and NEES: of tracks that are paired with a target."
)
OF_OBSTACLES = ("contacts", "in obstacles")
NOTE_OF_OBSTACLES = (
    " contacts: steps that an obstacle has ended. in obstacles: instants at which a recorded target is inside of one "
    "by the map."
)
OF_TEAMS = ("robots", "worst log det", "robots' NEES")
NOTE_OF_TEAMS = (
    " Of a team these are of all measurements; worst log det: the least that the own beliefs of any robot give; "
    "robots' NEES: that of their own beliefs."
)
ROBOT_COLUMNS: dict[str, tuple[str, str]] = {
    "in view": ("seen_time_fraction", ".1%"),
    "log det [nat]": ("log_det_mean", ".2f"),
    "NEES": ("nees", ".2f"),
    "heard": ("heard_fraction", ".1%"),
}
"""Heading of each mean in the table of robots: the field of `RobotRow`, and its format."""
NOTE_OF_ROBOTS = (
    "in view: share of all target-steps that the robot has measured itself. log det and NEES: of its own beliefs. "
    "heard: share of the other robots' messages that have reached it."
)


def replay_table(recording: str, rows: Sequence[ReplayRow]) -> Table:
    """Means of each method over the starts, of the rows of a recording of this name."""
    by_method = group_by(rows, lambda row: row.method)
    has_ids, in_map = rows[0].gospa is None, rows[0].contacts is not None
    in_team = rows[0].agents is not None
    left_out = {
        *(WITHOUT_IDS if has_ids else DETAILS),
        *(() if in_map else OF_OBSTACLES),
        *(() if in_team else OF_TEAMS),
    }
    shown = [name for name in COLUMNS if name not in left_out]
    lines = [(method, *(_text(ours, name) for name in shown)) for method, ours in by_method.items()]
    starts = counted(max(map(len, by_method.values())), "start")
    title = f"{recording}: {counted(rows[0].targets, 'track')}, mean of {starts}"
    note, details = (NOTE, DETAILS) if has_ids else (NOTE_WITHOUT_IDS, DETAILS_WITHOUT_IDS)
    note += NOTE_OF_OBSTACLES * in_map + NOTE_OF_TEAMS * in_team
    return Table(title=title, note=note, header=("method", *shown), rows=tuple(lines), details=details)


def robots_table(recording: str, rows: Sequence[ReplayRow]) -> Table | None:
    """Means over the starts for every robot of a team under each method; None of a single robot."""
    lines = []
    for method, ours in group_by(rows, lambda row: row.method).items():
        for m, robot in enumerate(zip(*(row.robots or () for row in ours), strict=True)):
            means = [_mean([getattr(each, field) for each in robot], form) for field, form in ROBOT_COLUMNS.values()]
            lines.append((method, str(m + 1), *means))
    if not lines:
        return None
    header = ("method", "robot", *ROBOT_COLUMNS)
    return Table(title=f"{recording}: each robot", note=NOTE_OF_ROBOTS, header=header, rows=tuple(lines), keys=2)


def _text(rows: Sequence[ReplayRow], name: str) -> str:
    """Mean over the starts; of GOSPA with its interval, if there are several."""
    field, form = COLUMNS[name]
    values = [getattr(row, field) for row in rows]
    if name == GOSPA and len(rows) > 1:
        return plus_minus(float(np.mean(values)), mean_interval(values))
    return _mean(values, form)


def _mean(values: Sequence[float | int | None], form: str) -> str:
    numbers = [value for value in values if value is not None]
    if numbers and all(isinstance(value, int) and value == numbers[0] for value in numbers):
        return str(numbers[0])  # a count is not shown as a mean
    return f"{np.mean(numbers):{form}}" if numbers else "-"
