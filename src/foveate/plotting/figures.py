"""Figures of results: episodes as they unfold, learning curves, recordings. Reads, never simulates."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from foveate.errors import InputError
from foveate.experiment.run_folder import METRICS, Validation, read_validations
from foveate.geometry.numpy_poses import positions, rotation
from foveate.plotting import scene as drawing
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData
from foveate.plotting.scene import AGENT, GREY, PALE, SEEN, VERMILLION, clean
from foveate.plotting.scene_spatial import scene_class

WIDTH = 9.0
"""Inches; at README width (about 900 pixels) a point is then 1.4 pixels."""

COLUMNS = 4

TITLE: dict[str, Any] = {"fontsize": 9, "fontweight": "bold"}
LEGEND: dict[str, Any] = {"loc": "outside lower center", "frameon": False}


def trajectory_figure(episodes: Sequence[EpisodeData], path: Path) -> None:
    """Draw a row for each episode: its start, a third, two thirds and its end.

    Each panel shows the agent and its path so far, its field of view, the targets (squares) with their tracks so far,
    and the beliefs: mean (cross) and 95 % ellipse or ellipsoid, solid if the target was measured at that instant,
    dashed if not. Episodes that begin with the same targets share their limits. Raises InputError for no episode.
    """
    if not episodes:
        raise InputError("no episode to draw: expected at least one")
    heights = [WIDTH / COLUMNS * scene_class(data).panel_shape + 0.3 for data in episodes]
    figure = drawing.new_figure(WIDTH, sum(heights) + 0.3)
    rows = figure.subfigures(len(episodes), 1, squeeze=False, height_ratios=heights)[:, 0]
    for row, data in zip(rows, episodes, strict=True):
        row.suptitle(drawing.describe(data), x=0.01, ha="left", **TITLE)
        kind, alike = scene_class(data), [other for other in episodes if other.truth.shape == data.truth.shape]
        box = kind.limits([other for other in alike if np.allclose(data.truth[:1], other.truth[:1])])
        for column in range(COLUMNS):
            instant = round(data.steps * column / (COLUMNS - 1))
            axes: Any = row.add_subplot(1, COLUMNS, column + 1, axes_class=kind.axes_class)
            scene = kind(axes, data, box, scale=kind.panel_scale)
            scene.show(SUBSTEPS * instant)
            scene.label(kind.panel_text, x=row is rows[-1], y=column == 0)
            axes.set_title(f"t = {data.times_s[instant]:g} s", fontsize=8.5, pad=3)
    figure.legend(handles=drawing.legend_entries(), ncols=5, fontsize=8.5, **LEGEND)
    drawing.save(figure, path)


def learning_curve(runs: Path | Sequence[Path], path: Path) -> None:
    """Draw objectives of training batches (thin) and the held-out score (bold) over iterations, for one or more runs.

    `runs` are run folders or their `metrics.jsonl`. A star marks the best validation, a dotted vertical line a collapse
    or a value that was not finite; seconds stand along the top for one run, in the legend for several. Raises
    InputError for no run, and for a file without a validation.
    """
    files = [run / METRICS if run.is_dir() else run for run in ([runs] if isinstance(runs, Path) else runs)]
    if not files:
        raise InputError("no run to draw: expected at least one")
    histories = [read_validations(file) for file in files]
    figure = drawing.new_figure(WIDTH, 4.0 + 0.07 * len(files))
    axes, single = figure.subplots(), len(files) == 1
    for file, validations, color in zip(files, histories, itertools.cycle(drawing.CYCLE), strict=False):
        epochs = [each.epoch for each in validations]
        axes.plot(epochs, [each.objective for each in validations], color=color, lw=0.9, alpha=0.6)
        label = "held-out score" if single else file.resolve().parent.name
        # Each best so far is marked: the last of them is the best of all, whose policy training keeps.
        for best in [each for each in validations if each.best][-1:]:
            axes.plot(best.epoch, best.held_out, marker="*", ms=13, color=color, mec="white", mew=0.8, zorder=5)
            label += f": best {best.held_out:.2f} at iteration {best.epoch}"
        label += "" if single else f", {validations[-1].elapsed_s:.0f} s"
        axes.plot(epochs, [each.held_out for each in validations], color=color, lw=2, label=label)
        for each in validations:
            if each.event:
                axes.axvline(each.epoch, color=VERMILLION if single else color, ls=":", lw=1.2)
    clean(axes, 9.0)
    axes.grid(color=PALE, lw=0.6)
    axes.set_xlabel("iteration", fontsize=9.5)
    axes.set_ylabel("log det of information [nat per target]", fontsize=9.5)
    axes.margins(x=0.01, y=0.1)
    if single:
        _seconds_on_top(axes, histories[0])
    collapsed = any(each.event for validations in histories for each in validations)
    handles = axes.get_legend_handles_labels()[0] + _curve_legend(single, collapsed)
    figure.legend(handles=handles, ncols=4 if single else 3, fontsize=9, **LEGEND)
    drawing.save(figure, path)


def _curve_legend(single: bool, collapsed: bool) -> list[Line2D]:
    color, event_color = (drawing.CYCLE[0], VERMILLION) if single else (GREY, GREY)
    several = [] if single else [Line2D([], [], color=color, lw=2, label="held-out score")]
    events = [Line2D([], [], color=event_color, ls=":", lw=1.2, label="collapse, rollback")] if collapsed else []
    objective = Line2D([], [], color=color, lw=0.9, alpha=0.6, label="training objective")
    return [*several, objective, Line2D([], [], color=color, ls="none", marker="*", ms=11, label="best, kept"), *events]


def _seconds_on_top(axes: Axes, validations: Sequence[Validation]) -> None:
    """Add a second x axis: the time [s] at which an iteration ended."""
    top = axes.twiny()
    top.set_xlim(axes.get_xlim())
    epochs = [0, *(each.epoch for each in validations)]
    ticks = [tick for tick in axes.get_xticks() if 0 <= tick <= epochs[-1]]
    seconds = np.interp(ticks, epochs, [0.0, *(each.elapsed_s for each in validations)])
    top.set_xticks(ticks, [f"{value:.0f} s" for value in seconds])
    clean(top, 9.0)
    top.tick_params(labelcolor=GREY)


def replay_figure(episodes: Mapping[str, EpisodeData], path: Path) -> None:
    """Draw a recording as several methods saw it; map and timeline are those of the first.

    Left, the map (in space: from above and from the side): every target's track in grey, in colour while it was seen,
    and the agent's path, which begins at the triangle. Right, the timeline: a row for each slot, which holds one target
    after another, light while one is present, dark while it is seen; below it each method's share of target time seen.
    Raises InputError for no episode.
    """
    if not episodes:
        raise InputError("no episode to draw: expected at least one")
    name, data = next(iter(episodes.items()))
    bars = 0.26 * len(episodes) + 0.25
    height = max(3.4 + 1.0 * len(scene_class(data).planes), 2.9 + bars)
    figure = drawing.new_figure(WIDTH, height)
    left, right = figure.subfigures(1, 2, squeeze=False)[0]
    _maps(left, data, name)
    timeline, shares = right.subplots(2, 1, height_ratios=(height - 0.9 - bars, bars))
    _timeline(timeline, data, name)
    _shares(shares, episodes)
    handles = [
        Line2D([], [], color=AGENT, lw=1.3, marker=">", ms=5, label=f"agent ({name})"),
        Line2D([], [], color=GREY, lw=0.8, label="target"),
        Line2D([], [], color=SEEN, lw=2.2, label="target while seen"),
        Patch(facecolor=PALE, label="target present"),
        Patch(facecolor=SEEN, label="seen"),
    ]
    figure.legend(handles=handles, ncols=5, fontsize=8.5, **LEGEND)
    drawing.save(figure, path)


def _maps(part: SubFigure, data: EpisodeData, name: str) -> None:
    """Draw a map for each pair of axes of the space, one above the other, on one scale."""
    planes = scene_class(data).planes
    points = np.concatenate([data.truth[data.present], positions(data.pose)])
    low, high = points.min(axis=0), points.max(axis=0)
    pad = max(0.05 * (high - low).max(), 0.5)
    heights = [(high - low + 2 * pad)[up] for _, up in planes]
    sides = part.subplots(len(planes), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for axes, plane in zip(sides, planes, strict=True):
        _map(axes, data, plane)
        if len(planes) > 1:
            axes.set_aspect("equal", adjustable="box")
            (left, bottom), (right, top) = (low - pad)[list(plane)], (high + pad)[list(plane)]
            axes.set(xlim=(left, right), ylim=(bottom, top))
        axes.label_outer()
    sides[0].set_title(f"what {name} saw where", loc="left", **TITLE)


def _map(axes: Axes, data: EpisodeData, plane: tuple[int, int]) -> None:
    """Draw tracks, their seen parts, and the agent's path, in the plane of two axes of the world."""
    truth, arc = data.truth[..., plane], data.arc()
    axes.plot(*drawing.broken(truth, data.present).T, color=GREY, lw=0.6, alpha=0.8)
    ends = np.stack([truth[:-1], truth[1:]], axis=2)
    axes.add_collection(LineCollection(list(ends[data.visible & data.counted]), colors=SEEN, lw=2.2, zorder=3))
    path, nose = positions(arc)[:, plane], rotation(arc[0])[plane, 0]
    axes.plot(*path.T, color=AGENT, lw=1.1, alpha=0.85, zorder=4)
    heading = (3, 0, np.degrees(np.arctan2(nose[1], nose[0])) - 90)
    axes.plot(*path[0], color=AGENT, marker=heading, ms=9, mec="white", mew=0.8, zorder=5)
    axes.set_aspect("equal", adjustable="datalim")
    clean(axes)
    for set_label, axis in zip((axes.set_xlabel, axes.set_ylabel), plane, strict=True):
        set_label(f"{'xyz'[axis]} [m]", fontsize=8.5, labelpad=3)


