"""A comparison as tables to read."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from foveate.evaluation.bounds import Cell
from foveate.evaluation.summary import Summary
from foveate.io.tables import Table
from foveate.study.comparison import Comparison, Difference, Overall
from foveate.study.robustness import ORACLE, Factor, Point, Verdict, verdicts

SIGNIFICANT = 0.05


MEANINGS = {
    "surrogate": "The paper's score: information grows softly, also for targets near the view",
    "true": "The Kalman filter that really runs: information only from real measurements",
}


FIRST_ERRORS = {"paper": "first errors as in the paper", "consistent": "consistent first errors"}


def tables(comparison: Comparison, protocol: str) -> list[Table]:
    """What was found under one protocol: scores, differences, normalised_score, share seen, spread over training seeds."""
    found = [scores(comparison, protocol), differences(comparison, protocol), honesty(comparison, protocol)]
    found += [_by_cell(comparison, protocol, *by_cell) for by_cell in BY_CELL]
    if any(one.cell.protocol == protocol for one in comparison.by_seed):
        found.append(seeds(comparison, protocol))
    return found


def honesty(comparison: Comparison, protocol: str) -> Table:
    """One row a method, means over cells: what was seen, how large errors are, and whether the filter knows."""
    rows = []
    for one in _ranked(comparison, protocol):
        cells = [c for c in comparison.summary if (c.method, c.protocol) == (one.method, protocol)]
        names = ("rmse_m", "rmse_seen_m", "rmse_unseen_m", "nees", "nees_seen", "nees_unseen")
        outside = sum(not cell.nees_band[0] <= cell.nees <= cell.nees_band[1] for cell in cells)
        rows.append(
            (
                one.method,
                one.family,
                f"{one.seen_fraction:.0%}",
                f"{np.mean([cell.seen_step_fraction for cell in cells]):.1%}",
                f"{np.mean([cell.longest_unseen_s for cell in cells]):.1f}",
                *(_mean([getattr(cell, name) for cell in cells]) for name in names),
                f"{outside} of {len(cells)}",
            )
        )
    return Table(
        title=f"{_where(comparison, protocol)}: what was seen, and whether the filter knows its errors",
        note="Means over cells. Seen: targets that were really measured at least once; of the time: measured targets "
        "among all targets of all steps; longest: the longest time without a measurement of any target. RMSE and NEES "
        "at the horizon, of all targets, of those seen and of those never seen; NEES is the state's length where the "
        "filter is honest, more where it is too sure. Outside: cells whose NEES lies outside of its 95 % band.",
        header=(
            *("method", "kind", "seen", "of the time", "longest [s]"),
            *("rmse [m]", "of the seen", "of the never seen", "NEES", "of the seen", "of the never seen", "outside"),
        ),
        rows=tuple(rows),
    )


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
        title=f"{_where(comparison, protocol)}: score per target [nat]",
        note=f"{MEANINGS[protocol]}. Mean over scenes (of trained methods: and over seeds) ± half of its 95 % "
        "interval, scenes taken as independent, for the policies of these training seeds (what other seeds would bring "
        "is in the table of seeds); in brackets, the paper's standard deviation over episodes.",
        header=("method", "kind", *map(_label, cells), "mean", "normalised_score", "seen", "decision [ms]"),
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
        title=f"{_where(comparison, protocol)}: difference to {comparison.reference} in the same scenes [nat]",
        note="Mean of the differences ± half of its 95 % interval (Student), scenes paired. * : p < 0.05 of Wilcoxon's "
        "signed-rank test after Holm's correction for the cells of a row; all p values are in table.json.",
        header=("method", "kind", *map(_label, cells)),
        rows=tuple(rows),
    )


def worlds(factors: Sequence[Factor], found: Sequence[Point]) -> Table:
    """One row a method and factor, the values of the factor in a row: score, and normalised_score where it says something."""
    most = max(len(factor.values) for factor in factors)
    rows = []
    for factor in factors:
        grouped: dict[str, list[Verdict]] = {}
        for one in verdicts(factor, found):
            grouped.setdefault(one.method, []).append(one)
        for method, ours in grouped.items():
            cells = [_world(one) for one in ours]
            rows.append((f"{factor.label}: {', '.join(f'{x:g}' for x in factor.values)}", method, *cells))
    return Table(
        title="Worlds that differ from training by one factor",
        note="Mean score [nat per target] ± half of its 95 % interval (of trained methods: over seeds, too), "
        "and normalised_score in brackets: - where the omniscient planner itself is passed, and measures nothing. A column is "
        "a value of the factor, in the order in which they are named.",
        header=("factor", "method", *(f"value {i + 1}" for i in range(most))),
        rows=tuple((*row, *[""] * (most + 2 - len(row))) for row in rows),
    )


def _world(one: Verdict) -> str:
    score = f"{one.mean:.2f} ± {(one.ci95[1] - one.ci95[0]) / 2:.2f}"
    if one.method == ORACLE or one.normalised_score is None:
        return score
    return f"{score} ({'-' if one.normalised_score > 1 else f'{one.normalised_score:.2f}'})"


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
        title=f"{_where(comparison, protocol)}: training seeds [nat]",
        note="Mean score of each trained policy over the scenes of a cell, and the standard deviation of these means.",
        header=("method", "policy", *map(_label, cells), "mean"),
        rows=tuple(rows),
    )


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


def _overall(one: Overall) -> tuple[str, ...]:
    milliseconds = 1e3 * one.step_time_s
    time = f"{milliseconds:.3f}" if milliseconds < 1 else f"{milliseconds:.1f}"
    return f"{one.mean:.2f}", _number(one.normalised_score, 3), f"{one.seen_fraction:.0%}", time


def _published(name: str, numbers: Mapping[Cell, tuple[float, float]], cells: Sequence[Cell]) -> list[tuple[str, ...]]:
    """A row of the paper's table, where it has all of the cells."""
    if any(cell not in numbers for cell in cells):
        return []
    values = [f"{numbers[cell][0]:.2f} [{numbers[cell][1]:.2f}]" for cell in cells]
    mean = float(np.mean([numbers[cell][0] for cell in cells]))
    return [(name, "printed", *values, f"{mean:.2f}", "-", "-", "-")]


