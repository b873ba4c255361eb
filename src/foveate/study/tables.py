"""Tables of a comparison."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from foveate.evaluation.bounds import Cell
from foveate.evaluation.summary import Summary
from foveate.evaluation.summary_table import number, plus_minus
from foveate.io.grouping import group_by
from foveate.io.tables import Table
from foveate.scenario.factors import Factor
from foveate.study.comparison import Comparison, Overall
from foveate.study.robustness import ORACLE, Point, Verdict, verdicts

SIGNIFICANT = 0.05

Row = Callable[[Overall, list[Summary]], Iterable[str]]
"""Makes the row of a method from its means and its summary of every cell."""

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
        shown.append(_table(comparison, protocol, title, note, _cells(comparison), _by_cell(text)))
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

    def row(method: Overall, summary: Sequence[Summary]) -> list[str]:
        time_ms = 1e3 * method.step_time_s
        time = f"{time_ms:.3f}" if time_ms < 1 else f"{time_ms:.1f}"
        means = f"{method.mean:.2f}", number(method.normalised_score, 3), f"{method.seen_fraction:.0%}", time
        return [*(plus_minus(cell.mean, cell.interval) for cell in summary), *means]

    cells = _cells(comparison)
    columns = (*cells, "mean", "normalised", "detected", "decision [ms]")
    table = _table(comparison, protocol, "score per target [nat]", note, columns, row)
    if protocol != "surrogate":
        return table
    printed = {name: numbers for name, numbers in PRINTED.items() if numbers.keys() >= set(cells.values())}
    rows = (_printed(name, [numbers[cell] for cell in cells.values()]) for name, numbers in printed.items())
    return replace(table, rows=(*rows, *table.rows))


def differences(comparison: Comparison, protocol: str) -> Table:
    """Every method minus the reference, in the same scenes."""
    note = (
        "Mean of the differences ± half of its 95 % interval (Student), scenes paired. * : p < 0.05 of Wilcoxon's "
        "signed-rank test after Holm's correction for the cells of a row; table.json has all p values."
    )
    ours = {(d.method, d.motion, d.targets): d for d in comparison.differences if d.protocol == protocol}

    def text(cell: Summary) -> str:
        difference = ours[cell.method, cell.motion, cell.targets]
        interval = difference.ci95 if difference.scenes > 1 else None
        return plus_minus(difference.mean, interval, "+") + "*" * (difference.p_holm < SIGNIFICANT)

    others = replace(comparison, overall=tuple(o for o in comparison.overall if o.method != comparison.reference))
    title = f"difference to {comparison.reference} in the same scenes [nat]"
    return _table(others, protocol, title, note, _cells(comparison), _by_cell(text))


def consistency(comparison: Comparison, protocol: str) -> Table:
    """One row a method, means over cells: targets seen, errors, and consistency of the filter."""

    def row(method: Overall, summary: Sequence[Summary]) -> list[str]:
        step_fraction = np.mean([cell.seen_step_fraction for cell in summary])
        unseen_s = np.mean([cell.longest_unseen_s for cell in summary])
        names = ("rmse_m", "rmse_seen_m", "rmse_unseen_m", "nees", "nees_seen", "nees_unseen")
        errors = (_mean([getattr(cell, name) for cell in summary]) for name in names)
        found = [(cell.nees, cell.nees_band) for cell in summary if cell.nees is not None]
        outside = sum(not low <= nees <= high for nees, (low, high) in found)
        seen = (f"{method.seen_fraction:.0%}", f"{step_fraction:.1%}", f"{unseen_s:.1f}")
        return [*seen, *errors, f"{outside} of {len(summary)}"]

    note = (
        "Means over cells. Detected: targets measured at least once; in view: measured targets among all targets "
        "of all steps; longest gap: the longest time without a measurement of any target. RMSE and NEES at the "
        "horizon, of all targets, of those detected and of those never detected; NEES is the state's length for a "
        "consistent filter, more for an overconfident one. Outside: cells whose NEES lies outside of its 95 % band."
    )
    errors = [f"{name}{group}" for name in ("RMSE [m]", "NEES") for group in ("", " of detected", " of undetected")]
    columns = ("detected", "in view", "longest gap [s]", *errors, "outside")
    return _table(comparison, protocol, "targets detected, and consistency of the filter", note, columns, row)


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
        keys=2,
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
        means = np.array([[by_cell[seed, cell] for cell in cells.values()] for seed in names])
        means = np.column_stack([means, means.mean(axis=1)])
        lines = {f"seed {seed}": line for seed, line in zip(names, means, strict=True)}
        if len(names) > 1:
            lines["std over seeds"] = means.std(axis=0, ddof=1)
        rows += [(method, name, *(f"{value:.2f}" for value in line)) for name, line in lines.items()]
    return Table(
        title=f"{_where(comparison, protocol)}: training seeds [nat]",
        note="Mean score of each trained policy over the scenes of a cell, and the standard deviation of these means.",
        keys=2,
        header=("method", "policy", *cells, "mean"),
        rows=tuple(rows),
    )


def _table(comparison: Comparison, protocol: str, title: str, note: str, columns: Iterable[str], row: Row) -> Table:
    """One row a method, best mean first."""
    summaries = {(c.method, (c.motion, c.targets)): c for c in comparison.summary if c.protocol == protocol}
    ranked = sorted((method for method in comparison.overall if method.protocol == protocol), key=lambda m: -m.mean)
    rows = []
    for method in ranked:
        summary = [summaries[method.method, cell] for cell in _cells(comparison).values()]
        rows.append((method.method, method.family, *row(method, summary)))
    title = f"{_where(comparison, protocol)}: {title}"
    return Table(title=title, note=note, header=("method", "kind", *columns), rows=tuple(rows))


def _by_cell(text: Callable[[Summary], str]) -> Row:
    return lambda overall, summary: map(text, summary)


def _where(comparison: Comparison, protocol: str) -> str:
    """Protocol and, unless it is the experiment's own, initial error of beliefs."""
    return protocol if comparison.initial_error is None else f"{protocol}, {INITIAL_ERRORS[comparison.initial_error]}"