def _timeline(axes: Axes, data: EpisodeData, name: str) -> None:
    """Draw a row for each target over time: present or not, seen or not."""
    end, seen = data.times_s[-1], data.visible & data.counted
    for column in range(data.targets):
        # The edge keeps a glimpse of one step visible where a step is less than a pixel.
        for flags, color, edge in ((data.counted, PALE, 0.0), (seen, SEEN, 0.5)):
            changes = np.flatnonzero(np.diff(flags[:, column].astype(int), prepend=0, append=0))
            spans = [(start, stop - start) for start, stop in data.times_s[changes].reshape(-1, 2)]
            axes.broken_barh(spans, (column + 0.6, 0.8), facecolor=color, edgecolor=color, lw=edge)
    axes.set_xlim(0, end)
    axes.set_ylim(max(data.targets, 1) + 0.5, 0.5)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    clean(axes)
    axes.set_ylabel("target slot", fontsize=8.5, labelpad=4)
    axes.set_xlabel("time [s]", fontsize=8.5, labelpad=3)
    axes.set_title(f"when {name} saw which", loc="left", **TITLE)


def _shares(axes: Axes, episodes: Mapping[str, EpisodeData]) -> None:
    """Draw each method's share of target time seen."""
    values = [100 * data.seen_share for data in episodes.values()]
    bars = axes.barh(list(episodes), values, color=[SEEN, *[GREY] * (len(episodes) - 1)], height=0.65)
    axes.bar_label(bars, [f"{value:.1f} %" for value in values], fontsize=8.5, padding=3)
    axes.set_xlim(0, max(1.0, 1.18 * max(values)))
    axes.invert_yaxis()
    clean(axes, 8.5)
    axes.set_xticks([])
    axes.tick_params(labelcolor=drawing.BLACK, length=0)
    for side in ("top", "right", "bottom"):
        axes.spines[side].set_visible(False)
    axes.set_title("share of target time seen", loc="left", **TITLE)
