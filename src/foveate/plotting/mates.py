"""The other robots of a team in a planar scene, and who has heard whom, there and over time."""

from itertools import chain
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator

from foveate.geometry.numpy_poses import arc, placed, positions
from foveate.io.figures import BLUE, GREY, SKY, TITLE, clean
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData
from foveate.plotting.walls import lit


class Mates:
    """Robots beside the first: their paths, views and bodies, and a line between two of which one has heard the other.

    A line is whole where both have heard each other in the last step, and dotted where one has.
    """

    def __init__(
        self, axes: Axes, data: EpisodeData, trail: int | None, size: float, kite: np.ndarray, scale: float
    ) -> None:
        assert data.mates is not None, "of a team's episodes"
        self.data, self.trail, self.kite, self.size = data, trail, kite, size
        self.arcs = [arc(poses, SUBSTEPS) for poses in np.moveaxis(data.mates, 1, 0)]
        blank = np.zeros((3, 2))
        style: dict[str, Any] = {"facecolor": SKY + "33", "edgecolor": BLUE, "lw": 0.5 * scale, "zorder": 1}
        self.outlines = data.outlines[1:]
        self.views = [[Polygon(blank, **style) for _ in outline] for outline in self.outlines]
        body: dict[str, Any] = {"facecolor": BLUE, "edgecolor": "white", "lw": 0.4 * scale, "zorder": 8}
        self.bodies = [Polygon(blank, **body) for _ in self.arcs]
        self.paths = [axes.add_line(Line2D([], [], color=BLUE, lw=0.8 * scale, zorder=2)) for _ in self.arcs]
        self.both = axes.add_line(Line2D([], [], color=GREY, lw=0.9 * scale, zorder=1.5))
        self.one = axes.add_line(Line2D([], [], color=GREY, lw=0.9 * scale, ls=(0, (1, 2)), zorder=1.5))
        for patch in (*chain.from_iterable(self.views), *self.bodies):
            axes.add_patch(patch)

    @property
    def artists(self) -> list[Artist]:
        """Moving artists, in drawing order."""
        return [*chain.from_iterable(self.views), self.both, self.one, *self.paths, *self.bodies]

    def show(self, first: Float[np.ndarray, "..."], moment: int) -> None:
        """Move to a moment, at which the first robot has a pose."""
        step = moment // SUBSTEPS
        begin = 0 if self.trail is None else max(0, step - self.trail) * SUBSTEPS
        poses = [first, *(course[moment] for course in self.arcs)]
        for pose, course, views, outline, body, path in zip(
            poses[1:], self.arcs, self.views, self.outlines, self.bodies, self.paths, strict=True
        ):
            path.set_data(*positions(course[begin : moment + 1]).T)
            body.set_xy(placed(pose, self.size * self.kite))
            for view, border in zip(views, outline, strict=True):
                walls = self.data.walls
                view.set_xy(placed(pose, border) if walls is None else lit(walls, pose, border))
        both, one = links(self.data, np.stack(poses), moment)
        self.both.set_data(*both.T)
        self.one.set_data(*one.T)


def links(
    data: EpisodeData, poses: Float[np.ndarray, "M ..."], moment: int
) -> tuple[Float[np.ndarray, "_ d"], Float[np.ndarray, "_ d"]]:
    """Lines between robots at these poses of which both have heard each other in the last step, and of which one has.

    They have gaps of NaN; there are none before the first step.
    """
    places, step = positions(poses), moment // SUBSTEPS
    heard = np.zeros((len(poses), len(poses)), bool) if step == 0 or data.heard is None else data.heard[step - 1]
    return lines(places, heard & heard.T), lines(places, heard ^ heard.T)


def lines(places: Float[np.ndarray, "M d"], pairs: Bool[np.ndarray, "M M"]) -> Float[np.ndarray, "_ d"]:
    """Segments between the pairs of places, joined to one line with gaps."""
    first, second = np.nonzero(np.triu(pairs, 1))
    gaps = np.full((len(first), places.shape[1]), np.nan)
    return np.stack([places[first], places[second], gaps], axis=1).reshape(-1, places.shape[1])


def draw_radio(axes: Axes, data: EpisodeData) -> None:
    """Draw a row for each robot over time: the darker, the more of the others it hears."""
    assert data.heard is not None, "of a team's episodes"
    robots = data.heard.shape[1]
    share = data.heard.sum(axis=2) / (robots - 1)
    rows = np.arange(robots + 1) + 0.5
    axes.pcolormesh(data.times_s, rows, share.T, cmap="Blues", vmin=0.0, vmax=1.0, rasterized=True)
    axes.set_ylim(robots + 0.5, 0.5)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    clean(axes)
    axes.set_ylabel("robot", fontsize=8.5, labelpad=4)
    axes.set_xlabel("time [s]", fontsize=8.5, labelpad=3)
    axes.set_title("others heard: none (white) to all (dark)", loc="left", **TITLE)
