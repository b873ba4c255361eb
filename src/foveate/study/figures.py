"""Figures of a comparison: score against decision time, score against factors that differ from training."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.rcsetup import cycler
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from foveate.errors import InputError
from foveate.io.figures import (
    BLACK,
    BLUE,
    DPI,
    GREEN,
    GREY,
    LEGEND,
    ORANGE,
    PALE,
    PURPLE,
    VERMILLION,
    WIDTH,
    clean,
    literal,
    new_figure,
    save,
    tidy,
)
from foveate.io.grouping import group_by
from foveate.plotting.figures import COLUMNS
from foveate.scenario.factors import Factor
from foveate.study.comparison import Overall
from foveate.study.comparison_figures import log_axis
from foveate.study.labels import place_labels
from foveate.study.robustness import ORACLE, Verdict

FAMILIES: dict[str, dict[str, Any]] = {
    "trained": {"color": BLUE, "marker": "o"},
    "trained, refined": {"color": PURPLE, "marker": "D"},
    "planned": {"color": GREEN, "marker": "s"},
    "heuristic": {"color": VERMILLION, "marker": "^"},
}
OTHER_FAMILY: dict[str, Any] = {"color": BLACK, "marker": "o"}

STYLES = list(cycler(color=[BLUE, VERMILLION, GREEN, PURPLE, ORANGE], marker=list("o^sDv"), linestyle=["-"] * 5))
"""Styles of the methods under changed factors, in their order."""

DASHED: dict[str, Any] = {"color": BLACK, "marker": "", "linestyle": "--"}


def pareto_figure(
    overall: Sequence[Overall], path: Path | str | None = None, *, width: float = WIDTH, dpi: int = DPI
) -> Figure:
    """Draw score against decision time, a panel a protocol, with the Pareto front.

    The omniscient planner, which needs the future, is a dashed line, where no method scores more: it is a reference,
    and no bound. Returns the figure, written to a path, if any. Raises InputError without methods.
    """
    if not overall:
        raise InputError("no method to draw: expected at least one")
    protocols = group_by(overall, lambda method: method.protocol)
    figure = new_figure(width, 4.6, dpi)
    panels = figure.subplots(1, len(protocols), squeeze=False, sharey=True)[0]
    for axes, (protocol, methods) in zip(panels, protocols.items(), strict=True):
        _pareto_panel(axes, [method for method in methods if method.family != "omniscient"])
        for oracle in shown_references(methods):
            axes.axhline(oracle.mean, color=BLACK, ls="--", lw=1)
            axes.annotate(
                f"omniscient {oracle.mean:.2f}", (0.01, oracle.mean), (0, 3), xycoords=axes.get_yaxis_transform(),
                textcoords="offset points", fontsize=8.5,
            )  # fmt: skip
        axes.set_title(f"{protocol} score", fontsize=10, fontweight="bold", loc="left")
    panels[0].set_ylabel("score [nat per target], mean over cells", fontsize=9.5)
    families = dict.fromkeys(method.family for method in overall if method.family != "omniscient")
    entries = [Line2D([], [], ls="none", ms=6, label=name, **FAMILIES.get(name, OTHER_FAMILY)) for name in families]
    entries.append(Line2D([], [], color=GREY, lw=1.2, label="Pareto front"))
    figure.legend(handles=entries, ncols=5, fontsize=9, **LEGEND)
    literal(figure)
    figure.draw_without_rendering()  # places the panels, in which labels then find their places
    for axes, methods in zip(panels, protocols.values(), strict=True):
        place_labels(
            axes,
            [
                (1e3 * method.step_time_s, method.mean, method.method)
                for method in methods
                if method.family != "omniscient"
            ],
            [oracle.mean for oracle in shown_references(methods)],
        )
    return save(figure, path)


def shown_references(methods: Sequence[Overall]) -> list[Overall]:
    """The omniscient planners above all methods: a local optimum, below what it is a reference for, would mislead."""
    best = max((method.mean for method in methods if method.family != "omniscient"), default=-math.inf)
    return [method for method in methods if method.family == "omniscient" and method.mean >= best]


def pareto_front(overall: Sequence[Overall]) -> list[Overall]:
    """Methods that score more than all that decide as fast or faster, fastest first."""
    front: list[Overall] = []
    for method in sorted(overall, key=lambda method: (method.step_time_s, -method.mean)):
        if not front or method.mean > front[-1].mean:
            front.append(method)
    return front


def _pareto_panel(axes: Axes, overall: Sequence[Overall]) -> None:
    front = pareto_front(overall)
    times_ms = [1e3 * method.step_time_s for method in front]
    axes.step(times_ms, [method.mean for method in front], where="post", color=GREY, lw=1.2)
    for method in overall:
        style = FAMILIES.get(method.family, OTHER_FAMILY)
        axes.plot(1e3 * method.step_time_s, method.mean, ms=6, mec="white", mew=0.6, zorder=5, **style)
    tidy(axes, "time of a decision [ms]")
    axes.margins(y=0.08)
    log_axis(axes, (1.0,), right=4.0)


def robustness_figure(
    factors: Sequence[Factor],
    verdicts: Mapping[str, Sequence[Verdict]],
    path: Path | str | None,
    label: str,
    *,
    width: float = WIDTH,
    dpi: int = DPI,
) -> Figure:
    """Draw mean score with its 95 % interval against each factor; `label` names the score.

    `verdicts` are by the factor's name. The omniscient planner, a reference and no bound, is a dashed line, left out
    where a method scores more; the lower bound is a dotted one, and the range of training a grey band. Returns the
    figure, written to a path, if any. Raises InputError without factors.
    """
    if not factors:
        raise InputError("no factor to draw: expected at least one")
    rows, columns = -(-len(factors) // COLUMNS), min(COLUMNS, len(factors))
    figure = new_figure(width, 2.35 * rows + 0.5, dpi)
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True)
    names = dict.fromkeys(verdict.method for factor in factors for verdict in verdicts[factor.name])
    styles = {**dict(zip((n for n in names if n != ORACLE), STYLES * len(names), strict=False)), ORACLE: DASHED}
    for axes, factor in zip(panels.flat, factors, strict=False):
        _panel(axes, factor, verdicts[factor.name], styles)
    for axes in panels.flat[len(factors) :]:
        axes.remove()
    for row in panels:
        row[0].set_ylabel(label, fontsize=9)
    entries: list[Artist] = [Line2D([], [], lw=1.6, ms=5, label=name, **styles[name]) for name in names]
    entries.append(Line2D([], [], color=GREY, ls=":", lw=1.4, label="lower bound"))
    entries.append(Patch(facecolor=PALE, label="as in training"))
    entries.append(Line2D([], [], ls="none", marker="|", ms=9, mew=1.0, color=BLACK, label="95 % interval"))
    figure.legend(handles=entries, ncols=6, fontsize=9, **LEGEND)
    return save(figure, path)


def _best_at(value: float, verdicts: Sequence[Verdict]) -> float:
    """Largest mean of a method that does not know the future, at a value of the factor."""
    return max((one.mean for one in verdicts if one.value == value and one.method != ORACLE), default=-math.inf)


def _panel(axes: Axes, factor: Factor, verdicts: Sequence[Verdict], styles: Mapping[str, dict[str, Any]]) -> None:
    values = np.array(factor.values)
    # Evenly spaced values have a linear axis, geometric ones a logarithmic axis: ticks are evenly spaced on both.
    is_even = np.allclose(np.diff(values, 2), 0.0)
    axes.set_xscale("linear" if is_even else "log")
    steps = np.diff(values) if is_even else values[1:] / values[:-1]
    gap = steps[0] if len(steps) else values[0]  # a single value has a gap of its own size
    low, high = factor.trained
    band = (low - 0.12 * gap, high + 0.12 * gap) if is_even else (low / gap**0.12, high * gap**0.12)
    axes.axvspan(*band, color=PALE, lw=0, zorder=0)
    for method, ours in group_by(verdicts, lambda verdict: verdict.method).items():
        x, mean = [verdict.value for verdict in ours], np.array([verdict.mean for verdict in ours])
        if method == ORACLE:  # NaN is not drawn
            mean = np.array([one.mean if one.mean >= _best_at(one.value, verdicts) else np.nan for one in ours])
        bars = None if method == ORACLE else np.abs(np.array([verdict.ci95 for verdict in ours]).T - mean)
        axes.errorbar(x, mean, bars, lw=1.5, ms=4.5, elinewidth=1.0, capsize=2, **styles[method])
    lower_bounds = {verdict.value: verdict.lower_bound for verdict in verdicts}
    axes.plot(list(lower_bounds), list(lower_bounds.values()), color=GREY, ls=":", lw=1.4)
    axes.xaxis.set_major_locator(FixedLocator(list(factor.values)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:.3g}"))
    axes.grid(axis="y", color=PALE, lw=0.6)
    clean(axes, 8.5)
    axes.set_xlabel(factor.label, fontsize=9)
