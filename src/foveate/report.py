"""A comparison as tables to read: in Markdown, and as lines for the terminal."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from foveate.closeness import Cell
from foveate.comparison import Comparison, Difference, Overall
from foveate.published import MODEL_BASED, MODEL_FREE
from foveate.summary import Summary

SIGNIFICANT = 0.05
PROTOCOLS = {
    "surrogate": "The paper's score: information grows softly, also for targets near the view",
    "true": "The Kalman filter that really runs: information only from real measurements",
}


@dataclass(frozen=True, kw_only=True)
class Table:
    """Text in rows; the first two columns are words, the others numbers."""

    title: str
    note: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def tables(comparison: Comparison, protocol: str) -> list[Table]:
    """What was found under one protocol: scores, differences, closeness, share seen, spread over training seeds."""
    found = [scores(comparison, protocol), differences(comparison, protocol)]
    summary = [cell for cell in comparison.summary if cell.protocol == protocol]
    found.append(
        _by_cell(
            comparison,
            protocol,
            "closeness by cell",
            "0: never sees anything; 1: the omniscient planner, which knows the future.",
            {(cell.method, cell.motion, cell.targets): _fraction(cell.closeness) for cell in summary},
        )
    )
    found.append(
        _by_cell(
            comparison,
            protocol,
            "share of targets seen by cell",
            "Targets that were really measured at least once.",
            {(cell.method, cell.motion, cell.targets): f"{cell.seen_fraction:.0%}" for cell in summary},
        )
    )
    if any(one.cell.protocol == protocol for one in comparison.by_seed):
        found.append(seeds(comparison, protocol))
    return found


def scores(comparison: Comparison, protocol: str) -> Table:
    """One row a method; under `surrogate` the paper's own numbers on top."""
    cells = _cells(comparison)
    values = {(c.method, c.motion, c.targets): _interval(c) for c in comparison.summary if c.protocol == protocol}
    rows = [
        (one.method, one.family, *(values[one.method, *cell] for cell in cells), *_overall(one))
        for one in _ranked(comparison, protocol)
    ]
    if protocol == "surrogate":
        rows = [
            *_published("paper: model-based", MODEL_BASED, cells),
            *_published("paper: PPO", MODEL_FREE, cells),
            *rows,
        ]
    return Table(
        title=f"{protocol}: score per target [nat]",
        note=f"{PROTOCOLS[protocol]}. Mean over scenes (of trained methods: and over seeds) ± half of its 95 % "
        "interval, scenes taken as independent, for the policies of these training seeds (what other seeds would bring "
        "is in the table of seeds); in brackets, the paper's standard deviation over episodes.",
        header=("method", "kind", *map(_label, cells), "mean", "closeness", "seen", "decision [ms]"),
        rows=tuple(rows),
    )


def differences(comparison: Comparison, protocol: str) -> Table:
    """Every method less the reference, in the same scenes."""
    cells = _cells(comparison)
    values = {
        (one.method, one.motion, one.targets): _difference(one)
        for one in comparison.differences
        if one.protocol == protocol
    }
    rows = [
        (one.method, one.family, *(values[one.method, *cell] for cell in cells))
        for one in _ranked(comparison, protocol)
        if one.method != comparison.reference
    ]
    return Table(
        title=f"{protocol}: difference to {comparison.reference} in the same scenes [nat]",
        note="Mean of the differences ± half of its 95 % interval (Student), scenes paired. * : p < 0.05 of Wilcoxon's "
        "signed-rank test after Holm's correction for the cells of a row; all p values are in table.json.",
        header=("method", "kind", *map(_label, cells)),
        rows=tuple(rows),
    )


