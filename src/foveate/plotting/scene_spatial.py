"""Spatial scene of an episode in its axes, over a floor whose shadows show depth."""

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.ticker import MaxNLocator, MultipleLocator, NullFormatter
from matplotlib.transforms import Bbox
from mpl_toolkits.mplot3d.art3d import Line3D, Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from foveate.geometry.numpy_poses import placed, positions
from foveate.io.figures import BLACK, GREY, SKY
from foveate.plotting.ellipsoids import box_lines, contours, faces, half_widths, lifted, meridians
from foveate.plotting.episode_data import EpisodeData
from foveate.plotting.mates_spatial import DART, DART_COLORS, DART_FACES, SpatialMates
from foveate.plotting.scene import (
    AGENT,
    BORDER,
    DASHED,
    SEEN,
    UNSEEN,
    PlanarScene,
    broken,
    fills,
    is_wide,
    with_regions,
)
from foveate.plotting.snapshot import snapshot
from foveate.plotting.walls import WALL, loops

ELEVATION, AZIMUTH, SWING = 27.0, -62.0, 36.0
"""Direction of the camera, and its turn about the scene during an animation [degrees]."""

FLOOR, GRID, SHADE = "#F7F7F7", "#D8D8D8", "#9A9A9A"
VIEW_SHADE, PATH_SHADE = "#E4EEF5", "#B8C4CE"
"""Colours of the floor, its lines, and the shadows on it."""


def limits(episodes: Sequence[EpisodeData], margin: float = 0.04) -> Float[np.ndarray, "2 3"]:
    """Lower and upper corner [m] of the box that shows targets and agent of these episodes at every instant.

    View and beliefs add at most 15 %, as beliefs may grow without bound, or more where the box is small beside the
    view. No belief lowers the floor, or shadows would lie far below.
    """
    core, soft = [], []
    for data in episodes:
        poses = data.poses.reshape(-1, *data.pose.shape[1:])
        core += [data.truth[data.present], positions(poses)]
        for course, outline in zip(np.moveaxis(data.poses, 1, 0), data.outlines, strict=True):
            soft += [placed(pose, line) for pose in course for line in outline]
        mean, covariance = data.estimate[data.believed], data.covariance[data.believed]
        width = half_widths(covariance)
        soft += [mean - width * [1, 1, 0], mean + width]
    points, more = np.concatenate(core), np.concatenate([*core, *soft])
    low, high = points.min(axis=0), points.max(axis=0)
    extent = (high - low).max()
    borders = [line for data in episodes for outline in data.outlines for line in outline]
    depth = max((np.linalg.norm(line, axis=1).max() for line in borders), default=0.0)
    reach = max(0.15 * extent, depth - extent / 2)
    low = np.minimum(low, np.maximum(more.min(axis=0), low - reach))
    high = np.maximum(high, np.minimum(more.max(axis=0), high + reach))
    low, high = with_regions(low, high, episodes)
    pad = margin * (high - low).max() or 0.5
    return np.stack([low - pad, high + pad])


class SpaceAxes(Axes3D):
    """3-D axes that fill a rectangle; matplotlib's own fill a square in it."""

    shown: np.ndarray = np.array([[-0.1, -0.1], [0.1, 0.1]])
    """Corners of the part of the camera's plane to show."""
    margin_pt: float = 22.0
    """Margin for tick labels around it."""

    @property
    def eye(self) -> Float[np.ndarray, "3"]:
        """Position of the camera [m]."""
        # The point without a projection: the null vector of the projection's rows of x, y and depth.
        point = np.linalg.svd(self.get_proj()[[0, 1, 3]])[2][-1]
        return point[:3] / point[3]

    def apply_aspect(self, position: Bbox | None = None) -> None:
        """Fill the rectangle, and show as much of the camera's plane in it as fits at equal scales."""
        del position  # of a locator, which these axes never have
        self.reset_position()
        self.set_in_layout(True)  # setting a position has taken the axes out of the layout
        figure = self.get_figure(root=True)
        assert figure is not None, "drawn in a figure only"
        pixels, room = self.bbox.size, figure.dpi / 72 * self.margin_pt * np.array([2.0, 1.1])
        middle, extent = self.shown.mean(axis=0), np.ptp(self.shown, axis=0)
        scale = np.max(extent / np.maximum(pixels - room, 1.0))
        # Most of the margin is needed below and on the right, for the tick labels of z; none above.
        middle = middle + scale * room * [0.3, -0.45]
        low, high = middle - scale * pixels / 2, middle + scale * pixels / 2
        self.viewLim.intervalx, self.viewLim.intervaly = np.stack([low, high], axis=1)


