"""Planar scene of an episode in its axes, with the colours and the legend of scenes."""

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon

from foveate.geometry.numpy_poses import placed
from foveate.io.figures import BLACK, BLUE, GREEN, GREY, PURPLE, SKY, VERMILLION, clean
from foveate.plotting.ellipsoids import box_lines, ellipses, half_widths
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData
from foveate.plotting.mates import Mates
from foveate.plotting.snapshot import snapshot
from foveate.plotting.undetected import DARKEST, UndetectedMap
from foveate.plotting.walls import draw, lit

SEEN, UNSEEN, AGENT, BORDER = GREEN, VERMILLION, BLUE, BLACK
BELIEFS = "belief (95 %), detected", "belief (95 %), not detected"
"""Names of the two kinds of beliefs in legends."""
DASHED = (0, (3, 2))
"""Style of lines around unseen targets."""
KITE = np.array([[1.0, 0.0], [-0.8, 0.65], [-0.4, 0.0], [-0.8, -0.65]])
"""Agent, its nose along +x."""


def limits(episodes: Sequence[EpisodeData], margin: float = 0.04) -> Float[np.ndarray, "2 2"]:
    """Lower and upper corner [m] of the square that shows targets, agent and view of these episodes at every instant.

    The first beliefs add at most 40 %, later ones 15 %: one that is never corrected grows without bound. A region is
    shown whole unless it is more than twice as wide as all that.
    """
    core, first, later = [], [], []
    for data in episodes:
        core.append(data.truth[data.present])
        for course, outline in zip(np.moveaxis(data.poses, 1, 0), data.outlines, strict=True):
            core += [placed(pose, line) for pose in course for line in outline]
        for part, beliefs in ((slice(1), first), (slice(1, None), later)):
            shown = data.believed[part]
            beliefs.append(ellipses(data.estimate[part][shown], data.covariance[part][shown]).reshape(-1, 2))
    points = np.concatenate(core)
    low, high = points.min(axis=0), points.max(axis=0)
    extent, core_low, core_high = (high - low).max(), low, high
    for beliefs, share in ((first, 0.4), (later, 0.15)):
        if len(borders := np.concatenate(beliefs)):
            low = np.minimum(low, np.maximum(borders.min(axis=0), core_low - share * extent))
            high = np.maximum(high, np.minimum(borders.max(axis=0), core_high + share * extent))
    low, high = with_regions(low, high, episodes)
    half = (0.5 + margin) * (high - low).max()
    return np.stack([(low + high) / 2 - half, (low + high) / 2 + half])


def with_regions(low: np.ndarray, high: np.ndarray, episodes: Sequence[EpisodeData]) -> tuple[np.ndarray, np.ndarray]:
    """Corners [m] extended to the regions of these episodes, except for those more than twice as wide."""
    widest = 2.0 * (high - low).max()
    near = [data.region for data in episodes if data.region is not None and np.ptp(data.region, axis=0).max() <= widest]
    return np.min([low, *(region[0] for region in near)], axis=0), np.max([high, *(r[1] for r in near)], axis=0)


def broken(tracks: Float[np.ndarray, "instants n d"], shown: Bool[np.ndarray, "instants n"]) -> np.ndarray:
    """Join tracks to one line, with NaN between them and where they are not shown."""
    line = np.pad(np.where(shown[..., None], tracks, np.nan), ((0, 1), (0, 0), (0, 0)), constant_values=np.nan)
    return line.swapaxes(0, 1).reshape(-1, tracks.shape[-1])


