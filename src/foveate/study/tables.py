"""Tables of a comparison."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from foveate.evaluation.bounds import Cell
from foveate.evaluation.comparison import Comparison, Difference, Overall
from foveate.evaluation.summary import Summary
from foveate.io.grouping import group_by
from foveate.io.tables import Table
from foveate.scenario.factors import Factor
from foveate.study.robustness import ORACLE, Point, Verdict, verdicts

SIGNIFICANT = 0.05

MEANINGS = {
    "surrogate": "The paper's score: information grows softly, also for targets near the view",
    "true": "The Kalman filter that really runs: information only from real measurements",
}

FIRST_ERRORS = {"paper": "first errors as in the paper", "consistent": "consistent first errors"}

MODEL_BASED = {
    ("unbiased", 3): (6.71, 1.47), ("unbiased", 5): (6.56, 0.55), ("unbiased", 7): (5.41, 0.85),
    ("biased", 3): (6.87, 1.21), ("biased", 5): (5.96, 0.96), ("biased", 7): (4.92, 1.07),
}  # fmt: skip
"""Mean and standard deviation of the paper's method, by (motion, targets)."""

MODEL_FREE = {
    ("unbiased", 3): (4.57, 2.13), ("unbiased", 5): (3.65, 1.54), ("unbiased", 7): (1.94, 1.70),
    ("biased", 3): (4.23, 1.77), ("biased", 5): (3.27, 1.30), ("biased", 7): (2.01, 1.67),
}  # fmt: skip
"""The same of PPO in the paper."""


def tables(comparison: Comparison, protocol: str) -> list[Table]:
    """All tables of one protocol: scores, differences, consistency, quantities by cell, training seeds."""
    shown = [scores(comparison, protocol), differences(comparison, protocol), honesty(comparison, protocol)]
    for title, note, text in BY_CELL:
        shown.append(_table(comparison, protocol, title, note, _by_cell(comparison, protocol, text)))
    if any(one.cell.protocol == protocol for one in comparison.by_seed):
        shown.append(seeds(comparison, protocol))
    return shown


def honesty(comparison: Comparison, protocol: str) -> Table:
    """One row a method, means over cells: what was seen, how large errors are, and whether the filter knows."""
    columns = ("rmse_m", "rmse_seen_m", "rmse_unseen_m", "nees", "nees_seen", "nees_unseen")
    summaries = group_by(comparison.summary, lambda cell: (cell.method, cell.protocol))
    rows = []
    for method in _ranked(comparison, protocol):
        cells = summaries[method.method, protocol]
        step_fraction = np.mean([cell.seen_step_fraction for cell in cells])
        unseen_s = np.mean([cell.longest_unseen_s for cell in cells])
        seen = (f"{method.seen_fraction:.0%}", f"{step_fraction:.1%}", f"{unseen_s:.1f}")
        errors = (_mean([getattr(cell, name) for cell in cells]) for name in columns)
        outside = sum(not cell.nees_band[0] <= cell.nees <= cell.nees_band[1] for cell in cells)
        rows.append((method.method, method.family, *seen, *errors, f"{outside} of {len(cells)}"))
    return Table(
        title=f"{_where(comparison, protocol)}: what was seen, and whether the filter knows its errors",
        note="Means over cells. Seen: targets that were really measured at least once; of the time: measured targets "
        "among all targets of all steps; longest: the longest time without a measurement of any target. RMSE and NEES "
        "at the horizon, of all targets, of those seen and of those never seen; NEES is the state's length where the "
        "filter is honest, more where it is too sure. Outside: cells whose NEES lies outside of its 95 % band.",
        header=(
            "method", "kind", "seen", "of the time", "longest [s]", "rmse [m]", "of the seen", "of the never seen",
            "NEES", "of the seen", "of the never seen", "outside",
        ),
        rows=tuple(rows),
    )  # fmt: skip


