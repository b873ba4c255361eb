"""Figures of results: episodes as they unfold, learning curves, recordings. Reads, never simulates."""

import itertools
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from foveate.errors import InputError
from foveate.experiment.run_folder import METRICS, Validation, read_validations
from foveate.io.figures import (
    CYCLE,
    DPI,
    GREY,
    LEGEND,
    NARROW,
    TITLE,
    VERMILLION,
    WIDTH,
    drawable,
    new_figure,
    own_axes,
    save,
    tidy,
)
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData
from foveate.plotting.scene import PlanarScene, describe, legend_entries
from foveate.plotting.scene_spatial import SpatialScene, scene_class

COLUMNS = 4
"""Instants of an episode that are drawn side by side; half as many in a narrow figure."""


def trajectory_figure(
    episodes: Sequence[EpisodeData], path: Path | str | None = None, *, width: float = WIDTH, dpi: int = DPI
) -> Figure:
    """Draw a row for each episode: its start, a third, two thirds and its end; in a narrow figure start and end.

    Each panel shows the agent and its path so far, its field of view, the targets (squares) with their tracks so far,
    and the beliefs: mean (cross) and 95 % ellipse or ellipsoid, solid if the target was measured at that instant,
    dashed if not. Episodes that begin with the same targets share their limits.

    Args:
        episodes: Episodes, a row each.
        path: File to write, .png, .pdf or .svg; None: none.
        width: Width [inches]: 9 for a page, 3.5 for a column.
        dpi: Dots per inch of a .png.

    Returns:
        The figure.

    Raises:
        InputError: There is no episode, or an argument is out of range.
    """
    if not episodes:
        raise InputError("no episode to draw: expected at least one")
    columns = COLUMNS if width >= NARROW else COLUMNS // 2
    legend_rows = 1 if width >= WIDTH else 5 if width < NARROW else 2
    heights = row_heights([scene_class(data).panel_shape for data in episodes], width, columns)
    entries = legend_entries(episodes)
    legend_rows += width < NARROW and len(entries) > 5
    figure = new_figure(width, sum(heights) + 0.15 + 0.18 * legend_rows, dpi)
    rows = figure.subfigures(len(episodes), 1, squeeze=False, height_ratios=heights)[:, 0]
    for row, data in zip(rows, episodes, strict=True):
        shrink(row.suptitle(drawable(describe(data)), x=0.01, ha="left", **TITLE), width)
        alike = [other for other in episodes if other.truth.shape == data.truth.shape]
        box = scene_class(data).limits([other for other in alike if np.allclose(data.truth[:1], other.truth[:1])])
        for column in range(columns):
            instant = round(data.steps * column / (columns - 1))
            axes: Any = row.add_subplot(1, columns, column + 1, axes_class=scene_class(data).axes_class)
            draw_scene(axes, data, instant, box, first=column == 0, last=row is rows[-1])
            if width < NARROW and data.space.dimension == 2:
                axes.locator_params(nbins=4)  # more numbers would touch each other
    legend_within(figure, entries, legend_rows)
    return save(figure, path)


