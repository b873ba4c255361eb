"""Compare methods by their rows: cells with normalised scores, each training seed, paired differences.

Scenes are independent, rows are not: a method trained with several seeds counts with its mean over them.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from foveate.evaluation.bounds import Cell, with_normalised_scores
from foveate.evaluation.evaluate import Row
from foveate.evaluation.statistics import holm, paired
from foveate.evaluation.summary import Summary, scene_means, summarise
from foveate.io.grouping import group_by


@dataclass(frozen=True, kw_only=True)
class Part:
    """Rows of one method under one protocol and initial error, for one training seed if the method is trained."""

    method: str
    family: str
    training_seed: int | None
    protocol: str
    rows: tuple[Row, ...]
    initial_error: str | None = None


@dataclass(frozen=True, kw_only=True)
class Difference:
    """A method minus the reference, in the same scenes of one cell [nat per target].

    `ci95`: Student's interval of the mean; `p`: of the signed-rank test; `p_holm`: adjusted for the cells of this
    method under this protocol.
    """

    method: str
    reference: str
    protocol: str
    motion: str
    targets: int
    mean: float
    ci95: tuple[float, float]
    p: float
    p_holm: float
    scenes: int


@dataclass(frozen=True, kw_only=True)
class Overall:
    """A method under a protocol: means over the cells, each with the same weight; `step_time_s` of one decision."""

    method: str
    family: str
    protocol: str
    mean: float
    normalised_score: float | None
    seen_fraction: float
    step_time_s: float


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Contents of all tables and figures, for one initial error of beliefs (None: the experiment's own).

    `by_seed` has the cells of each trained policy with its training seed.
    """

    initial_error: str | None
    reference: str
    parts: tuple[Part, ...]
    summary: tuple[Summary, ...]
    by_seed: tuple[tuple[int, Summary], ...]
    differences: tuple[Difference, ...]
    overall: tuple[Overall, ...]


def compare(parts: Sequence[Part], reference: str, lowest: Mapping[Cell, float], state_size: int) -> Comparison:
    """Compare methods with the same initial error; `omniscient` is the oracle, `lowest` holds the lower bounds."""
    rows = [row for part in parts for row in part.rows]
    cells = summarise(rows, state_size)
    oracle = [cell for cell in cells if cell.method == "omniscient"]
    summary = with_normalised_scores(cells, oracle, lowest)
    by_seed = [
        (part.training_seed, cell)
        for part in parts
        if part.training_seed is not None
        for cell in with_normalised_scores(summarise(part.rows, state_size), oracle, lowest)
    ]
    return Comparison(
        initial_error=parts[0].initial_error,
        reference=reference,
        parts=tuple(parts),
        summary=tuple(summary),
        by_seed=tuple(by_seed),
        differences=tuple(_differences(rows, reference)),
        overall=tuple(_overall(rows, summary, {part.method: part.family for part in parts})),
    )


def _differences(rows: Sequence[Row], reference: str) -> Iterator[Difference]:
    """Differences of every method but the reference, cell by cell, in the order of the rows."""
    scored = (row for row in rows if row.score is not None)
    groups = group_by(scored, lambda row: (row.method, row.protocol, row.motion, row.targets))
    means = {cell: scene_means(group) for cell, group in groups.items()}
    for (method, protocol), cells in group_by(means, lambda cell: cell[:2]).items():
        if method == reference:
            continue
        pairs = [(means[cell], means[(reference, *cell[1:])]) for cell in cells]
        tests = [paired(list(ours.values()), [theirs[scene] for scene in ours]) for ours, theirs in pairs]
        for cell, test, p_holm in zip(cells, tests, holm([test.p for test in tests]), strict=True):
            yield Difference(
                method=method, reference=reference, protocol=protocol, motion=cell[2], targets=cell[3], p_holm=p_holm,
                scenes=len(means[cell]), **asdict(test),
            )  # fmt: skip


def _overall(rows: Sequence[Row], summary: Sequence[Summary], families: Mapping[str, str]) -> Iterator[Overall]:
    summaries = group_by(summary, lambda cell: (cell.method, cell.protocol))
    for (method, protocol), ours in group_by(rows, lambda row: (row.method, row.protocol)).items():
        cells = summaries[method, protocol]
        normalised = [cell.normalised_score for cell in cells if cell.normalised_score is not None]
        by_cell = group_by(ours, lambda row: (row.motion, row.targets)).values()
        yield Overall(
            method=method,
            family=families[method],
            protocol=protocol,
            mean=float(np.mean([cell.mean for cell in cells])),
            normalised_score=float(np.mean(normalised)) if len(normalised) == len(cells) else None,
            seen_fraction=float(np.mean([cell.seen_fraction for cell in cells])),
            step_time_s=float(np.mean([np.mean([row.step_time_s for row in group]) for group in by_cell])),
        )


def as_json(comparisons: Sequence[Comparison], facts: Mapping[str, Any]) -> dict[str, Any]:
    """Comparisons as an evaluation result; each record names its initial error unless that is the experiment's own."""
    records: dict[str, list[Any]] = {n: [] for n in ("rows", "summary", "by_seed", "differences", "overall")}
    for comparison in comparisons:
        error = {} if comparison.initial_error is None else {"initial_error": comparison.initial_error}
        for part in comparison.parts:
            records["rows"] += [row.record() | {"training_seed": part.training_seed} | error for row in part.rows]
        records["by_seed"] += [{"training_seed": seed, **cell.record(), **error} for seed, cell in comparison.by_seed]
        for name in ("summary", "differences", "overall"):
            records[name] += [asdict(record) | error for record in getattr(comparison, name)]
    return {**facts, "reference": comparisons[0].reference, **records}
