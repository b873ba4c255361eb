"""Score against what differs from training, a panel a factor. Reads, never simulates."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from foveate.errors import InputError
from foveate.plotting.figures import WIDTH
from foveate.plotting.scene import BLACK, BLUE, GREEN, GREY, ORANGE, PALE, PURPLE, VERMILLION, clean, new_figure, save
from foveate.study.robustness import ORACLE, Factor, Verdict

COLUMNS = 4

STYLES = ((BLUE, "o", "-"), (VERMILLION, "^", "-"), (GREEN, "s", "-"), (PURPLE, "D", "-"), (ORANGE, "v", "-"))
"""Colour, marker and line of the methods, in the order in which they are given."""

DASHED = (BLACK, "", "--")


def robustness_figure(
    factors: Sequence[Factor], found: Mapping[str, Sequence[Verdict]], path: Path, label: str
) -> None:
    """Mean score with its 95 % interval against each factor; `found` has the verdicts by the factor's name, `label`
    says what was scored.

    The omniscient planner in the same world is a dashed line, never seeing anything a dotted one, and what training
    knew a grey band. All panels share the score's axis. Raises ValueError for no factor.
    """
    if not factors:
        raise InputError("no factor to draw: expected at least one")
    rows = -(-len(factors) // COLUMNS)
    columns = min(COLUMNS, len(factors))
    figure = new_figure(WIDTH, 2.35 * rows + 0.5)
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True)
    names = list(dict.fromkeys(one.method for factor in factors for one in found[factor.name]))
    by_hand_or_trained = [name for name in names if name != ORACLE]
    styles = {**dict(zip(by_hand_or_trained, STYLES * len(names), strict=False)), ORACLE: DASHED}
    for axes, factor in zip(panels.flat, factors, strict=False):
        _panel(axes, factor, found[factor.name], styles)
    for axes in panels.flat[len(factors) :]:
        axes.remove()
    for row in panels:
        row[0].set_ylabel(label, fontsize=9)
    lines = {name: Line2D([], [], color=styles[name][0], marker=styles[name][1], ls=styles[name][2], lw=1.6, ms=5,
                          label=name) for name in names}  # fmt: skip
    floor = Line2D([], [], color=GREY, ls=":", lw=1.4, label="never sees anything")
    entries = [*lines.values(), floor, Patch(facecolor=PALE, label="as in training")]
    figure.legend(handles=entries, loc="outside lower center", ncols=6, fontsize=9, frameon=False)
    save(figure, path)


def _panel(axes: Axes, factor: Factor, verdicts: Sequence[Verdict], styles: Mapping[str, tuple[str, str, str]]) -> None:
    values = np.array(factor.values)
    # Where neighbours differ by the same factor, so do ticks; panels whose values are evenly spaced stay linear.
    is_even = np.allclose(np.diff(values, 2), 0.0)
    axes.set_xscale("linear" if is_even else "log")
    steps = np.diff(values) if is_even else values[1:] / values[:-1]
    gap = steps[0] if len(steps) else values[0]  # of a single value: as wide as it is large
    low, high = factor.trained
    band = (low - 0.12 * gap, high + 0.12 * gap) if is_even else (low / gap**0.12, high * gap**0.12)
    axes.axvspan(*band, color=PALE, lw=0, zorder=0)
    for method in dict.fromkeys(one.method for one in verdicts):
        ours = [one for one in verdicts if one.method == method]
        color, marker, line = styles[method]
        x, mean = [one.value for one in ours], np.array([one.mean for one in ours])
        bars = None if method == ORACLE else np.abs(np.array([one.ci95 for one in ours]).T - mean)
        axes.errorbar(x, mean, bars, color=color, marker=marker, ls=line, lw=1.5, ms=4.5, elinewidth=1.0, capsize=2)
    floors = {one.value: one.floor for one in verdicts}
    axes.plot(list(floors), list(floors.values()), color=GREY, ls=":", lw=1.4)
    axes.xaxis.set_major_locator(FixedLocator(list(factor.values)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:.3g}".lstrip("0") if 0 < x < 1 else f"{x:g}"))
    axes.grid(axis="y", color=PALE, lw=0.6)
    clean(axes, 8.5)
    axes.set_xlabel(factor.label, fontsize=9)
