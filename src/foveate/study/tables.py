"""Tables of a comparison."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from foveate.evaluation.bounds import Cell
from foveate.evaluation.comparison import Comparison, Overall
from foveate.evaluation.summary import Summary
from foveate.io.grouping import group_by
from foveate.io.tables import Table
from foveate.scenario.factors import Factor
from foveate.study.robustness import ORACLE, Point, Verdict, verdicts

SIGNIFICANT = 0.05

MEANINGS = {
    "surrogate": "The paper's score: information grows softly, also for targets near the view",
    "true": "The score of the running Kalman filter: information only from real measurements",
}

INITIAL_ERRORS = {"paper": "initial errors as in the paper", "consistent": "consistent initial errors"}

PRINTED = {
    "paper: model-based": {
        ("unbiased", 3): (6.71, 1.47), ("unbiased", 5): (6.56, 0.55), ("unbiased", 7): (5.41, 0.85),
        ("biased", 3): (6.87, 1.21), ("biased", 5): (5.96, 0.96), ("biased", 7): (4.92, 1.07),
    },
    "paper: PPO": {
        ("unbiased", 3): (4.57, 2.13), ("unbiased", 5): (3.65, 1.54), ("unbiased", 7): (1.94, 1.70),
        ("biased", 3): (4.23, 1.77), ("biased", 5): (3.27, 1.30), ("biased", 7): (2.01, 1.67),
    },
}  # fmt: skip
"""The paper's own results: mean and standard deviation, by (motion, targets)."""


def tables(comparison: Comparison, protocol: str) -> list[Table]:
    """All tables of one protocol: scores, differences, consistency, quantities by cell, training seeds."""
    shown = [scores(comparison, protocol), differences(comparison, protocol), consistency(comparison, protocol)]
    for title, note, text in BY_CELL:
        shown.append(_table(comparison, protocol, title, note, _by_cell(comparison, protocol, text)))
    if any(cell.protocol == protocol for _, cell in comparison.by_seed):
        shown.append(seeds(comparison, protocol))
    return shown


def scores(comparison: Comparison, protocol: str) -> Table:
    """One row a method; under `surrogate` the paper's own results on top."""
    note = (
        f"{MEANINGS[protocol]}. Mean over scenes (and training seeds) ± half of its 95 % interval. Scenes count as "
        "independent, training seeds as fixed: the table of seeds shows how they differ. In brackets, the paper's "
        "standard deviation over episodes."
    )
    values = _by_cell(comparison, protocol, lambda cell: _interval(cell.mean, cell.ci95))
    table = _table(comparison, protocol, "score per target [nat]", note, values)
    rows = [(*row, *_overall(one)) for row, one in zip(table.rows, _ranked(comparison, protocol), strict=True)]
    cells = _cells(comparison)
    if protocol == "surrogate":
        printed = {name: numbers for name, numbers in PRINTED.items() if numbers.keys() >= set(cells)}
        rows = [_printed(name, [numbers[cell] for cell in cells]) for name, numbers in printed.items()] + rows
    return replace(table, header=(*table.header, "mean", "normalised_score", "seen", "decision [ms]"), rows=tuple(rows))


def differences(comparison: Comparison, protocol: str) -> Table:
    """Every method minus the reference, in the same scenes."""
    note = (
        "Mean of the differences ± half of its 95 % interval (Student), scenes paired. * : p < 0.05 of Wilcoxon's "
        "signed-rank test after Holm's correction for the cells of a row; table.json has all p values."
    )
    values = {
        (one.method, (one.motion, one.targets)): _interval(one.mean, one.ci95, "+") + "*" * (one.p_holm < SIGNIFICANT)
        for one in comparison.differences
        if one.protocol == protocol
    }
    return _table(comparison, protocol, f"difference to {comparison.reference} in the same scenes [nat]", note, values)


def consistency(comparison: Comparison, protocol: str) -> Table:
    """One row a method, means over cells: targets seen, errors, and consistency of the filter."""
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
        title=f"{_where(comparison, protocol)}: targets seen, and consistency of the filter",
        note="Means over cells. Seen: targets measured at least once; of the time: measured targets among all targets "
        "of all steps; longest: the longest time without a measurement of any target. RMSE and NEES at the horizon, of "
        "all targets, of those seen and of those never seen; NEES is the state's length for a consistent filter, more "
        "for an overconfident one. Outside: cells whose NEES lies outside of its 95 % band.",
        header=(
            "method", "kind", "seen", "of the time", "longest [s]", "rmse [m]", "of the seen", "of the never seen",
            "NEES", "of the seen", "of the never seen", "outside",
        ),
        rows=tuple(rows),
    )  # fmt: skip