class SpatialScene:
    """A spatial scene in its axes, drawn once and moved: agent, path, view, targets with trails, beliefs.

    Everything has a shadow or a drop line on the floor. Trails and path reach `trail` steps back, None for all; with a
    number, the scene is an animation, and the camera moves. `scale` multiplies symbol sizes.
    """

    axes_class: ClassVar[Any] = SpaceAxes
    limits = staticmethod(limits)
    max_frames = 100
    """Most frames of one animation: the moving camera changes every pixel, and a GIF soon is too large for a page."""
    planes: ClassVar[tuple[tuple[int, int], ...]] = ((0, 1), (0, 2))
    panel_shape, panel_scale, panel_text = 0.72, 0.7, 6.5

    @staticmethod
    def place(width: int, height: int, bottom: float, top: float) -> tuple[float, float, float, float]:
        """Left, bottom, width and height of the axes, their tick labels included, in a picture [pixels]."""
        return 0.0, 0.4 * bottom, 0.575 * width, height - 0.4 * bottom - 0.5 * top

    def __init__(
        self, axes: SpaceAxes, data: EpisodeData, box: np.ndarray, trail: int | None = None, scale: float = 1.0
    ) -> None:
        self.axes, self.data, self.arc, self.trail, self.faces = axes, data, data.arc(), trail, faces(data.outline)
        self.side = float((box[1] - box[0]).max())
        self.size, self.floor = 0.045 * float((box[1] - box[0]).max()), float(box[0, 2])
        self.swing = 0.0 if trail is None else SWING
        _furnish(axes, box)
        _aim(axes, box, self.swing)
        if data.walls is not None:
            style = {"colors": WALL, "linewidths": 0.9 * scale, "zorder": 1.6}
            axes.add_collection3d(Line3DCollection(loops(data.walls), **style), autolim=False)

        def line(color: str, **style: Any) -> Any:
            return axes.add_line(Line3D([], [], [], color=color, **style))

        def area(face: Any, zorder: float, **style: Any) -> Any:
            return axes.add_collection3d(Poly3DCollection([], facecolors=face, zorder=zorder, **style), autolim=False)

        def net(color: str, zorder: float, **style: Any) -> Any:
            return axes.add_collection3d(Line3DCollection([], colors=color, zorder=zorder, **style), autolim=False)

        if data.region is not None:
            net(BORDER, 1.1, linewidths=0.9 * scale).set_segments(box_lines(data.region))
        self.view_shadow = area(VIEW_SHADE, 1.0, edgecolors=VIEW_SHADE, linewidths=0.6)
        self.path_shadow = line(PATH_SHADE, lw=1.1 * scale, zorder=1.3)
        self.drops = line(GREY, lw=0.7 * scale, ls=(0, (1, 2)), zorder=1.4)
        self.shadows = line(SHADE, ls="none", marker="o", ms=2.6 * scale, zorder=1.5)
        self.trails = line(GREY, lw=0.9 * scale, zorder=2)
        self.unseen = area(UNSEEN + "1A", 3.0, edgecolors=UNSEEN, linewidths=1.0 * scale, linestyles=[DASHED])
        self.unseen_net = net(UNSEEN + "66", 3.1, linewidths=0.6 * scale, linestyles=[DASHED])
        self.path = line(AGENT, lw=1.5 * scale, zorder=4)
        self.view = area(SKY + "2E", 5.0, edgecolors="none")
        self.edges = net(AGENT, 5.1, linewidths=0.9 * scale)
        self.seen = area(SEEN + "48", 6.0, edgecolors=SEEN, linewidths=1.3 * scale)
        self.seen_net = net(SEEN + "AA", 6.1, linewidths=0.7 * scale)
        self.unseen_means = line(UNSEEN, zorder=3.2, ls="none", marker="x", ms=4.5 * scale, mew=1.0 * scale)
        self.seen_means = line(SEEN, zorder=6.2, ls="none", marker="o", ms=6.5 * scale, mec="white", mew=0.5 * scale)
        self.targets = line(BLACK, ls="none", marker="s", ms=3.0 * scale, zorder=7)
        self.agent = area(DART_COLORS, 8.0, edgecolors="white", linewidths=0.4 * scale)
        self.mates = None if data.mates is None else SpatialMates(axes, data, trail, self.size, scale)

    @property
    def artists(self) -> list[Artist]:
        """Moving artists: the axes themselves, as the camera moves."""
        return [self.axes]

    def show(self, moment: int) -> None:
        """Move to a moment of the episode."""
        state = snapshot(self.data, self.arc, moment, self.trail)
        self.axes.view_init(ELEVATION, AZIMUTH + self.swing * (moment / max(1, len(self.arc) - 1) - 0.5))
        eye = self.axes.eye
        self.trails.set_data_3d(*broken(state.tracks, state.tracked).T)
        self.path.set_data_3d(*state.path.T)
        self.path_shadow.set_data_3d(*self._on_floor(state.path).T)
        posts = np.concatenate([state.truth, positions(state.pose)[None]])
        self.drops.set_data_3d(*broken(np.stack([posts, self._on_floor(posts)]), np.ones((2, len(posts)), bool)).T)
        self.shadows.set_data_3d(*self._on_floor(posts).T)
        walls = [placed(state.pose, face) for face in self.faces]
        self.view.set_verts(walls)
        self.view_shadow.set_verts([self._on_floor(wall) for wall in walls])
        self.edges.set_segments([placed(state.pose, line) for line in self.data.outline])
        self.agent.set_verts([placed(state.pose, self.size * DART[list(face)]) for face in DART_FACES])
        if self.mates is not None:
            self.mates.show(state.pose, moment)
        self.targets.set_data_3d(*state.truth.T)
        seen = self.seen, self.seen_net, self.seen_means, state.seen
        unseen = self.unseen, self.unseen_net, self.unseen_means, ~state.seen
        for areas, net, means, which in (seen, unseen):
            belief = state.estimate[which], state.covariance[which]
            areas.set_verts(list(contours(*belief, eye)))
            filled = fills(SEEN + "48" if areas is self.seen else UNSEEN + "1A", belief[1], self.side)
            areas.set_facecolor(filled)
            near = ~is_wide(belief[1], self.side)
            net.set_segments(list(meridians(belief[0][near], belief[1][near], eye)))
            means.set_data_3d(*belief[0].T)

    def label(self, size: float, x: bool = True, y: bool = True) -> None:
        """Set tick labels where `y`, and the names of the axes where `x` and `y`: all panels show the same box."""
        self.axes.margin_pt = 2.3 * size
        for name, axis in (("x", self.axes.xaxis), ("y", self.axes.yaxis), ("z", self.axes.zaxis)):
            axis.set_tick_params(labelsize=size, pad=0.3 * size - 5.7, color=GREY, width=0.6)
            if not y:
                axis.set_major_formatter(NullFormatter())
            axis.set_label_text(f"{name} [m]" if x and y else "", fontsize=size)
            axis.labelpad = 1.2 * size - 15.8

    def _on_floor(self, points: np.ndarray) -> np.ndarray:
        return lifted(points[..., :2], self.floor)


