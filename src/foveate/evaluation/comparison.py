"""Comparison of methods by their rows: cells with normalised scores, each training seed, paired differences.

Scenes are independent, rows are not: a method that was trained with several seeds counts with its mean over them.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from foveate.evaluation.bounds import Cell, with_normalised_scores
from foveate.evaluation.evaluate import Row
from foveate.evaluation.statistics import holm, paired
from foveate.evaluation.summary import Summary, summarise
from foveate.io.grouping import group_by


@dataclass(frozen=True, kw_only=True)
class Part:
    """The rows of one method under one protocol and first error, for one training seed if it has a training."""

    method: str
    family: str
    training_seed: int | None
    protocol: str
    rows: tuple[Row, ...]
    initial_error: str | None = None


@dataclass(frozen=True, kw_only=True)
class BySeed:
    """A cell of the policy that one training seed gave."""

    training_seed: int
    cell: Summary


@dataclass(frozen=True, kw_only=True)
class Difference:
    """A method less the reference, in the same scenes of one cell [nat per target].

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
    """A method under a protocol: means over the cells, each counting the same; `step_time_s` of one decision."""

    method: str
    family: str
    protocol: str
    mean: float
    normalised_score: float | None
    seen_fraction: float
    step_time_s: float


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """All that tables and figures show, for one first error of beliefs (None: the experiment's own)."""

    initial_error: str | None
    reference: str
    parts: tuple[Part, ...]
    summary: tuple[Summary, ...]
    by_seed: tuple[BySeed, ...]
    differences: tuple[Difference, ...]
    overall: tuple[Overall, ...]


def compare(parts: Sequence[Part], reference: str, lowest: Mapping[Cell, float], state_size: int) -> Comparison:
    """Compare methods, `omniscient` among them, all with the same first error; `lowest` has the cells' lower bounds."""
    rows = [row for part in parts for row in part.rows]
    plain = summarise(rows, state_size)
    oracle = [cell for cell in plain if cell.method == "omniscient"]
    summary = with_normalised_scores(plain, oracle, lowest)
    by_seed = [
        BySeed(training_seed=part.training_seed, cell=cell)
        for part in parts
        if part.training_seed is not None
        for cell in with_normalised_scores(summarise(part.rows, state_size), oracle, lowest)
    ]
    families = {part.method: part.family for part in parts}
    return Comparison(
        initial_error=parts[0].initial_error,
        reference=reference,
        parts=tuple(parts),
        summary=tuple(summary),
        by_seed=tuple(by_seed),
        differences=tuple(_differences(rows, reference)),
        overall=tuple(_overall(rows, summary, families)),
    )


def _differences(rows: Sequence[Row], reference: str) -> Iterator[Difference]:
    """Every method but the reference itself, cell by cell, in the order of the rows."""
    cells = group_by(rows, lambda row: (row.method, row.protocol, row.motion, row.targets))
    means = {cell: means for cell, group in cells.items() if (means := _mean_by_scene(group))}
    for (method, protocol), family in group_by(means, lambda cell: cell[:2]).items():
        if method == reference:
            continue
        pairs = [(means[cell], means[(reference, *cell[1:])]) for cell in family]
        tests = [paired(list(ours.values()), [theirs[scene] for scene in ours]) for ours, theirs in pairs]
        adjusted = holm([test.p for test in tests])
        for cell, test, p_holm in zip(family, tests, adjusted, strict=True):
            yield Difference(
                method=method, reference=reference, protocol=protocol, motion=cell[2], targets=cell[3], p_holm=p_holm,
                scenes=len(means[cell]), **asdict(test),
            )  # fmt: skip


def _mean_by_scene(rows: Sequence[Row]) -> dict[str, float]:
    scores = group_by(((row.scene, row.score) for row in rows if row.score is not None), lambda pair: pair[0])
    return {scene: float(np.mean([score for _, score in pairs])) for scene, pairs in scores.items()}


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
    """Comparisons as an evaluation result: rows with training seed and first error, and what follows from them.

    The first error is left out where it is the experiment's own.
    """

    def listed(records: Callable[[Comparison], Iterable[dict[str, Any]]]) -> list[dict[str, Any]]:
        errors = [{} if one.initial_error is None else {"initial_error": one.initial_error} for one in comparisons]
        return [record | error for one, error in zip(comparisons, errors, strict=True) for record in records(one)]

    return {
        **facts,
        "reference": comparisons[0].reference,
        "rows": listed(lambda one: (asdict(r) | {"training_seed": p.training_seed} for p in one.parts for r in p.rows)),
        "summary": listed(lambda one: map(asdict, one.summary)),
        "by_seed": listed(lambda one: ({"training_seed": s.training_seed, **asdict(s.cell)} for s in one.by_seed)),
        "differences": listed(lambda one: map(asdict, one.differences)),
        "overall": listed(lambda one: map(asdict, one.overall)),
    }