def scores(comparison: Comparison, protocol: str) -> Table:
    """One row a method; under `surrogate` the paper's own numbers on top."""
    note = (
        f"{MEANINGS[protocol]}. Mean over scenes (of trained methods: and over seeds) ± half of its 95 % "
        "interval, scenes taken as independent, for the policies of these training seeds (what other seeds would bring "
        "is in the table of seeds); in brackets, the paper's standard deviation over episodes."
    )
    values = _by_cell(comparison, protocol, lambda cell: _interval(cell.mean, cell.ci95))
    table = _table(comparison, protocol, "score per target [nat]", note, values)
    rows = [(*row, *_overall(one)) for row, one in zip(table.rows, _ranked(comparison, protocol), strict=True)]
    if protocol == "surrogate":
        cells = _cells(comparison)
        rows = [*_printed("paper: model-based", MODEL_BASED, cells), *_printed("paper: PPO", MODEL_FREE, cells), *rows]
    return replace(table, header=(*table.header, "mean", "normalised_score", "seen", "decision [ms]"), rows=tuple(rows))


def differences(comparison: Comparison, protocol: str) -> Table:
    """Every method less the reference, in the same scenes."""

    def text(one: Difference) -> str:
        return _interval(one.mean, one.ci95, "+") + "*" * (one.p_holm < SIGNIFICANT)

    ours = [one for one in comparison.differences if one.protocol == protocol]
    return _table(
        comparison,
        protocol,
        f"difference to {comparison.reference} in the same scenes [nat]",
        "Mean of the differences ± half of its 95 % interval (Student), scenes paired. * : p < 0.05 of Wilcoxon's "
        "signed-rank test after Holm's correction for the cells of a row; all p values are in table.json.",
        {(one.method, (one.motion, one.targets)): text(one) for one in ours},
    )


def worlds(factors: Sequence[Factor], points: Sequence[Point]) -> Table:
    """One row a method and factor, one column a value of the factor: score and normalised score."""
    most = max(len(factor.values) for factor in factors)
    rows = []
    for factor in factors:
        label = f"{factor.label}: {', '.join(f'{x:g}' for x in factor.values)}"
        for method, ours in group_by(verdicts(factor, points), lambda verdict: verdict.method).items():
            cells = [_verdict(verdict) for verdict in ours]
            rows.append((label, method, *cells, *[""] * (most - len(cells))))
    return Table(
        title="Worlds that differ from training by one factor",
        note="Mean score [nat per target] ± half of its 95 % interval (of trained methods: over seeds, too), "
        "and normalised_score in brackets: - where the omniscient planner itself is passed, and measures nothing. "
        "A column is a value of the factor, in the order in which they are named.",
        header=("factor", "method", *(f"value {i + 1}" for i in range(most))),
        rows=tuple(rows),
    )


def seeds(comparison: Comparison, protocol: str) -> Table:
    """Every trained policy by itself, and the standard deviation of each method over its seeds."""
    cells, rows = _cells(comparison), []
    ours = [one for one in comparison.by_seed if one.cell.protocol == protocol]
    for method, of_method in group_by(ours, lambda one: one.cell.method).items():
        means = []
        for seed, of_seed in group_by(of_method, lambda one: one.training_seed).items():
            by_cell = {(one.cell.motion, one.cell.targets): one.cell.mean for one in of_seed}
            means.append([by_cell[cell] for cell in cells])
            rows.append((method, f"seed {seed}", *(f"{value:.2f}" for value in (*means[-1], np.mean(means[-1])))))
        if len(means) > 1:
            std = [*np.std(means, axis=0, ddof=1), np.mean(means, axis=1).std(ddof=1)]
            rows.append((method, "std over seeds", *(f"{value:.2f}" for value in std)))
    return Table(
        title=f"{_where(comparison, protocol)}: training seeds [nat]",
        note="Mean score of each trained policy over the scenes of a cell, and the standard deviation of these means.",
        header=("method", "policy", *map(_label, cells), "mean"),
        rows=tuple(rows),
    )


def _table(
    comparison: Comparison, protocol: str, title: str, note: str, values: Mapping[tuple[str, Cell], str]
) -> Table:
    """One row a method that has `values`, and one column a cell."""
    cells = _cells(comparison)
    methods = [method for method in _ranked(comparison, protocol) if (method.method, cells[0]) in values]
    return Table(
        title=f"{_where(comparison, protocol)}: {title}",
        note=note,
        header=("method", "kind", *map(_label, cells)),
        rows=tuple((one.method, one.family, *(values[one.method, cell] for cell in cells)) for one in methods),
    )


