"""Evaluate policies and report rows and summary: as a table, as records, as JSON."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foveate.evaluation.bounds import lower_bounds, with_normalised_scores
from foveate.evaluation.detections import protocols_in, require_ids
from foveate.evaluation.evaluate import Suite, evaluate, prepare
from foveate.evaluation.oracle import OnProgress, oracle_rows
from foveate.evaluation.rows import Row
from foveate.evaluation.summary import Summary, summarise, write_result
from foveate.evaluation.summary_table import summary_table, summary_tables
from foveate.experiment.experiment import Experiment
from foveate.io.progress import Bar
from foveate.io.tables import Table, counted, html, text
from foveate.io.toml import digest
from foveate.names import Objective
from foveate.scenario.scenes import Scene, scenes_digest
from foveate.simulation.records import Policy

if TYPE_CHECKING:
    import pandas  # pyright: ignore[reportMissingImports]
    from matplotlib.axes import Axes


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
        """The summary in one table."""
        return summary_table(self.title, self.summary, self.facts["objective"])

    @property
    def tables(self) -> tuple[Table, ...]:
        """The summary in a table a protocol, as it is printed."""
        return summary_tables(self.title, self.summary, self.facts["objective"])

    def to_json(self, path: str | Path) -> None:
        """Write rows and summary for programs, as `foveate evaluate --json`."""
        write_result(path, self.rows, self.summary, self.facts)

    def to_pandas(self, rows: bool = False) -> "pandas.DataFrame":
        """Return the summary, or the rows, as a pandas DataFrame of plain numbers and texts.

        Intervals are two columns, `ci95_low` and `ci95_high`; what is missing is NaN.

        Args:
            rows: One line an episode, in place of one a cell.

        Raises:
            ImportError: pandas is not installed.
        """
        try:
            import pandas  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise ImportError("Evaluation.to_pandas needs pandas: pip install pandas") from error
        from foveate.evaluation.figure import flat

        return pandas.DataFrame([flat(record) for record in (self.rows if rows else self.summary)])

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the scores with their intervals, a column a cell, a colour a method.

        Args:
            ax: Axes of matplotlib to draw in; None: new ones.

        Returns:
            The axes: `ax.figure.savefig("scores.pdf")`.
        """
        from foveate.evaluation.figure import draw_summary  # matplotlib takes a second to import

        return draw_summary(self.summary, ax)

    def __repr__(self) -> str:
        return "\n\n".join(map(text, self.tables))

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
    objective: Objective | None = None,
    normalised: bool = False,
    quiet: bool = False,
) -> Evaluation:
    """Run every policy, by its method's name, on the same scenes with the same noise, under each protocol.

    Rows are scored by the `objective`, too. With `normalised`, run the omniscient planner too: that takes minutes,
    once. Raises InputError for a problem that it does not bound.
    """
    if normalised:
        require_ids(experiment.scenario, "normalised")
    problem, protocols = experiment.scenario.problem(), protocols_in(experiment.scenario, protocols)
    # Before anything long begins, as it rejects problems without bounds.
    lower = lower_bounds(problem, scenes) if normalised else {}
    suite = prepare(problem, experiment.scenario.scenes, scenes, seed, episodes, objective)
    rows: list[Row] = []
    with Bar("evaluating", len(policies), "methods", quiet) as bar:
        for done, (name, policy) in enumerate(policies.items()):
            bar.update(done, name)
            rows += evaluate(suite, name, policy, protocols)
        bar.update(len(policies))
    summary = summarise(rows, problem.motion.state_size)
    if normalised:
        count = len(scenes) * episodes
        oracle = rows_by_protocol("omniscient plans", count, protocols, partial(oracle_rows, suite), quiet)
        summary = with_normalised_scores(summary, summarise(oracle, problem.motion.state_size), lower)
    settings = experiment.scenario.scenes
    facts = {**facts, "initial_error": settings.initial_error, "first_error_std": settings.first_error_std}
    return evaluation(title, facts, experiment, suite, rows, summary)


def evaluation(
    title: str, facts: dict[str, Any], experiment: Experiment, suite: Suite, rows: list[Row], summary: list[Summary]
) -> Evaluation:
    """Make the record of an evaluation, with the facts of its origin."""
    origin = {"experiment": digest(experiment), "scenes_digest": scenes_digest(suite.scenes), "seed": suite.seed}
    origin["objective"] = suite.objective
    return Evaluation(
        title=f"{title}: {counted(len(suite.scenes), 'scene')}, {counted(suite.episodes_per_scene, 'episode')} each",
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
