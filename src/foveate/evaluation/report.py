"""Evaluate policies and report rows and summary: as a table, as records, as JSON."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from foveate.evaluation.bounds import lower_bounds, with_normalised_scores
from foveate.evaluation.evaluate import Row, Suite, evaluate, prepare
from foveate.evaluation.oracle import OnProgress, oracle_rows
from foveate.evaluation.summary import Summary, summarise, write_result
from foveate.experiment.experiment import Experiment
from foveate.io.progress import Bar
from foveate.io.tables import Table, html, text
from foveate.io.toml import digest
from foveate.scenario.scenes import Scene, scenes_digest
from foveate.simulation.records import Policy


@dataclass(frozen=True, kw_only=True, repr=False)
class Evaluation:
    """Results of methods on the same scenes with the same noise.

    `rows`: one an episode (see `Row`). `summary`: one a cell, that is a method, a protocol, a motion and a number of
    targets (see `Summary`). `scenes`: those of the rows.
    """

    title: str
    facts: dict[str, Any]
    rows: tuple[Row, ...]
    summary: tuple[Summary, ...]
    scenes: tuple[Scene, ...]

    @property
    def table(self) -> Table:
        """The summary as text."""
        return summary_table(self.title, self.summary)

    def to_json(self, path: str | Path) -> None:
        """Write rows and summary for programs, as `foveate evaluate --json`."""
        write_result(path, self.rows, self.summary, self.facts)

    def __repr__(self) -> str:
        return text(self.table)

    def _repr_html_(self) -> str:
        return html(self.table)


def evaluate_all(
    title: str,
    facts: dict[str, Any],
    experiment: Experiment,
    policies: dict[str, Policy],
    scenes: Sequence[Scene],
    *,
    protocols: Sequence[str],
    episodes: int = 1,
    seed: int = 0,
    normalised: bool = False,
    quiet: bool = False,
) -> Evaluation:
    """Run every policy, by its method's name, on the same scenes with the same noise, under each protocol.

    With `normalised`, run the omniscient planner too: that takes minutes, once. Raises InputError for a problem that
    it does not bound.
    """
    problem = experiment.scenario.problem()
    # Before anything long begins, as it rejects problems without bounds.
    lower = lower_bounds(problem, scenes) if normalised else {}
    suite = prepare(problem, experiment.scenario.scenes, scenes, seed, episodes)
    rows: list[Row] = []
    with Bar("evaluating", len(policies), "methods", quiet) as bar:
        for done, (name, policy) in enumerate(policies.items()):
            bar.update(done, name)
            rows += evaluate(suite, name, policy, protocols)
    summary = summarise(rows, problem.motion.state_size)
    if normalised:
        count = len(scenes) * episodes
        oracle = rows_by_protocol("omniscient plans", count, protocols, partial(oracle_rows, suite), quiet)
        summary = with_normalised_scores(summary, summarise(oracle, problem.motion.state_size), lower)
    facts = {**facts, "initial_error": experiment.scenario.scenes.initial_error}
    return evaluation(title, facts, experiment, suite, rows, summary)


def evaluation(
    title: str, facts: dict[str, Any], experiment: Experiment, suite: Suite, rows: list[Row], summary: list[Summary]
) -> Evaluation:
    """Make the record of an evaluation, with the facts of its origin."""
    origin = {"experiment": digest(experiment), "scenes_digest": scenes_digest(suite.scenes), "seed": suite.seed}
    return Evaluation(
        title=f"{title}: score per target [nat], {suite.episodes_per_scene} episode(s) a scene",
        facts={**facts, **origin},
        rows=tuple(rows),
        summary=tuple(summary),
        scenes=suite.scenes,
    )


def rows_by_protocol(
    label: str, count: int, protocols: Sequence[str], rows_of: Callable[[str, OnProgress], list[Row]], quiet: bool
) -> list[Row]:
    """Call `rows_of`, which returns `count` rows of a protocol, for each protocol, with a progress bar."""
    rows: list[Row] = []
    with Bar(label, count * len(protocols), "episodes", quiet) as bar:
        for i, protocol in enumerate(protocols):
            rows += rows_of(protocol, lambda done, before=i * count: bar.update(before + done))
    return rows


COLUMNS: dict[str, Callable[[Summary], str]] = {
    "method": lambda cell: cell.method,
    "protocol": lambda cell: cell.protocol,
    "motion": lambda cell: cell.motion,
    "targets": lambda cell: str(cell.targets),
    "score": lambda cell: f"{cell.mean:.2f}",
    "95 % interval": lambda cell: f"{cell.ci95[0]:.2f} .. {cell.ci95[1]:.2f}",
    "std": lambda cell: f"{cell.std:.2f}",
    "seen": lambda cell: f"{cell.seen_fraction:.0%}",
    "of the time": lambda cell: f"{cell.seen_step_fraction:.0%}",
    "longest unseen [s]": lambda cell: f"{cell.longest_unseen_s:.1f}",
    "rmse [m]": lambda cell: f"{cell.rmse_m:.2f}",
    "nees (band)": lambda cell: f"{cell.nees:.1f} ({cell.nees_band[0]:.1f} .. {cell.nees_band[1]:.1f})",
    "seen, never seen": lambda cell: f"{_number(cell.nees_seen, 1)}, {_number(cell.nees_unseen, 1)}",
    "normalised": lambda cell: _number(cell.normalised_score, 3),
}
"""Text of every column of `summary_table`."""


def summary_table(title: str, summary: Sequence[Summary]) -> Table:
    """Summary as a table, one line a cell; the normalised score only if there is one."""
    is_normalised = any(cell.normalised_score is not None for cell in summary)
    header = tuple(name for name in COLUMNS if is_normalised or name != "normalised")
    return Table(title=title, header=header, rows=tuple(tuple(COLUMNS[n](cell) for n in header) for cell in summary))


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
