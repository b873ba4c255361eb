"""Figure of a recording: what several methods saw, where and when."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from foveate.errors import InputError
from foveate.geometry.numpy_poses import arc, positions, rotation
from foveate.io.figures import BLACK, DPI, GREY, LEGEND, PALE, TITLE, WIDTH, clean, drawable, new_figure, save
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData
from foveate.plotting.mates import draw_radio
from foveate.plotting.scene import AGENT, SEEN, broken
from foveate.plotting.scene_spatial import scene_class
from foveate.plotting.walls import WALL, draw, loops


def replay_figure(
    episodes: Mapping[str, EpisodeData], path: Path | str | None = None, *, width: float = WIDTH, dpi: int = DPI
) -> Figure:
    """Draw a recording as several methods saw it; map and timeline are those of the first.

    Left, the map (in space: from above and from the side): every target's track in grey, in colour while it was seen,
    and the agent's path, which begins at the triangle. Right, the timeline: a row for each slot, which holds one target
    after another, light while one is present, dark while it is seen; below it the share of target time that each method
    has seen, or its mean GOSPA of detections without ids. Of a team there are the paths of all robots, and above the
    shares how much each robot hears of the others, with the first method.

    Args:
        episodes: Episode data of each method, by its name.
        path: File to write, .png, .pdf or .svg; None: none.
        width: Width [inches].
        dpi: Dots per inch of a .png.

    Returns:
        The figure.

    Raises:
        InputError: There is no episode.
    """
    if not episodes:
        raise InputError("no episode to draw: expected at least one")
    name, data = next(iter(episodes.items()))
    bars, radio = 0.26 * len(episodes) + 0.25, 0.0 if data.heard is None else 0.9
    height = max(3.4 + 1.0 * len(scene_class(data).planes), 2.9 + bars) + radio
    figure = new_figure(width, height, dpi)
    left, right = figure.subfigures(1, 2, squeeze=False)[0]
    _maps(left, data, name)
    heights = [height - 0.9 - bars - radio, *[radio] * (data.heard is not None), bars]
    panels = right.subplots(len(heights), 1, height_ratios=heights)
    _timeline(panels[0], data, name)
    if data.heard is not None:
        draw_radio(panels[1], data)
    _shares(panels[-1], episodes)
    handles = [
        Line2D([], [], color=AGENT, lw=1.3, marker=">", ms=5, label=f"agent ({name})"),
        Line2D([], [], color=GREY, lw=0.8, label="target"),
        Line2D([], [], color=SEEN, lw=2.2, label="target in view"),
        Patch(facecolor=PALE, label="present"),
        Patch(facecolor=SEEN, label="in view"),
    ]
    figure.legend(handles=handles, ncols=5 if width >= WIDTH else 2, fontsize=8.5, **LEGEND)
    return save(figure, path)


def _maps(part: SubFigure, data: EpisodeData, name: str) -> None:
    """Draw a map for each pair of axes of the space, one above the other, on one scale."""
    planes = scene_class(data).planes
    points = np.concatenate([data.truth[data.present], positions(data.poses).reshape(-1, data.truth.shape[-1])])
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
    sides[0].set_title(f"{name}: where targets were in view", loc="left", **TITLE)


def _map(axes: Axes, data: EpisodeData, plane: tuple[int, int]) -> None:
    """Draw tracks, their seen parts, the agents' paths and obstacles, in the plane of two axes of the world."""
    truth = data.truth[..., plane]
    if data.walls is not None and len(data.walls.low) == 2:
        draw(axes, data.walls)
    elif data.walls is not None:
        axes.add_collection(LineCollection([loop[:, plane] for loop in loops(data.walls)], colors=WALL, lw=0.5))
    axes.plot(*broken(truth, data.present).T, color=GREY, lw=0.6, alpha=0.8)
    ends = np.stack([truth[:-1], truth[1:]], axis=2)
    axes.add_collection(LineCollection(list(ends[data.visible & data.counted]), colors=SEEN, lw=2.2, zorder=3))
    for i, poses in enumerate(np.moveaxis(data.poses, 1, 0)):
        path, nose = positions(arc(poses, SUBSTEPS))[:, plane], rotation(poses[0])[plane, 0]
        axes.plot(*path.T, color=AGENT, lw=0.6 if i else 1.1, alpha=0.85, zorder=4)
        heading = (3, 0, np.degrees(np.arctan2(nose[1], nose[0])) - 90)
        axes.plot(*path[0], color=AGENT, marker=heading, ms=7 if i else 9, mec="white", mew=0.8, zorder=5)
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
    slots = "slot (targets in turn)" if not data.present.all() else "target"
    axes.set_ylabel(slots, fontsize=8.5, labelpad=4)
    axes.set_xlabel("time [s]", fontsize=8.5, labelpad=3)
    axes.set_title(f"{name}: when targets were in view", loc="left", **TITLE)


def _shares(axes: Axes, episodes: Mapping[str, EpisodeData]) -> None:
    """Draw each method's share of target time seen; of detections without ids its mean GOSPA."""
    tracks = [data.tracks for data in episodes.values() if data.tracks is not None]
    title, form = (
        ("mean GOSPA [m], less is better", "{:.2f}") if tracks else ("share of target time in view", "{:.1f} %")
    )
    values = [each.gospa_m for each in tracks] or [100 * data.seen_share for data in episodes.values()]
    bars = axes.barh(
        [drawable(name) for name in episodes], values, color=[SEEN, *[GREY] * (len(episodes) - 1)], height=0.65
    )
    axes.bar_label(bars, [form.format(value) for value in values], fontsize=8.5, padding=3)
    axes.set_xlim(0, max(1.0, 1.18 * max(values)))
    axes.invert_yaxis()
    clean(axes, 8.5)
    axes.set_xticks([])
    axes.tick_params(labelcolor=BLACK, length=0)
    for side in ("top", "right", "bottom"):
        axes.spines[side].set_visible(False)
    axes.set_title(title, loc="left", **TITLE)
