"""Map of the targets that were never detected, in a planar scene, and numbers of targets over time."""

from collections.abc import Callable

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D

from foveate.io.figures import BLACK, GREEN, PURPLE, over_time
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData
from foveate.plotting.track_data import TrackData

DARKEST = 0.6
"""Opacity of the cell with the most undetected targets of the episode."""


class UndetectedMap:
    """Cells of the grid, the more opaque the more targets are expected there that were never detected."""

    def __init__(self, axes: Axes, tracks: TrackData) -> None:
        assert tracks.undetected is not None, "of an episode whose map is known"
        (left, bottom), (right, top) = tracks.box
        self.cells = tracks.undetected / max(float(tracks.undetected.max()), 1e-12)
        blank = np.zeros((1, 1, 4))
        self.image = axes.imshow(blank, extent=(left, right, bottom, top), origin="lower", zorder=0.5)

    def show(self, step: int) -> None:
        """Move to a step."""
        picture = np.empty((*self.cells.shape[:0:-1], 4))
        picture[:] = to_rgba(PURPLE)
        picture[..., 3] = DARKEST * self.cells[step].T
        self.image.set_data(picture)


def draw_counts(axes: Axes, data: EpisodeData) -> tuple[list[Artist], Callable[[int], None]]:
    """Draw the numbers of targets up to a moment: true, confirmed and expected; return lines, and what moves them."""
    tracks = data.tracks
    assert tracks is not None, "of detections without ids"
    numbers = {
        "targets": (data.present.sum(axis=1), BLACK, 2.0),
        "confirmed tracks": (tracks.confirmed.sum(axis=1), GREEN, 1.4),
        "expected": (tracks.expected, PURPLE, 1.4),
    }
    axes.set_ylim(0, 1.08 * max(float(values.max(initial=1.0)) for values, _, _ in numbers.values()))
    over_time(axes, data.times_s[-1], "number of targets")
    lines = [axes.add_line(Line2D([], [], color=tint, lw=width, label=name, drawstyle="steps-post"))
             for name, (_, tint, width) in numbers.items()]  # fmt: skip
    style = {"fontsize": 9, "frameon": False, "handlelength": 1.4, "borderpad": 0, "columnspacing": 1.2}
    handles = [Line2D([], [], color=tint, lw=width, label=name) for name, (_, tint, width) in numbers.items()]
    axes.legend(handles=handles, loc="lower right", bbox_to_anchor=(1.0, 1.01), ncols=3, **style)

    def show(moment: int) -> None:
        until = moment // SUBSTEPS + 1
        for line, (values, _, _) in zip(lines, numbers.values(), strict=True):
            line.set_data(data.times_s[:until], values[:until])

    return list(lines), show
