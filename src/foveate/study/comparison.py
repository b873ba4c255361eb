"""What rows of several methods say: cells with normalised_score, the spread over training seeds, paired differences.

The unit that is independent is the scene: a method that was trained with several seeds counts with its mean over them.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from foveate.evaluation.bounds import Cell, with_normalised_scores
from foveate.evaluation.evaluate import Row
from foveate.evaluation.statistics import holm, paired
from foveate.evaluation.summary import Summary, summarise


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
    """All that tables and figures show, for one first error of beliefs (None: the world's own)."""

    initial_error: str | None
    reference: str
    parts: tuple[Part, ...]
    summary: tuple[Summary, ...]
    by_seed: tuple[BySeed, ...]
    differences: tuple[Difference, ...]
    overall: tuple[Overall, ...]


def compare(parts: Sequence[Part], reference: str, floors: Mapping[Cell, float], state_size: int) -> Comparison:
    """Compare methods, all with the same first error of beliefs; `floors` gives the score of never seeing anything,
    and one of them is `omniscient`."""
    rows = [row for part in parts for row in part.rows]
    plain = summarise(rows, state_size)
    ceiling = [cell for cell in plain if cell.method == "omniscient"]
    summary = with_normalised_scores(plain, ceiling, floors)
    by_seed = [
        BySeed(training_seed=part.training_seed, cell=cell)
        for part in parts
        if part.training_seed is not None
        for cell in with_normalised_scores(summarise(part.rows, state_size), ceiling, floors)
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


def _differences(rows: Sequence[Row], reference: str) -> list[Difference]:
    """Every method but the reference itself, cell by cell, in the order of the rows."""
    scores: dict[tuple[str, str, str, int], dict[str, list[float]]] = {}
    for row in rows:
        if row.score is not None:
            cell = scores.setdefault((row.method, row.protocol, row.motion, row.targets), {})
            cell.setdefault(row.scene, []).append(row.score)
    means = {cell: {scene: float(np.mean(found)) for scene, found in by.items()} for cell, by in scores.items()}
    groups: dict[tuple[str, str], list[Difference]] = {}
    for (method, protocol, motion, targets), ours in means.items():
        if method == reference:
            continue
        theirs = means[reference, protocol, motion, targets]
        found = paired(list(ours.values()), [theirs[scene] for scene in ours])
        groups.setdefault((method, protocol), []).append(
            Difference(
                method=method,
                reference=reference,
                protocol=protocol,
                motion=motion,
                targets=targets,
                mean=found.mean,
                ci95=found.ci95,
                p=found.p,
                p_holm=found.p,
                scenes=len(ours),
            )
        )
    return [
        replace(one, p_holm=adjusted)
        for group in groups.values()
        for one, adjusted in zip(group, holm([one.p for one in group]), strict=True)
    ]


def _overall(rows: Sequence[Row], summary: Sequence[Summary], families: Mapping[str, str]) -> list[Overall]:
    times: dict[tuple[str, str], dict[Cell, list[float]]] = {}
    for row in rows:
        cell = times.setdefault((row.method, row.protocol), {})
        cell.setdefault((row.motion, row.targets), []).append(row.step_time_s)
    found = []
    for (method, protocol), by_cell in times.items():
        cells = [cell for cell in summary if (cell.method, cell.protocol) == (method, protocol)]
        close = [cell.normalised_score for cell in cells if cell.normalised_score is not None]
        found.append(
            Overall(
                method=method,
                family=families[method],
                protocol=protocol,
                mean=float(np.mean([cell.mean for cell in cells])),
                normalised_score=float(np.mean(close)) if len(close) == len(cells) else None,
                seen_fraction=float(np.mean([cell.seen_fraction for cell in cells])),
                step_time_s=float(np.mean([np.mean(seconds) for seconds in by_cell.values()])),
            )
        )
    return found


def as_json(comparisons: Sequence[Comparison], facts: Mapping[str, Any]) -> dict[str, Any]:
    """Comparisons as an evaluation result: each row with its method's training seed and, where the world's own is not
    meant, the first error of its beliefs; and what follows from them."""

    def listed(records: Callable[[Comparison], Iterable[dict[str, Any]]]) -> list[dict[str, Any]]:
        return [
            record if one.initial_error is None else {**record, "initial_error": one.initial_error}
            for one in comparisons
            for record in records(one)
        ]

    return {
        **facts,
        "reference": comparisons[0].reference,
        "rows": listed(
            lambda one: (
                {**asdict(row), "training_seed": part.training_seed} for part in one.parts for row in part.rows
            )
        ),
        "summary": listed(lambda one: map(asdict, one.summary)),
        "by_seed": listed(lambda one: ({"training_seed": s.training_seed, **asdict(s.cell)} for s in one.by_seed)),
        "differences": listed(lambda one: map(asdict, one.differences)),
        "overall": listed(lambda one: map(asdict, one.overall)),
    }