def seeds(comparison: Comparison, protocol: str) -> Table:
    """Every trained policy by itself, and the spread of each method over its seeds."""
    cells, rows = _cells(comparison), []
    for method in dict.fromkeys(one.cell.method for one in comparison.by_seed):
        mine = [one for one in comparison.by_seed if (one.cell.method, one.cell.protocol) == (method, protocol)]
        by_seed: dict[int, dict[Cell, float]] = {}
        for one in mine:
            by_seed.setdefault(one.training_seed, {})[one.cell.motion, one.cell.targets] = one.cell.mean
        for seed, means in by_seed.items():
            numbers = [means[cell] for cell in cells]
            rows.append((method, f"seed {seed}", *(f"{value:.2f}" for value in (*numbers, np.mean(numbers)))))
        if len(by_seed) > 1:
            table = np.array([[means[cell] for cell in cells] for means in by_seed.values()])
            spread = [*table.std(axis=0, ddof=1), table.mean(axis=1).std(ddof=1)]
            rows.append((method, "std over seeds", *(f"{value:.2f}" for value in spread)))
    return Table(
        title=f"{protocol}: training seeds [nat]",
        note="Mean score of each trained policy over the scenes of a cell, and the standard deviation of these means.",
        header=("method", "policy", *map(_label, cells), "mean"),
        rows=tuple(rows),
    )


def markdown(title: str, facts: Mapping[str, str], found: Sequence[Table], figures: Mapping[str, str]) -> str:
    """The page of a comparison: what it was made with, its figures (file: what it shows), its tables."""
    lines = [f"# {title}", ""]
    lines += [f"- {name}: {value}" for name, value in facts.items()] + [""]
    for file, what in figures.items():
        lines += [f"![{what}]({file})", ""]
    for table in found:
        lines += [f"## {table.title}", "", table.note, "", _line(table.header)]
        lines.append("|---|---|" + "---:|" * (len(table.header) - 2))
        lines += [*map(_line, table.rows), ""]
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cells(comparison: Comparison) -> list[Cell]:
    return list(dict.fromkeys((cell.motion, cell.targets) for cell in comparison.summary))


def _label(cell: Cell) -> str:
    return f"{cell[1]} {cell[0]}"


def _ranked(comparison: Comparison, protocol: str) -> list[Overall]:
    """The methods of a protocol, best mean first."""
    return sorted((one for one in comparison.overall if one.protocol == protocol), key=lambda one: -one.mean)


def _interval(cell: Summary) -> str:
    return f"{cell.mean:.2f} ± {(cell.ci95[1] - cell.ci95[0]) / 2:.2f}"


def _difference(one: Difference) -> str:
    star = "*" if one.p_holm < SIGNIFICANT else ""
    return f"{one.mean:+.2f} ± {(one.ci95[1] - one.ci95[0]) / 2:.2f}{star}"


def _fraction(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _overall(one: Overall) -> tuple[str, ...]:
    milliseconds = 1e3 * one.step_time_s
    time = f"{milliseconds:.3f}" if milliseconds < 1 else f"{milliseconds:.1f}"
    return f"{one.mean:.2f}", _fraction(one.closeness), f"{one.seen_fraction:.0%}", time


def _published(name: str, numbers: Mapping[Cell, tuple[float, float]], cells: Sequence[Cell]) -> list[tuple[str, ...]]:
    """A row of the paper's table, where it has all of the cells."""
    if any(cell not in numbers for cell in cells):
        return []
    values = [f"{numbers[cell][0]:.2f} [{numbers[cell][1]:.2f}]" for cell in cells]
    mean = float(np.mean([numbers[cell][0] for cell in cells]))
    return [(name, "printed", *values, f"{mean:.2f}", "-", "-", "-")]


def _by_cell(
    comparison: Comparison, protocol: str, title: str, note: str, values: Mapping[tuple[str, str, int], str]
) -> Table:
    cells = _cells(comparison)
    return Table(
        title=f"{protocol}: {title}",
        note=note,
        header=("method", "kind", *map(_label, cells)),
        rows=tuple(
            (one.method, one.family, *(values[one.method, *cell] for cell in cells))
            for one in _ranked(comparison, protocol)
        ),
    )
