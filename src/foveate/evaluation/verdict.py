"""The verdict of a training: the score that was trained for, of its policy, every heuristic and a planner."""

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from html import escape
from pathlib import Path
from typing import Any, Literal, get_args

from foveate.errors import InputError
from foveate.evaluation.held_out import HeldOut, Scores, held_out, planner_scores, planning_work, policy_scores
from foveate.evaluation.metrics import DIGITS, MEANINGS
from foveate.evaluation.rivals import compared
from foveate.evaluation.summary_table import number
from foveate.experiment.checkpoint import load_run
from foveate.experiment.experiment import Experiment
from foveate.experiment.run_folder import VERDICT
from foveate.io.files import read_document, write_document
from foveate.io.progress import Bar
from foveate.io.provenance import provenance
from foveate.io.records import from_table
from foveate.io.tables import Table, html, text
from foveate.names import Objective, ProtocolName
from foveate.planning.shooting import ONLINE, PlanSettings
from foveate.simulation.records import Policy
from foveate.simulation.suites import SUITE_SEED

VERSION = 1
"""Of the files of verdicts."""

EPISODES, LEAST_EPISODES = 128, 32
"""Held-out episodes of the policy and the heuristics, and the least where they are long."""

TARGET_STEPS = 100_000
"""Steps of targets in all these episodes: the slowest heuristic, `window`, simulates 300 of its own for each."""

PLANNER_SIZES = ((16, 16), (12, 16), (8, 16), (8, 8), (8, 4), (8, 2), (8, 1), (4, 1))
"""Episodes and starts of the planner, from the most work to the least."""

PLANNER_WORK = 2e8
"""Most work of the planner, in units of `planning_work`: ten seconds of one core."""

CLEAR = 2.0
"""A difference of this many standard errors is clear."""

Kind = Literal["policy", "heuristic", "planner"]


@dataclass(frozen=True, kw_only=True)
class VerdictRow:
    """A method in the first `episodes` held-out episodes: mean score and its standard error.

    `difference` is the policy's score minus this method's, the mean over the same episodes, with its standard error;
    None for the policy itself. A team's policy has a row for each rule that assigns targets, too.
    """

    method: str
    kind: Kind
    mean: float
    se: float
    episodes: int
    difference: float | None = None
    difference_se: float | None = None

    @property
    def is_clearly_beaten(self) -> bool:
        """True where the policy is better by at least two standard errors of the difference."""
        if self.difference is None or self.difference_se is None:
            return False
        return self.difference > 0 and self.difference >= CLEAR * self.difference_se


@dataclass(frozen=True, kw_only=True, repr=False)
class Verdict:
    """The score by the `objective` of a training, under the `protocol` of its validation, of all methods.

    The scenes neither trained nor selected the policy, and are the same for every method, with the same noise. `rows`
    begin with the policy. `no_planner` says why there is no planner; empty where there is one.
    """

    objective: Objective
    protocol: ProtocolName
    rows: tuple[VerdictRow, ...]
    no_planner: str = ""

    def __post_init__(self) -> None:
        if not self.rows or self.rows[0].kind != "policy":
            raise InputError("rows: expected at least one, and the policy first")

    @property
    def winner(self) -> str:
        """The method with the best score in the episodes that it shares with the policy."""
        return min(self.rows, key=lambda row: row.difference or 0.0).method

    @property
    def unbeaten(self) -> tuple[str, ...]:
        """The heuristics that the policy does not clearly beat."""
        return tuple(row.method for row in self.rows if row.kind == "heuristic" and not row.is_clearly_beaten)

    @property
    def table(self) -> Table:
        """One line a method; each number with its standard error."""
        digits = DIGITS[self.objective]
        rows = []
        for row in self.rows:
            errors = [number(se if row.episodes > 1 else None, digits) for se in (row.se, row.difference_se)]
            score = f"{row.mean:.{digits}f} ± {errors[0]}"
            difference = "" if row.difference is None else f"{row.difference:+.{digits}f} ± {errors[1]}"
            rows.append((row.method, row.kind, score, difference, str(row.episodes)))
        return Table(
            title=f"Verdict: {MEANINGS[self.objective]}, {self.protocol} protocol",
            note="Means ± standard error, in episodes that neither trained nor selected it.",
            header=("method", "kind", "score", "policy leads by", "episodes"),
            rows=tuple(rows),
        )

    @property
    def sentences(self) -> tuple[str, ...]:
        """The verdict in words."""
        said = [f"No planner: {self.no_planner}."] if self.no_planner else []
        if better := self._better_assigned():
            lead = f"{-(better.difference or 0.0):.{DIGITS[self.objective]}f}"
            said.append(f"With assigned targets the policy is better: {better.method}, by {lead}.")
        if not self.unbeaten:
            return *said, f"The policy leads every heuristic clearly, by {CLEAR:g} standard errors or more."
        names = ", ".join(self.unbeaten)
        return *said, f"The policy has no clear lead ({CLEAR:g} standard errors) over: {names}."

    def _better_assigned(self) -> VerdictRow | None:
        """The best of the policies with assigned targets, where it is clearly better than the policy alone."""
        leads = [(-(row.difference or 0.0), row) for row in self.rows if row.kind == "policy"]
        clear = [(lead, row) for lead, row in leads if lead > 0 and lead >= CLEAR * (row.difference_se or 0.0)]
        return max(clear, key=lambda each: each[0])[1] if clear else None

    def __repr__(self) -> str:
        return "\n".join([text(self.table), *self.sentences])

    def _repr_html_(self) -> str:
        return f"{html(self.table)}<p>{escape(' '.join(self.sentences))}</p>"