def _mean(values: Sequence[float | None]) -> str:
    found = [value for value in values if value is not None]
    return f"{np.mean(found):.2f}" if found else "-"


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _nees(value: float | None, band: tuple[float, float] | None) -> str:
    """NEES; with a star where it lies outside of its band."""
    star = "*" if value is not None and band is not None and not band[0] <= value <= band[1] else ""
    return f"{_number(value)}{star}"


BY_CELL: tuple[tuple[str, str, Callable[[Summary], str]], ...] = (
    (
        "normalised_score by cell",
        "0: never sees anything; 1: the omniscient planner, which knows the future.",
        lambda cell: _number(cell.normalised_score, 3),
    ),
    (
        "share of targets seen by cell",
        "Targets that were really measured at least once.",
        lambda cell: f"{cell.seen_fraction:.0%}",
    ),
    (
        "share of the time seen, and the longest time unseen, by cell",
        "Measured targets among all targets of all steps; the longest time [s] without a measurement of any target.",
        lambda cell: f"{cell.seen_step_fraction:.1%}, {cell.longest_unseen_s:.1f} s",
    ),
    (
        "RMSE by cell [m]",
        "At the horizon: of all targets; of those seen at least once; of those never seen.",
        lambda cell: " / ".join(map(_number, (cell.rmse_m, cell.rmse_seen_m, cell.rmse_unseen_m))),
    ),
    (
        "NEES by cell",
        "At the horizon: of all targets (95 % band of a filter that is right); of those seen; of those never seen. "
        "* : outside of its own band.",
        lambda cell: (
            f"{_nees(cell.nees, cell.nees_band)} ({cell.nees_band[0]:.2f} to {cell.nees_band[1]:.2f}) / "
            f"{_nees(cell.nees_seen, cell.nees_seen_band)} / {_nees(cell.nees_unseen, cell.nees_unseen_band)}"
        ),
    ),
)
"""Title, note and cells of the tables that have one number, or a few, for every method and cell."""


def _where(comparison: Comparison, protocol: str) -> str:
    """What a table is of: the protocol and, where it is not the world's own, the first error of beliefs."""
    return protocol if comparison.initial_error is None else f"{protocol}, {FIRST_ERRORS[comparison.initial_error]}"


def _by_cell(comparison: Comparison, protocol: str, title: str, note: str, shown: Callable[[Summary], str]) -> Table:
    cells = _cells(comparison)
    values = {(c.method, c.motion, c.targets): shown(c) for c in comparison.summary if c.protocol == protocol}
    return Table(
        title=f"{_where(comparison, protocol)}: {title}",
        note=note,
        header=("method", "kind", *map(_label, cells)),
        rows=tuple(
            (one.method, one.family, *(values[one.method, *cell] for cell in cells))
            for one in _ranked(comparison, protocol)
        ),
    )


MODEL_BASED = {
    ("unbiased", 3): (6.71, 1.47),
    ("unbiased", 5): (6.56, 0.55),
    ("unbiased", 7): (5.41, 0.85),
    ("biased", 3): (6.87, 1.21),
    ("biased", 5): (5.96, 0.96),
    ("biased", 7): (4.92, 1.07),
}
"""The paper's method, by (motion, targets)."""


MODEL_FREE = {
    ("unbiased", 3): (4.57, 2.13),
    ("unbiased", 5): (3.65, 1.54),
    ("unbiased", 7): (1.94, 1.70),
    ("biased", 3): (4.23, 1.77),
    ("biased", 5): (3.27, 1.30),
    ("biased", 7): (2.01, 1.67),
}
"""Its rival, PPO."""