def _furnish(axes: SpaceAxes, box: np.ndarray) -> None:
    """Set equal scales, and draw a floor with a light grid, no walls."""
    low, high = box
    axes.set(xlim=box[:, 0], ylim=box[:, 1], zlim=box[:, 2])
    axes.set_box_aspect(high - low)
    axes.set_proj_type("persp", focal_length=1.4)
    axes.computed_zorder = False
    axes.grid(False)
    ticks = MaxNLocator(5, steps=[1, 2, 5, 10]).tick_values(0, (high - low).max())
    walls: list[Any] = [axes.xaxis, axes.yaxis, axes.zaxis]
    for axis in walls:
        axis.set_pane_color((1, 1, 1, 0))
        axis.pane.set_edgecolor((1, 1, 1, 0))
        axis.line.set(color=GREY, linewidth=0.6)
        axis.set_major_locator(MultipleLocator(ticks[1] - ticks[0]))
    x, y = (np.array(axis.get_majorticklocs()) for axis in (axes.xaxis, axes.yaxis))
    x, y = x[(x > low[0]) & (x < high[0])], y[(y > low[1]) & (y < high[1])]
    lines = [[(t, low[1], low[2]), (t, high[1], low[2])] for t in (low[0], *x, high[0])]
    lines += [[(low[0], t, low[2]), (high[0], t, low[2])] for t in (low[1], *y, high[1])]
    axes.add_collection3d(Line3DCollection(lines, colors=GRID, linewidths=0.6, zorder=1.2), autolim=False)
    floor = [(box[i, 0], box[j, 1], low[2]) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    axes.add_collection3d(Poly3DCollection([floor], facecolors=FLOOR, zorder=0.9), autolim=False)


def _aim(axes: SpaceAxes, box: np.ndarray, swing: float) -> None:
    """Keep the box in sight from every position of the camera."""
    # The ends and the middle of the swing suffice: between them no corner reaches notably farther.
    corners = np.array([(x, y, z, 1.0) for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]])
    projected = []
    for turn in (-swing / 2, 0.0, swing / 2):
        axes.view_init(ELEVATION, AZIMUTH + turn)
        x, y, _, w = axes.get_proj() @ corners.T
        projected.append(np.stack([x / w, y / w], axis=1))
    axes.shown = np.stack([np.min(projected, axis=(0, 1)), np.max(projected, axis=(0, 1))])


def scene_class(data: EpisodeData) -> type[PlanarScene] | type[SpatialScene]:
    """Class of the scenes that draw an episode, by the dimension of its space."""
    return SpatialScene if data.space.dimension == 3 else PlanarScene