def _cells(comparison: Comparison) -> dict[str, Cell]:
    """The cells by their labels."""
    return {f"{cell.targets} {cell.motion}": (cell.motion, cell.targets) for cell in comparison.summary}


def _verdict(verdict: Verdict) -> str:
    score, normalised = plus_minus(verdict.mean, verdict.ci95), verdict.normalised_score
    if verdict.method == ORACLE or normalised is None:
        return score
    return f"{score} ({'-' if normalised > 1 else f'{normalised:.2f}'})"


def _printed(name: str, numbers: Sequence[tuple[float, float]]) -> tuple[str, ...]:
    mean = np.mean([mean for mean, _ in numbers])
    return (name, "printed", *(f"{mean:.2f} [{std:.2f}]" for mean, std in numbers), f"{mean:.2f}", "-", "-", "-")


def _mean(values: Sequence[float | None]) -> str:
    numbers = [value for value in values if value is not None]
    return number(float(np.mean(numbers)) if numbers else None)


def _nees(value: float | None, band: tuple[float, float] | None) -> str:
    """NEES; with a star where it lies outside of its band."""
    is_outside = value is not None and band is not None and not band[0] <= value <= band[1]
    return number(value) + "*" * is_outside


BY_CELL: tuple[tuple[str, str, Callable[[Summary], str]], ...] = (
    ("normalised_score by cell", "0: the lower bound, never seeing anything; 1: the omniscient planner, no bound.",
     lambda cell: number(cell.normalised_score, 3)),
    ("share of targets detected by cell", "Targets measured at least once.", lambda cell: f"{cell.seen_fraction:.0%}"),
    ("share of the time in view, and the longest gap, by cell",
     "Measured targets among all targets of all steps; the longest time [s] without a measurement of any target.",
     lambda cell: f"{cell.seen_step_fraction:.1%}, {cell.longest_unseen_s:.1f} s"),
    ("RMSE by cell [m]", "At the horizon: of all targets; of those detected; of those never detected.",
     lambda cell: " / ".join(map(number, (cell.rmse_m, cell.rmse_seen_m, cell.rmse_unseen_m)))),
    ("NEES by cell",
     "At the horizon: of all targets (95 % band of a consistent filter); of those detected; of those never detected. "
     "* : outside of its own band.",
     lambda cell: f"{_nees(cell.nees, cell.nees_band)} ({cell.nees_band[0]:.2f} to {cell.nees_band[1]:.2f}) / "
     f"{_nees(cell.nees_seen, cell.nees_seen_band)} / {_nees(cell.nees_unseen, cell.nees_unseen_band)}"),
)  # fmt: skip
"""Title, note and text of the tables that show the summary of every method and cell."""