class PlanarScene:
    """A planar scene in its axes, drawn once and moved: agent, path, view, targets with trails, beliefs.

    Trails and path reach `trail` steps back, None for all. `scale` multiplies symbol sizes. A `tint` is the single
    colour of agent and beliefs, for several agents in the same axes.
    """

    axes_class: ClassVar[Any] = Axes
    limits = staticmethod(limits)
    max_frames = 150
    """Most frames of one animation."""
    planes: ClassVar[tuple[tuple[int, int], ...]] = ((0, 1),)
    """Pairs of world axes that maps show."""
    panel_shape, panel_scale, panel_text = 1.0, 1.0, 8.0
    """Height over width of a small panel, its symbol scale, and its text size [pt]."""

    @staticmethod
    def place(width: int, height: int, bottom: float, top: float) -> tuple[float, float, float, float]:
        """Left, bottom, width and height of the axes in a picture [pixels]: the largest square."""
        side = min(height - bottom - top, 0.54 * width)
        return 56.0, bottom, side, side

    def __init__(
        self,
        axes: Axes,
        data: EpisodeData,
        box: np.ndarray,
        trail: int | None = None,
        scale: float = 1.0,
        tint: str | None = None,
    ) -> None:
        own, seen, unseen, view = (tint,) * 4 if tint else (AGENT, SEEN, UNSEEN, SKY)
        self.colors = seen + "40", unseen + ("00" if tint else "22")
        self.axes, self.data, self.arc, self.trail, self.side = axes, data, data.arc(), trail, float(np.ptp(box[:, 0]))
        self.size = 0.035 * scale * float(box[1, 0] - box[0, 0])
        axes.set(aspect="equal", xlim=box[:, 0], ylim=box[:, 1])

        def line(color: str, **style: Any) -> Line2D:
            return axes.add_line(Line2D([], [], color=color, **style))

        if data.region is not None:
            axes.plot(
                *box_lines(data.region)[0].T, color=BORDER, lw=1.2 * scale, zorder=0.9, scalex=False, scaley=False
            )
        blank = np.zeros((3, 2))
        # Tints over each other would mix to a third colour.
        border = {"facecolor": view + ("1A" if tint else "55"), "edgecolor": own, "lw": 0.7 * scale}
        self.views = [Polygon(blank, zorder=1, **border) for _ in data.outline]
        self.whole = []
        if data.walls is not None:
            draw(axes, data.walls)
            # What obstacles hide of the view is its dotted rest.
            dotted: dict[str, Any] = {"facecolor": "none", "edgecolor": own, "lw": 0.6 * scale, "ls": (0, (1, 2))}
            self.whole = [Polygon(blank, zorder=1, **dotted) for _ in data.outline]
        has_map = data.tracks is not None and data.tracks.undetected is not None
        self.map = UndetectedMap(axes, data.tracks) if has_map and data.tracks is not None else None
        self.path = line(own, lw=1.4 * scale, zorder=2)
        self.trails = line(GREY, lw=0.9 * scale, zorder=2)
        dashed: dict[str, Any] = {"linewidth": 1.0 * scale, "linestyle": DASHED}
        self.unseen = PolyCollection([], facecolors=self.colors[1], edgecolors=unseen, zorder=3, **dashed)
        self.seen = PolyCollection([], facecolors=self.colors[0], edgecolors=seen, linewidth=1.3 * scale, zorder=5)
        axes.add_collection(self.unseen, autolim=False)
        axes.add_collection(self.seen, autolim=False)
        # A detected target is told from others at any size of its ellipse.
        cross = {"marker": "x", "ms": 3.6 * scale, "mew": 1.0 * scale}
        self.unseen_means = line(unseen, zorder=4, ls="none", **cross)
        self.seen_means = line(seen, zorder=6, ls="none", marker="o", ms=6.0 * scale, mec="white", mew=0.5 * scale)
        self.targets = line(BLACK, ls="none", marker="s", ms=2.8 * scale, zorder=7)
        self.agent = Polygon(blank, facecolor=own, edgecolor="white", lw=0.4 * scale, zorder=8)
        for patch in (*self.whole, *self.views, self.agent):
            axes.add_patch(patch)
        self.mates = None if data.mates is None else Mates(axes, data, trail, self.size, KITE, scale)

    @property
    def artists(self) -> list[Artist]:
        """Moving artists, in drawing order."""
        beliefs = (self.unseen, self.unseen_means, self.seen, self.seen_means)
        mates = [] if self.mates is None else self.mates.artists
        below = [] if self.map is None else [self.map.image]
        return [*below, *mates, *self.whole, *self.views, self.path, self.trails, *beliefs, self.targets, self.agent]

    def show(self, moment: int) -> None:
        """Move to a moment of the episode."""
        state = snapshot(self.data, self.arc, moment, self.trail)
        self.trails.set_data(*broken(state.tracks, state.tracked).T)
        self.path.set_data(*state.path.T)
        for view, border in zip(self.views, self.data.outline, strict=True):
            walls = self.data.walls
            view.set_xy(placed(state.pose, border) if walls is None else lit(walls, state.pose, border))
        for view, border in zip(self.whole, self.data.outline, strict=False):
            view.set_xy(placed(state.pose, border))
        self.agent.set_xy(placed(state.pose, self.size * KITE))
        if self.mates is not None:
            self.mates.show(state.pose, moment)
        self.targets.set_data(*state.truth.T)
        if self.map is not None:
            self.map.show(moment // SUBSTEPS)
        groups = (self.seen, self.seen_means, state.seen), (self.unseen, self.unseen_means, ~state.seen)
        for (areas, means, which), fill, edge in zip(groups, self.colors, (SEEN, UNSEEN), strict=True):
            areas.set_verts(list(ellipses(state.estimate[which], state.covariance[which])))
            areas.set_facecolor(fills(fill, state.covariance[which], self.side))
            if self.data.tracks is not None:  # the likelier, the darker its border
                areas.set_edgecolor([to_rgba(edge, each) for each in state.existence[which]] or [edge])
            means.set_data(*state.estimate[which].T)

    def label(self, size: float, x: bool = True, y: bool = True) -> None:
        """Set tick labels and the names of the axes where `x` and `y`; without `y`, no tick labels on that axis."""
        clean(self.axes, size)
        self.axes.tick_params(labelleft=y)
        self.axes.locator_params(nbins=7, steps=[1, 2, 5, 10])
        if x:
            self.axes.set_xlabel("x [m]", fontsize=size, labelpad=2.5)
        if y:
            self.axes.set_ylabel("y [m]", fontsize=size, labelpad=2.5)


def fills(color: str, covariance: Float[np.ndarray, "n d d"], side: float) -> Any:
    """Fill of each 95 % region, none for one as wide as a scene of this side [m]: it would cover everything."""
    return [to_rgba(color, 0.0 if each else None) for each in is_wide(covariance, side)] or [to_rgba(color)]


def is_wide(covariance: Float[np.ndarray, "n d d"], side: float) -> Bool[np.ndarray, " n"]:
    """95 % regions that would cover a scene of this side [m]."""
    return 2.0 * half_widths(covariance).max(axis=-1, initial=0.0) > 0.6 * side


def legend_entries(episodes: Sequence[EpisodeData] = ()) -> list[Artist]:
    """Legend of the colours and symbols of scenes, with the border of their region if any has one."""
    bordered = any(data.region is not None for data in episodes)
    tracks = [data.tracks for data in episodes if data.tracks is not None]
    mapped = any(each.undetected is not None for each in tracks) and episodes[0].space.dimension == 2
    seen, unseen = ("track (95 %), confirmed", "not confirmed") if tracks else BELIEFS
    return [
        Line2D([], [], color=AGENT, lw=1.5, label="agent path"),
        Patch(facecolor=SKY + "55", edgecolor=AGENT, lw=0.7, label="field of view"),
        Line2D(
            [],
            [],
            color=GREY,
            marker="s",
            ms=4,
            mfc=BLACK,
            mec=BLACK,
            lw=0.9,
            label="target" if tracks else "target track",
        ),
        Patch(facecolor=SEEN + "40", edgecolor=SEEN, lw=1.3, label=seen),
        Patch(facecolor=UNSEEN + "22", edgecolor=UNSEEN, ls=DASHED, label=unseen),
        *[Patch(facecolor=to_rgba(PURPLE, DARKEST), label="undetected")] * mapped,
        *[Line2D([], [], color=BORDER, lw=1.2, label="region")] * bordered,
        *[Line2D([], [], color=GREY, lw=0.9, label="heard")] * any(data.mates is not None for data in episodes),
    ]


def describe(data: EpisodeData) -> str:
    """Title, number of targets, and score; where targets come and go, the share of time seen instead."""
    most = int(data.present.sum(axis=1).max())
    count = f"{most or 'no'} target{'s' * (most != 1)}"
    if data.tracks is not None:
        facts = [f"up to {count} at once", f"GOSPA {data.tracks.gospa_m:.2f} m"]
    elif not data.present.all():
        facts = [f"up to {count} at once", f"in view {data.seen_share:.1%} of their time"]
    else:
        facts = [count] if data.score is None else [count, f"score {data.score:.2f}"]
    return " · ".join([data.title, *facts] if data.title else facts)
