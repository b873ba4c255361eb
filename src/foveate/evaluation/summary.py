"""Summarise rows of episodes: one summary a method, protocol, motion and number of targets."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from foveate.evaluation.metrics import chi_square_band
from foveate.evaluation.rows import Recorded, Row
from foveate.evaluation.statistics import mean_interval
from foveate.io.files import file_error, read_document, write_document
from foveate.io.grouping import group_by
from foveate.io.provenance import provenance

VERSION = 2
"""Version of the files of evaluations: 2 added `objective`."""

MEANS = (
    *("seen_fraction", "seen_step_fraction", "longest_unseen_s"),
    *("rmse_m", "rmse_seen_m", "rmse_unseen_m", "nees", "objective", "contacts"),
    *("gospa", "gospa_localisation", "gospa_missed", "gospa_false", "dropped"),
    *("worst_score", "worst_objective", "members_nees"),
)
"""Fields of a summary that are means of the same fields of rows."""

Band = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Summary(Recorded):
    """One cell: a method, a protocol, a motion, a number of targets.

    `std` is over episodes; `ci95` Student's 95 % interval of the mean, scenes taken as independent; `nees_band`
    holds 95 % of such means if the filter is consistent. For targets seen and targets never seen, `rmse_.._m` is the
    mean over the episodes that have some, `nees_..` the mean over all these targets; None without such targets.
    `normalised_score`: the mean on a scale from the lower bound, never seeing anything (0), to the omniscient
    planner's score (1); None unless requested. `objective`: mean score by the objective of the experiment's training;
    None without one. `contacts`: mean number of steps that an obstacle has ended; None without obstacles.
    GOSPA with its parts, and `dropped`: as in `Row`; None with ids. Without ids errors and NEES are means over the
    episodes with a confirmed track near a target, None without any.
    `agents`: robots of the team, `worst_..` and `members_nees`: means of the same fields of rows; None of one robot.
    """

    method: str
    protocol: str
    motion: str
    targets: int
    mean: float
    std: float
    ci95: tuple[float, float]
    seen_fraction: float
    seen_step_fraction: float
    longest_unseen_s: float
    rmse_m: float | None
    rmse_seen_m: float | None
    rmse_unseen_m: float | None
    nees: float | None
    nees_band: Band
    nees_seen: float | None
    nees_seen_band: Band | None
    nees_unseen: float | None
    nees_unseen_band: Band | None
    episodes: int
    normalised_score: float | None = None
    objective: float | None = None
    contacts: float | None = None
    gospa: float | None = None
    gospa_localisation: float | None = None
    gospa_missed: float | None = None
    gospa_false: float | None = None
    dropped: float | None = None
    agents: int | None = None
    worst_score: float | None = None
    worst_objective: float | None = None
    members_nees: float | None = None

    @property
    def deviation(self) -> float | None:
        """`std`; None of one episode, which says nothing of others."""
        return self.std if self.episodes > 1 else None

    @property
    def interval(self) -> tuple[float, float] | None:
        """`ci95`; None of one scene, which is its own interval in files, whatever its episodes."""
        is_single = self.ci95[0] == self.ci95[1] and (self.episodes == 1 or self.std > 0)
        return None if is_single else self.ci95


def summarise(rows: Sequence[Row], state_size: int) -> list[Summary]:
    """Summarise each cell, in order of first appearance, without the scenes that have no targets."""
    scored = [row for row in rows if row.score is not None]
    cells = group_by(scored, lambda row: (row.method, row.protocol, row.motion, row.targets))
    return [_summary(group, state_size) for group in cells.values()]


def scene_means(rows: Sequence[Row]) -> dict[str, float]:
    """Mean score of each scene [nat per target]: its episodes share a layout, so only scenes are independent."""
    scenes = group_by(rows, lambda row: row.scene)
    return {scene: float(np.mean(np.array([row.score for row in group], float))) for scene, group in scenes.items()}


def _summary(rows: Sequence[Row], state_size: int) -> Summary:
    scores = np.array([row.score for row in rows], float)
    first = rows[0]
    # Rows of several training seeds share their noise: for the width of NEES bands they count as one.
    share = len({(row.scene, row.episode) for row in rows}) / len(rows)
    measures: dict[str, Any] = {name: _mean(rows, name) for name in MEANS}
    for group in ("seen", "unseen"):
        measures[f"nees_{group}"], measures[f"nees_{group}_band"] = _group_nees(rows, group, share, state_size)
    return Summary(
        method=first.method,
        protocol=first.protocol,
        motion=first.motion,
        targets=first.targets,
        mean=float(scores.mean()),
        std=float(scores.std(ddof=1)) if len(scores) > 1 else 0.0,
        ci95=mean_interval(list(scene_means(rows).values())),
        nees_band=chi_square_band(state_size, first.targets * share * len(rows)),
        episodes=len(rows),
        agents=first.agents,
        **measures,
    )


def _mean(rows: Sequence[Row], name: str) -> float | None:
    """Mean over the rows that have this measure; None if none has."""
    values = [value for row in rows if (value := getattr(row, name)) is not None]
    return float(np.mean(values)) if values else None


def _group_nees(rows: Sequence[Row], group: str, share: float, state_size: int) -> tuple[float | None, Band | None]:
    """Mean NEES of all targets of a group ("seen" or "unseen"), and its band: a `share` of them is independent."""
    pairs = [(row, value) for row in rows if (value := getattr(row, f"nees_{group}")) is not None]
    if not pairs:
        return None, None
    fractions = [row.seen_fraction if group == "seen" else 1.0 - row.seen_fraction for row, _ in pairs]
    counts = np.array([fraction * row.targets for fraction, (row, _) in zip(fractions, pairs, strict=True)])
    mean = float(np.average([value for _, value in pairs], weights=counts))
    return mean, chi_square_band(state_size, share * float(counts.sum()))


def write_result(
    path: str | Path, rows: Sequence[Row], summary: Sequence[Summary], facts: Mapping[str, Any] = MappingProxyType({})
) -> None:
    """Write an evaluation as JSON: rows, summary, and the facts of its origin."""
    content = {"rows": [row.record() for row in rows], "summary": [cell.record() for cell in summary]}
    write_document(path, "evaluation", VERSION, {**provenance(), **facts, **content})


def read_result(path: str | Path) -> tuple[list[Row], dict[str, Any]]:
    """Read the rows of an evaluation and the facts of its origin.

    Raises InputError for a file that is missing, cut, damaged, newer, or something else.
    """
    content = read_document(path, "evaluation", VERSION, "result of foveate evaluate")
    try:
        rows = [Row(**row) for row in content.pop("rows")]
    except (KeyError, TypeError) as error:
        raise file_error(path, f"rows: are not those of an evaluation ({error})") from error
    return rows, {name: value for name, value in content.items() if name != "summary"}