def _by_cell(comparison: Comparison, protocol: str, text: Callable[[Summary], str]) -> dict[tuple[str, Cell], str]:
    return {(c.method, (c.motion, c.targets)): text(c) for c in comparison.summary if c.protocol == protocol}


def _where(comparison: Comparison, protocol: str) -> str:
    """Protocol and, where it is not the experiment's own, first error of beliefs."""
    return protocol if comparison.initial_error is None else f"{protocol}, {FIRST_ERRORS[comparison.initial_error]}"


def _cells(comparison: Comparison) -> list[Cell]:
    return list(dict.fromkeys((cell.motion, cell.targets) for cell in comparison.summary))


def _label(cell: Cell) -> str:
    return f"{cell[1]} {cell[0]}"


def _ranked(comparison: Comparison, protocol: str) -> list[Overall]:
    """The methods of a protocol, best mean first."""
    return sorted((one for one in comparison.overall if one.protocol == protocol), key=lambda one: -one.mean)


def _interval(mean: float, ci95: tuple[float, float], sign: str = "") -> str:
    return f"{mean:{sign}.2f} ± {(ci95[1] - ci95[0]) / 2:.2f}"


def _verdict(one: Verdict) -> str:
    score = _interval(one.mean, one.ci95)
    if one.method == ORACLE or one.normalised_score is None:
        return score
    return f"{score} ({'-' if one.normalised_score > 1 else f'{one.normalised_score:.2f}'})"


def _overall(one: Overall) -> tuple[str, ...]:
    milliseconds = 1e3 * one.step_time_s
    time = f"{milliseconds:.3f}" if milliseconds < 1 else f"{milliseconds:.1f}"
    return f"{one.mean:.2f}", _number(one.normalised_score, 3), f"{one.seen_fraction:.0%}", time


def _printed(name: str, numbers: Mapping[Cell, tuple[float, float]], cells: Sequence[Cell]) -> list[tuple[str, ...]]:
    """A row of the paper's table, where it has all of the cells."""
    if any(cell not in numbers for cell in cells):
        return []
    values = [f"{numbers[cell][0]:.2f} [{numbers[cell][1]:.2f}]" for cell in cells]
    mean = np.mean([numbers[cell][0] for cell in cells])
    return [(name, "printed", *values, f"{mean:.2f}", "-", "-", "-")]


def _mean(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return _number(float(np.mean(known)) if known else None)


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _nees(value: float | None, band: tuple[float, float] | None) -> str:
    """NEES; with a star where it lies outside of its band."""
    is_outside = value is not None and band is not None and not band[0] <= value <= band[1]
    return _number(value) + "*" * is_outside


BY_CELL: tuple[tuple[str, str, Callable[[Summary], str]], ...] = (
    ("normalised_score by cell", "0: never sees anything; 1: the omniscient planner, which knows the future.",
     lambda cell: _number(cell.normalised_score, 3)),
    ("share of targets seen by cell", "Targets that were really measured at least once.",
     lambda cell: f"{cell.seen_fraction:.0%}"),
    ("share of the time seen, and the longest time unseen, by cell",
     "Measured targets among all targets of all steps; the longest time [s] without a measurement of any target.",
     lambda cell: f"{cell.seen_step_fraction:.1%}, {cell.longest_unseen_s:.1f} s"),
    ("RMSE by cell [m]", "At the horizon: of all targets; of those seen at least once; of those never seen.",
     lambda cell: " / ".join(map(_number, (cell.rmse_m, cell.rmse_seen_m, cell.rmse_unseen_m)))),
    ("NEES by cell",
     "At the horizon: of all targets (95 % band of a filter that is right); of those seen; of those never seen. "
     "* : outside of its own band.",
     lambda cell: f"{_nees(cell.nees, cell.nees_band)} ({cell.nees_band[0]:.2f} to {cell.nees_band[1]:.2f}) / "
     f"{_nees(cell.nees_seen, cell.nees_seen_band)} / {_nees(cell.nees_unseen, cell.nees_unseen_band)}"),
)  # fmt: skip
"""Title, note and text of the tables that show the summary of every method and cell."""