def robustness(factors: Sequence[Factor], points: Sequence[Point]) -> Table:
    """One row a method and factor, one column a value of the factor: score and normalised score."""
    most = max(len(factor.values) for factor in factors)
    rows = []
    for factor in factors:
        label = f"{factor.label}: {', '.join(f'{x:g}' for x in factor.values)}"
        for method, ours in group_by(verdicts(factor, points), lambda verdict: verdict.method).items():
            rows.append((label, method, *map(_verdict, ours), *[""] * (most - len(ours))))
    return Table(
        title="Scenarios that differ from training by one factor",
        note="Mean score [nat per target] ± half of its 95 % interval (over scenes, after the mean over training "
        "seeds); in brackets, normalised_score: - where the method beats the omniscient planner. Columns are the "
        "values of the factor, in the order of its row.",
        header=("factor", "method", *(f"value {i + 1}" for i in range(most))),
        rows=tuple(rows),
    )


def seeds(comparison: Comparison, protocol: str) -> Table:
    """Every trained policy by itself, and the standard deviation of each method over its seeds."""
    cells, rows = _cells(comparison), []
    ours = [(seed, cell) for seed, cell in comparison.by_seed if cell.protocol == protocol]
    for method, policies in group_by(ours, lambda pair: pair[1].method).items():
        by_cell = {(seed, (cell.motion, cell.targets)): cell.mean for seed, cell in policies}
        names = list(dict.fromkeys(seed for seed, _ in policies))
        means = np.array([[by_cell[seed, cell] for cell in cells] for seed in names])
        means = np.column_stack([means, means.mean(axis=1)])
        lines = {f"seed {seed}": line for seed, line in zip(names, means, strict=True)}
        if len(names) > 1:
            lines["std over seeds"] = means.std(axis=0, ddof=1)
        rows += [(method, name, *(f"{value:.2f}" for value in line)) for name, line in lines.items()]
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
    """Protocol and, unless it is the experiment's own, initial error of beliefs."""
    return protocol if comparison.initial_error is None else f"{protocol}, {INITIAL_ERRORS[comparison.initial_error]}"


def _cells(comparison: Comparison) -> list[Cell]:
    return list(dict.fromkeys((cell.motion, cell.targets) for cell in comparison.summary))


def _label(cell: Cell) -> str:
    return f"{cell[1]} {cell[0]}"


def _ranked(comparison: Comparison, protocol: str) -> list[Overall]:
    """The methods of a protocol, best mean first."""
    return sorted((one for one in comparison.overall if one.protocol == protocol), key=lambda one: -one.mean)


def _interval(mean: float, ci95: tuple[float, float], sign: str = "") -> str:
    return f"{mean:{sign}.2f} ± {(ci95[1] - ci95[0]) / 2:.2f}"


def _verdict(verdict: Verdict) -> str:
    score, normalised = _interval(verdict.mean, verdict.ci95), verdict.normalised_score
    if verdict.method == ORACLE or normalised is None:
        return score
    return f"{score} ({'-' if normalised > 1 else f'{normalised:.2f}'})"


def _overall(one: Overall) -> tuple[str, ...]:
    time_ms = 1e3 * one.step_time_s
    time = f"{time_ms:.3f}" if time_ms < 1 else f"{time_ms:.1f}"
    return f"{one.mean:.2f}", _number(one.normalised_score, 3), f"{one.seen_fraction:.0%}", time


def _printed(name: str, numbers: Sequence[tuple[float, float]]) -> tuple[str, ...]:
    mean = np.mean([mean for mean, _ in numbers])
    return (name, "printed", *(f"{mean:.2f} [{std:.2f}]" for mean, std in numbers), f"{mean:.2f}", "-", "-", "-")


def _mean(values: Sequence[float | None]) -> str:
    numbers = [value for value in values if value is not None]
    return _number(float(np.mean(numbers)) if numbers else None)


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _nees(value: float | None, band: tuple[float, float] | None) -> str:
    """NEES; with a star where it lies outside of its band."""
    is_outside = value is not None and band is not None and not band[0] <= value <= band[1]
    return _number(value) + "*" * is_outside


BY_CELL: tuple[tuple[str, str, Callable[[Summary], str]], ...] = (
    ("normalised_score by cell", "0: the lower bound, never seeing anything; 1: the omniscient planner.",
     lambda cell: _number(cell.normalised_score, 3)),
    ("share of targets seen by cell", "Targets measured at least once.", lambda cell: f"{cell.seen_fraction:.0%}"),
    ("share of the time seen, and the longest time unseen, by cell",
     "Measured targets among all targets of all steps; the longest time [s] without a measurement of any target.",
     lambda cell: f"{cell.seen_step_fraction:.1%}, {cell.longest_unseen_s:.1f} s"),
    ("RMSE by cell [m]", "At the horizon: of all targets; of those seen at least once; of those never seen.",
     lambda cell: " / ".join(map(_number, (cell.rmse_m, cell.rmse_seen_m, cell.rmse_unseen_m)))),
    ("NEES by cell",
     "At the horizon: of all targets (95 % band of a consistent filter); of those seen; of those never seen. "
     "* : outside of its own band.",
     lambda cell: f"{_nees(cell.nees, cell.nees_band)} ({cell.nees_band[0]:.2f} to {cell.nees_band[1]:.2f}) / "
     f"{_nees(cell.nees_seen, cell.nees_seen_band)} / {_nees(cell.nees_unseen, cell.nees_unseen_band)}"),
)  # fmt: skip
"""Title, note and text of the tables that show the summary of every method and cell."""