def judge_run(run: Path, quiet: bool = False) -> Verdict:
    """Judge the best policy of a run folder, and write its verdict.json."""
    experiment, policy, _ = load_run(run)
    with Bar("verdict", len(compared(experiment, policy)), "methods", quiet) as bar:
        verdict = judge(experiment, policy, bar.update)
    write_verdict(run, verdict)
    return verdict


def judge(experiment: Experiment, policy: Policy, report: Callable[[int], None] = lambda done: None) -> Verdict:
    """Judge a policy beside all heuristics, and a planner of a size that takes seconds.

    `report` takes the number of completed policies and heuristics.
    """
    given = held_out(experiment, judged_episodes(experiment), SUITE_SEED)
    episodes, settings = planner_size(experiment)
    methods = compared(experiment, policy)
    with ThreadPoolExecutor(2) as pool:  # compilation, most of the wait, runs side by side
        planned = pool.submit(planned_scores, given, settings, episodes)
        scores = policy_scores(given, methods, report)
        plans = planned.result()
    planner, why = ({}, plans) if isinstance(plans, str) else ({f"icr-{settings.starts}": plans}, "")
    return verdict_of(experiment, scores, planner, why)


def judged_episodes(experiment: Experiment) -> int:
    """Episodes of the policy and the heuristics: fewer where they have many steps and targets."""
    scenes = experiment.scenario.scenes
    longest = scenes.targets_max * scenes.horizon(scenes.targets_max)
    return min(EPISODES, max(LEAST_EPISODES, TARGET_STEPS // longest))


def planner_size(experiment: Experiment) -> tuple[int, PlanSettings]:
    """Episodes and settings of the planner, as many episodes and starts as fit into PLANNER_WORK."""
    online = ONLINE[experiment.training.select]
    sizes = [(episodes, replace(online, starts=starts)) for episodes, starts in PLANNER_SIZES]
    fitting = (size for size in sizes if size[0] * planning_work(experiment, size[1]) <= PLANNER_WORK)
    return next(fitting, sizes[-1])


def planned_scores(
    given: HeldOut, settings: PlanSettings, episodes: int, report: Callable[[int], None] = lambda done: None
) -> Scores | str:
    """The scores of `planner_scores`, or the reason why it cannot plan in this scenario."""
    try:
        return planner_scores(given, settings, episodes, report)
    except InputError as error:
        return str(error)


def verdict_of(
    experiment: Experiment, policies: Mapping[str, Scores], planners: Mapping[str, Scores], no_planner: str = ""
) -> Verdict:
    """The verdict of the scores of "policy", heuristics and planners; a method with fewer episodes has the first."""
    ours = policies["policy"]
    kinds: dict[str, Kind] = {name: "policy" if name.startswith("policy") else "heuristic" for name in policies}
    kinds |= dict.fromkeys(planners, "planner")
    scores = {**policies, **planners}

    def order(name: str) -> tuple[int, bool, float]:
        return get_args(Kind).index(kinds[name]), name != "policy", -float(scores[name].mean())

    ranked = sorted(scores, key=order)
    return Verdict(
        objective=experiment.training.objective,
        protocol=experiment.training.select,
        rows=tuple(_row(name, kinds[name], scores[name], ours) for name in ranked),
        no_planner=no_planner,
    )


def _row(method: str, kind: Kind, scores: Scores, ours: Scores) -> VerdictRow:
    row = VerdictRow(
        method=method, kind=kind, mean=float(scores.mean()), se=standard_error(scores), episodes=len(scores)
    )
    if method == "policy":
        return row
    lead = ours[: len(scores)] - scores
    return replace(row, difference=float(lead.mean()), difference_se=standard_error(lead))


def standard_error(values: Scores) -> float:
    """Standard error of the mean of independent values; 0 of a single one."""
    return float(values.std(ddof=1)) / len(values) ** 0.5 if len(values) > 1 else 0.0


def write_verdict(run: Path, verdict: Verdict) -> None:
    """Write the verdict.json of a run folder."""
    derived = {"winner": verdict.winner, "unbeaten": list(verdict.unbeaten)}
    write_document(run / VERDICT, "verdict", VERSION, {**provenance(), **asdict(verdict), **derived})


def read_verdict(run: Path) -> Verdict | None:
    """Read the verdict of a run folder; None without one. Raises InputError for a damaged file."""
    path = run / VERDICT
    if not path.exists():
        return None
    content = read_document(path, "verdict", VERSION, "verdict of a training")
    table = {field.name: content[field.name] for field in fields(Verdict) if field.name in content}
    if isinstance(rows := table.get("rows"), list):
        table["rows"] = [_without_null(row) if isinstance(row, dict) else row for row in rows]
    return from_table(Verdict, table, str(path))


def _without_null(row: dict[str, Any]) -> dict[str, Any]:
    """Leave out what is null, as tables do that `from_table` reads."""
    return {name: value for name, value in row.items() if value is not None}
