"""Figure and flat records of a summary."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from foveate.errors import InputError
from foveate.evaluation.summary import Summary
from foveate.io.figures import CYCLE, DPI, own_axes, tidy
from foveate.io.grouping import group_by


def draw_summary(summary: Sequence[Summary], ax: Axes | None = None) -> Axes:
    """Draw mean scores with their 95 % intervals: a column a cell, a colour a method, hollow marks for `surrogate`.

    An interval of a single scene is not drawn. Returns the axes: `ax`, or those of a new figure. Raises InputError for
    an empty summary.
    """
    if not summary:
        raise InputError("no cell to draw: expected at least one")
    cells = list(dict.fromkeys((cell.targets, cell.motion) for cell in summary))
    series = group_by(summary, lambda cell: (cell.method, cell.protocol))
    protocols = list(dict.fromkeys(protocol for _, protocol in series))
    colors = dict(zip(dict.fromkeys(method for method, _ in series), CYCLE * len(series), strict=False))
    axes, _ = own_axes(ax, 7.0, 3.8, DPI)
    for i, ((method, protocol), ours) in enumerate(series.items()):
        beside = 0.7 * ((i + 0.5) / len(series) - 0.5)
        x = np.array([cells.index((cell.targets, cell.motion)) for cell in ours]) + beside
        mean = np.array([cell.mean for cell in ours])
        bars = np.abs(np.array([cell.ci95 or (math.nan, math.nan) for cell in ours], float).T - mean)
        bars[:, [cell.episodes < 2 for cell in ours]] = np.nan
        label = method if len(protocols) == 1 else f"{method}, {protocol}"
        style: dict[str, Any] = {"color": colors[method], "mfc": "white" if protocol == "surrogate" else colors[method]}
        axes.errorbar(x, mean, bars, ls="none", marker="o", ms=5, elinewidth=1.2, capsize=2, label=label, **style)
    tidy(axes, "targets and their motion", "score [nat per target], 95 % interval")
    axes.set_xticks(range(len(cells)), [f"{targets} {motion}" for targets, motion in cells])
    axes.set_xlim(-0.5, len(cells) - 0.5)
    axes.legend(fontsize=8.5, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return axes


def flat(record: Any) -> dict[str, Any]:
    """Fields of a dataclass as numbers and texts: an interval as `.._low` and `.._high`, None as NaN."""
    values: dict[str, Any] = {}
    for name, value in asdict(record).items():
        if name.endswith(("ci95", "band")):
            values[f"{name}_low"], values[f"{name}_high"] = value or (math.nan, math.nan)
        else:
            values[name] = math.nan if value is None else value
    return values
