"""The table of an evaluation: for each cell the score with its interval, the share detected, and consistency."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from foveate.evaluation.metrics import MEANINGS
from foveate.evaluation.summary import Summary
from foveate.io.grouping import group_by
from foveate.io.tables import Table
from foveate.names import Objective


def number(value: float | None, digits: int = 2) -> str:
    """A number; "-" for None."""
    return "-" if value is None else f"{value:.{digits}f}"


def plus_minus(mean: float, interval: tuple[float, float] | None, sign: str = "") -> str:
    """A mean ± half of its interval; "-" in place of an unknown one."""
    return f"{mean:{sign}.2f} ± {number(None if interval is None else (interval[1] - interval[0]) / 2)}"


def _nees(cell: Summary) -> str:
    return f"{number(cell.nees, 1)} ({cell.nees_band[0]:.1f}-{cell.nees_band[1]:.1f})"


COLUMNS: dict[str, Callable[[Summary], str]] = {
    "method": lambda cell: cell.method,
    "protocol": lambda cell: cell.protocol,
    "motion": lambda cell: cell.motion,
    "targets": lambda cell: str(cell.targets),
    "objective": lambda cell: number(cell.objective, 3),
    "score [nat]": lambda cell: plus_minus(cell.mean, cell.interval),
    "worst robot": lambda cell: number(cell.worst_score if cell.worst_objective is None else cell.worst_objective),
    "normalised": lambda cell: number(cell.normalised_score, 3),
    "GOSPA [m]": lambda cell: plus_minus(cell.gospa or 0.0, cell.interval),
    "errors": lambda cell: number(cell.gospa_localisation),
    "missed": lambda cell: number(cell.gospa_missed),
    "false": lambda cell: number(cell.gospa_false),
    "detected": lambda cell: f"{cell.seen_fraction:.0%}",
    "NEES (band)": _nees,
    "contacts": lambda cell: number(cell.contacts),
    "std": lambda cell: number(cell.deviation),
    "in view": lambda cell: f"{cell.seen_step_fraction:.0%}",
    "longest gap [s]": lambda cell: f"{cell.longest_unseen_s:.1f}",
    "RMSE [m]": lambda cell: number(cell.rmse_m),
    "NEES of detected": lambda cell: number(cell.nees_seen, 1),
    "NEES of robots": lambda cell: number(cell.members_nees, 1),
    "NEES of undetected": lambda cell: number(cell.nees_unseen, 1),
    "episodes": lambda cell: str(cell.episodes),
}
"""Text of every column."""
DETAILS = tuple(COLUMNS)[list(COLUMNS).index("std") :]
KEYS = ("method", "protocol", "motion", "targets")

NOTES = {
    "motion": "unbiased: targets without a drift; biased: with one.",
    "score [nat]": "score: log det of the information per target at the end, mean ± half of its 95 % interval; more "
    "is better.",
    "normalised": "normalised: 0 for never seeing a target, 1 for the omniscient planner, a reference and no bound.",
    "detected": "detected: targets measured at least once.",
    "worst robot": "score and NEES: by all measurements of the team; worst robot: by its own beliefs.",
    "contacts": "contacts: steps that an obstacle has ended.",
    "GOSPA [m]": "GOSPA: of confirmed tracks, the mean over the steps, with its parts; less is better.",
    "NEES (band)": "NEES: within its 95 % band, in brackets, if the filter is consistent; above it if overconfident, "
    "below it if underconfident.",
}
"""Meanings of columns, for the note below the table."""


def summary_tables(title: str, summary: Sequence[Summary], objective: Objective | None) -> tuple[Table, ...]:
    """Summary as a table a protocol, which its title names; only the last has a note."""
    cells = group_by(summary, lambda cell: cell.protocol)
    tables = [summary_table(f"{title}, {name} protocol", cells[name], objective) for name in cells]
    return (*(replace(table, note="") for table in tables[:-1]), *tables[-1:])


def summary_table(title: str, summary: Sequence[Summary], objective: Objective | None) -> Table:
    """Summary as a table, one line a cell; without the protocol and motion where all cells have the same.

    The score by the objective "terminal" is the score itself.
    """
    has_gospa = any(cell.gospa is not None for cell in summary)
    shown = {
        "protocol": len({cell.protocol for cell in summary}) > 1,
        "motion": len({cell.motion for cell in summary}) > 1,
        "objective": objective not in (None, "terminal", "gospa") and not has_gospa,
        "normalised": any(cell.normalised_score is not None for cell in summary),
        "contacts": any(cell.contacts is not None for cell in summary),
        **dict.fromkeys(("GOSPA [m]", "errors", "missed", "false"), has_gospa),
        **dict.fromkeys(("score [nat]", "NEES (band)"), not has_gospa),
        "worst robot": any(cell.worst_score is not None for cell in summary),
        "NEES of robots": any(cell.members_nees is not None for cell in summary),
    }
    header = tuple(name for name in COLUMNS if shown.get(name, True))
    trained_for = [f"objective: {MEANINGS[objective]}, as trained for."] if objective and shown["objective"] else []
    return Table(
        title=title,
        note=" ".join([*trained_for, *(NOTES[name] for name in header if name in NOTES)]),
        header=header,
        rows=tuple(tuple(COLUMNS[name](cell) for name in header) for cell in summary),
        keys=sum(name in KEYS for name in header),
        details=DETAILS,
    )
