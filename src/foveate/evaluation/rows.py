"""Rows of an evaluation: one an episode."""

from dataclasses import asdict, dataclass
from typing import Any

SPECIAL = (
    *("contacts", "gospa", "gospa_localisation", "gospa_missed", "gospa_false", "dropped"),
    *("agents", "worst_score", "worst_objective", "members_nees"),
)
"""Fields of rows and summaries that only worlds of a kind have: obstacles, detections without ids, teams."""

NUMBERS = ("rmse_m", "nees", "log_det_mean")
"""Fields of rows that are numbers in every file."""


def with_numbers(record: dict[str, Any]) -> dict[str, Any]:
    """A row's record with 0 for the errors of no track: the format of the files knows no null there."""
    return {name: 0.0 if name in NUMBERS and value is None else value for name, value in record.items()}


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """A row of a table that a file holds, too."""

    def record(self) -> dict[str, Any]:
        """All fields as plain values; those of worlds of a kind only there."""
        return {name: value for name, value in asdict(self).items() if name not in SPECIAL or value is not None}


@dataclass(frozen=True, kw_only=True)
class Row(Recorded):
    """One episode of one method under one protocol.

    `score`: sum_j log det Y_K / targets [nat]; `entropy`: mean differential entropy at the end [nat]; both None
    without targets. `seen_fraction`: targets measured at least once; `seen_step_fraction`: measured targets among all
    targets of all steps; `longest_unseen_s`: the longest time without a measurement of any target. `rmse_m` and `nees`
    (consistent: the state's length) at the horizon, over all targets, over those seen and over those never seen (None
    without such targets). `step_time_s`: a single compiled decision on this machine. `objective`: score by what the
    experiment trains for: `score`, its mean over the steps, or `seen_step_fraction`; None if it trains for nothing.
    `contacts`: steps that an obstacle has ended; None without obstacles.

    With detections without ids, `score` is minus `gospa`, the mean GOSPA over the steps [m], whose parts are means too;
    errors and `nees` are those of confirmed tracks, each against the target that GOSPA pairs with it at the horizon,
    None (0 in a file) where it pairs none, and `dropped` counts detections and tracks for which there was no room. All
    None with ids.

    Of a team of `agents` robots the beliefs are those of one filter that hears every measurement at once.
    `worst_score` and `worst_objective` are the least that the own beliefs of any robot give, `members_nees` is the mean
    over all robots; None of a single robot.
    """

    scene: str
    episode: int
    seed: int
    method: str
    protocol: str
    motion: str
    targets: int
    score: float | None
    seen_fraction: float
    seen_step_fraction: float
    longest_unseen_s: float
    entropy: float | None
    rmse_m: float | None
    nees: float | None
    rmse_seen_m: float | None
    rmse_unseen_m: float | None
    nees_seen: float | None
    nees_unseen: float | None
    step_time_s: float
    objective: float | None = None
    contacts: int | None = None
    gospa: float | None = None
    gospa_localisation: float | None = None
    gospa_missed: float | None = None
    gospa_false: float | None = None
    dropped: int | None = None
    agents: int | None = None
    worst_score: float | None = None
    worst_objective: float | None = None
    members_nees: float | None = None

    def record(self) -> dict[str, Any]:
        """All fields as plain values; those of worlds of a kind only there, and 0 for the errors of no track."""
        return with_numbers(super().record())
