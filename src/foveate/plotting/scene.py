"""Planar scene of an episode in its axes, and the colours, legend, axes and files of all pictures.

Seen and unseen differ in line style too, and the colours are Okabe and Ito's, which colour-blind readers tell apart.
"""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon

from foveate.errors import InputError
from foveate.geometry.numpy_poses import placed
from foveate.io.files import write_atomic
from foveate.plotting.ellipsoids import ellipses
from foveate.plotting.episode_data import EpisodeData, snapshot

BLUE, SKY, GREEN, VERMILLION, ORANGE = "#0072B2", "#56B4E9", "#009E73", "#D55E00", "#E69F00"
PURPLE, BLACK, GREY, PALE = "#CC79A7", "#000000", "#8C8C8C", "#E6E6E6"
CYCLE = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK)
"""Colours of runs and methods, in this order."""
SEEN, UNSEEN, AGENT = GREEN, VERMILLION, BLUE
DASHED = (0, (3, 2))
"""Style of lines around unseen targets."""
KITE = np.array([[1.0, 0.0], [-0.8, 0.65], [-0.4, 0.0], [-0.8, -0.65]])
"""Agent, its nose along +x."""


def limits(episodes: Sequence[EpisodeData], margin: float = 0.04) -> Float[np.ndarray, "2 2"]:
    """Lower and upper corner [m] of the square that shows targets, agent and view of these episodes at every instant.

    Beliefs add at most 15 %: one that is never corrected grows without bound.
    """
    core, beliefs = [], []
    for data in episodes:
        core.append(data.truth[data.present])
        core += [placed(pose, line) for pose in data.pose for line in data.outline]
        beliefs.append(ellipses(data.estimate[data.present], data.covariance[data.present]).reshape(-1, 2))
    points, borders = np.concatenate(core), np.concatenate(beliefs)
    low, high = points.min(axis=0), points.max(axis=0)
    reach = 0.15 * (high - low).max()
    if len(borders):
        low = np.minimum(low, np.maximum(borders.min(axis=0), low - reach))
        high = np.maximum(high, np.minimum(borders.max(axis=0), high + reach))
    half = (0.5 + margin) * (high - low).max()
    return np.stack([(low + high) / 2 - half, (low + high) / 2 + half])


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
        self.axes, self.data, self.arc, self.trail = axes, data, data.arc(), trail
        self.size = 0.035 * scale * float(box[1, 0] - box[0, 0])
        axes.set(aspect="equal", xlim=box[:, 0], ylim=box[:, 1])

        def line(color: str, **style: Any) -> Line2D:
            return axes.add_line(Line2D([], [], color=color, **style))

        blank = np.zeros((3, 2))
        border = {"facecolor": view + "55", "edgecolor": own, "lw": 0.7 * scale}
        self.views = [Polygon(blank, zorder=1, **border) for _ in data.outline]
        self.path = line(own, lw=1.4 * scale, zorder=2)
        self.trails = line(GREY, lw=0.9 * scale, zorder=2)
        dashed: dict[str, Any] = {"linewidth": 1.0 * scale, "linestyle": DASHED}
        self.unseen = PolyCollection([], facecolors=unseen + "22", edgecolors=unseen, zorder=3, **dashed)
        self.seen = PolyCollection([], facecolors=seen + "40", edgecolors=seen, linewidth=1.3 * scale, zorder=5)
        axes.add_collection(self.unseen, autolim=False)
        axes.add_collection(self.seen, autolim=False)
        cross = {"ls": "none", "marker": "x", "ms": 6.5 * scale, "mew": 1.3 * scale}
        self.unseen_means = line(unseen, zorder=4, **cross)
        self.seen_means = line(seen, zorder=6, **cross)
        self.targets = line(BLACK, ls="none", marker="s", ms=2.8 * scale, zorder=7)
        self.agent = Polygon(blank, facecolor=own, edgecolor="white", lw=0.4 * scale, zorder=8)
        for patch in (*self.views, self.agent):
            axes.add_patch(patch)

    @property
    def artists(self) -> list[Artist]:
        """Moving artists, in drawing order."""
        beliefs = (self.unseen, self.unseen_means, self.seen, self.seen_means)
        return [*self.views, self.path, self.trails, *beliefs, self.targets, self.agent]

    def show(self, moment: int) -> None:
        """Move to a moment of the episode."""
        state = snapshot(self.data, self.arc, moment, self.trail)
        self.trails.set_data(*broken(state.tracks, state.tracked).T)
        self.path.set_data(*state.path.T)
        for view, border in zip(self.views, self.data.outline, strict=True):
            view.set_xy(placed(state.pose, border))
        self.agent.set_xy(placed(state.pose, self.size * KITE))
        self.targets.set_data(*state.truth.T)
        beliefs = (self.seen, self.seen_means, state.seen), (self.unseen, self.unseen_means, ~state.seen)
        for areas, means, which in beliefs:
            areas.set_verts(list(ellipses(state.estimate[which], state.covariance[which])))
            means.set_data(*state.estimate[which].T)

    def label(self, size: float, x: bool = True, y: bool = True) -> None:
        """Set tick labels and the names of the axes where `x` and `y`; without `y`, no tick labels on that axis."""
        clean(self.axes, size)
        self.axes.tick_params(labelleft=y)
        if x:
            self.axes.set_xlabel("x [m]", fontsize=size, labelpad=2.5)
        if y:
            self.axes.set_ylabel("y [m]", fontsize=size, labelpad=2.5)


def legend_entries() -> list[Artist]:
    """Legend of the colours and symbols of a scene."""
    return [
        Line2D([], [], color=AGENT, lw=1.5, label="agent and its path"),
        Patch(facecolor=SKY + "55", edgecolor=AGENT, lw=0.7, label="field of view"),
        Line2D([], [], color=GREY, marker="s", ms=4, mfc=BLACK, mec=BLACK, lw=0.9, label="target, its track"),
        Patch(facecolor=SEEN + "40", edgecolor=SEEN, lw=1.3, label="estimate (95 %), just seen"),
        Patch(facecolor=UNSEEN + "22", edgecolor=UNSEEN, ls=DASHED, label="estimate (95 %), not seen"),
    ]


def describe(data: EpisodeData) -> str:
    """Title, number of targets, and score; where targets come and go, the share of time seen instead."""
    most = int(data.present.sum(axis=1).max())
    count = f"{most or 'no'} target{'s' * (most != 1)}"
    if not data.present.all():
        facts = [f"up to {count} at once", f"seen {data.seen_share:.1%} of their time"]
    else:
        facts = [count] if data.score is None else [count, f"score {data.score:.2f}"]
    return " · ".join([data.title, *facts] if data.title else facts)


def clean(axes: Axes, size: float = 8.0) -> None:
    """Give axes a thin grey frame and small tick labels."""
    axes.tick_params(labelsize=size, length=2.5, width=0.6, color=GREY, pad=2)
    for spine in axes.spines.values():
        spine.set(linewidth=0.6, color=GREY)


def new_figure(width: float, height: float, dpi: int = 150, layout: Any = "constrained") -> Figure:
    """Make a white figure [inches] on a canvas of its own, without pyplot's global state."""
    figure = Figure(figsize=(width, height), dpi=dpi, facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure whole or not at all, in the format of the ending: .png, .pdf or .svg."""
    kinds = (".png", ".pdf", ".svg")
    if path.suffix.lower() not in kinds:
        raise InputError(f"{path}: expected a name that ends in {', '.join(kinds)}")
    buffer = io.BytesIO()
    figure.savefig(buffer, format=path.suffix[1:].lower())
    write_atomic(path, buffer.getvalue())