def legend_within(figure: Figure, entries: Sequence[Artist], rows: int) -> None:
    """Draw a legend in `rows` rows, or in more, with a higher figure, where it would be wider than the figure."""
    while True:
        columns = -(-len(entries) // rows)
        legend = figure.legend(handles=list(entries), ncols=columns, fontsize=8.5, **LEGEND)
        if columns == 1 or legend.get_window_extent().width <= figure.bbox.width:
            return
        legend.remove()
        rows += 1
        figure.set_figheight(figure.get_figheight() + 0.18)


def shrink(title: Text, width: float) -> None:
    """Make a title as small as a figure of this width [inches] needs."""
    figure = title.get_figure(root=True)
    assert figure is not None, "a title that is drawn"
    title.set_parse_math(False)  # drawn as it is, as `literal` does
    room = 0.98 * width * figure.dpi
    title.set_fontsize(float(title.get_fontsize()) * min(1.0, room / title.get_window_extent().width))


def row_heights(shapes: Sequence[float], width: float, columns: int) -> list[float]:
    """Heights [inches] of rows of panels of these shapes, height over width, with titles; the last has labels below."""
    heights = [(width - 0.75) / columns * shape + 0.5 for shape in shapes]
    return [*heights[:-1], heights[-1] + 0.2]


def draw_scene(
    axes: Any, data: EpisodeData, instant: int, box: np.ndarray, first: bool = True, last: bool = True, **style: Any
) -> PlanarScene | SpatialScene:
    """Draw an instant of an episode in axes, `first` and `last` of those that share their labels."""
    kind = scene_class(data)
    options: dict[str, Any] = {"scale": kind.panel_scale} | style
    scene = kind(axes, data, box, **options)
    scene.show(SUBSTEPS * instant)
    scene.label(kind.panel_text, x=last, y=first)
    axes.set_title(f"t = {data.times_s[instant]:g} s", fontsize=8.5, pad=3)
    return scene


def learning_curve(
    runs: Path | str | Sequence[Path | str],
    path: Path | str | None = None,
    *,
    ax: Axes | None = None,
    width: float = WIDTH,
    dpi: int = DPI,
) -> Figure:
    """Draw objectives of training batches (thin) and the held-out score (bold) over iterations, for one or more runs.

    A star marks the best validation, a dotted vertical line a collapse or a value that was not finite; the legend has
    the time of a training.

    Args:
        runs: Run folders or their `metrics.jsonl`.
        path: File to write, .png, .pdf or .svg; None: none.
        ax: Axes of your own to draw in, with a legend inside.
        width: Width of a new figure [inches].
        dpi: Dots per inch of a new figure.

    Returns:
        The figure.

    Raises:
        InputError: There is no run, or a file has no validation.
    """
    given = [Path(run) for run in ([runs] if isinstance(runs, Path | str) else runs)]
    files = [run / METRICS if run.is_dir() else run for run in given]
    if not files:
        raise InputError("no run to draw: expected at least one")
    histories = [read_validations(file) for file in files]
    axes, figure = own_axes(ax, width, 0.42 * width + 0.3 + 0.07 * len(files), dpi)
    single = len(files) == 1
    for file, validations, color in zip(files, histories, itertools.cycle(CYCLE), strict=False):
        name = "held-out score" if single else Path(os.path.realpath(file)).parent.name
        _draw_run(axes, validations, name, color, VERMILLION if single else color)
    tidy(axes, "iteration", "log det of information [nat per target]")
    axes.margins(x=0.01, y=0.1)
    collapsed = any(each.event for validations in histories for each in validations)
    handles = axes.get_legend_handles_labels()[0] + _curve_legend(single, collapsed)
    if ax is None:
        figure.legend(handles=handles, ncols=1 if width < NARROW else 4 if single else 3, fontsize=9, **LEGEND)
    else:
        axes.legend(handles=handles, fontsize=8, frameon=False)
    return figure if ax is not None and path is None else save(figure, path)  # the caller's texts stay as they are


def _draw_run(axes: Axes, validations: Sequence[Validation], name: str, color: str, event_color: str) -> None:
    epochs = [each.epoch for each in validations]
    axes.plot(epochs, [each.objective for each in validations], color=color, lw=0.9, alpha=0.6)
    # Each best so far is marked: the last of them is the best of all, whose policy training keeps.
    for best in [each for each in validations if each.best][-1:]:
        axes.plot(best.epoch, best.held_out, marker="*", ms=13, color=color, mec="white", mew=0.8, zorder=5)
        name += f": best {best.held_out:.2f} at iteration {best.epoch}"
    label = f"{name}, {validations[-1].elapsed_s:.0f} s"
    axes.plot(epochs, [each.held_out for each in validations], color=color, lw=2, label=label)
    for each in validations:
        if each.event:
            axes.axvline(each.epoch, color=event_color, ls=":", lw=1.2)


def _curve_legend(single: bool, collapsed: bool) -> list[Line2D]:
    color, event_color = (CYCLE[0], VERMILLION) if single else (GREY, GREY)
    several = [] if single else [Line2D([], [], color=color, lw=2, label="held-out score")]
    events = [Line2D([], [], color=event_color, ls=":", lw=1.2, label="collapse, rollback")] if collapsed else []
    objective = Line2D([], [], color=color, lw=0.9, alpha=0.6, label="training objective")
    best = Line2D([], [], color=color, ls="none", marker="*", ms=11, label="best checkpoint")
    return [*several, objective, best, *events]
