"""Evaluate policies and report: rows and summary as a table, as records, as JSON."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foveate.evaluation.bounds import lower_bounds, with_normalised_scores
from foveate.evaluation.evaluate import Row, Suite, evaluate, prepare
from foveate.evaluation.oracle import oracle_rows
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
    targets (see `Summary`). `scenes`: those that were run.
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

    With `normalised`, plan for the omniscient planner too: that takes minutes, once.

    Raises:
        InputError: `normalised` for a problem that has no omniscient planner.
    """
    problem = experiment.scenario.problem()
    # First, as it rejects a problem that has no bounds before anything long begins.
    lower = lower_bounds(problem, scenes) if normalised else {}
    suite = prepare(problem, experiment.scenario.scenes, scenes, seed, episodes)
    rows: list[Row] = []
    with Bar("evaluating", len(policies), "methods", quiet) as bar:
        for done, (name, policy) in enumerate(policies.items()):
            bar.update(done, name)
            rows += evaluate(suite, name, policy, protocols)
    summary = summarise(rows, problem.motion.state_size)
    if normalised:
        oracle = summarise(_oracle(suite, protocols, quiet), problem.motion.state_size)
        summary = with_normalised_scores(summary, oracle, lower)
    facts = {
        **facts,
        "experiment": digest(experiment),
        "initial_error": experiment.scenario.scenes.initial_error,
        "scenes_digest": scenes_digest(scenes),
        "seed": seed,
    }
    return Evaluation(
        title=f"{title}: score per target [nat], {episodes} episode(s) a scene",
        facts=facts,
        rows=tuple(rows),
        summary=tuple(summary),
        scenes=suite.scenes,
    )


def _oracle(suite: Suite, protocols: Sequence[str], quiet: bool) -> list[Row]:
    """Rows of the omniscient planner."""
    rows: list[Row] = []

    def progress(bar: Bar, before: int) -> Callable[[int], None]:
        return lambda done: bar.update(before + done)

    total = len(suite.scenes) * suite.episodes_per_scene * len(protocols)
    with Bar("omniscient plans", total, "episodes", quiet) as bar:
        for protocol in protocols:
            rows += oracle_rows(suite, protocol, progress(bar, len(rows)))
    return rows


def summary_table(title: str, summary: Sequence[Summary]) -> Table:
    """Summary as a table, one line a cell."""
    header = ("method", "protocol", "motion", "targets", "score", "95 % interval", "std", "seen", "of the time")
    normalised = ("normalised",) * any(cell.normalised_score is not None for cell in summary)
    rows = [
        (
            cell.method,
            cell.protocol,
            cell.motion,
            str(cell.targets),
            f"{cell.mean:.2f}",
            f"{cell.ci95[0]:.2f} .. {cell.ci95[1]:.2f}",
            f"{cell.std:.2f}",
            f"{cell.seen_fraction:.0%}",
            f"{cell.seen_step_fraction:.0%}",
            f"{cell.longest_unseen_s:.1f}",
            f"{cell.rmse_m:.2f}",
            f"{cell.nees:.1f} ({cell.nees_band[0]:.1f} .. {cell.nees_band[1]:.1f})",
            ", ".join("-" if nees is None else f"{nees:.1f}" for nees in (cell.nees_seen, cell.nees_unseen)),
            *("-" if cell.normalised_score is None else f"{cell.normalised_score:.3f}" for _ in normalised),
        )
        for cell in summary
    ]
    columns = (*header, "longest not [s]", "rmse [m]", "nees (band)", "seen, never seen", *normalised)
    return Table(title=title, header=columns, rows=tuple(rows))
