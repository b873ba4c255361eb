"""What every picture of an episode is made of: colours, ellipses, the view on the ground, one scene in its axes.

Seen and not seen differ in line style as well as in colour, and the colours are Okabe and Ito's, which colour-blind
readers tell apart.
"""

import io
import math
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
from foveate.plotting.episode_data import EpisodeData, snapshot

BLUE, SKY, GREEN, VERMILLION, ORANGE = "#0072B2", "#56B4E9", "#009E73", "#D55E00", "#E69F00"


PURPLE, BLACK, GREY, PALE = "#CC79A7", "#000000", "#8C8C8C", "#E6E6E6"


CYCLE = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK)
"""Colours of runs and methods, in this order."""


SEEN, UNSEEN, AGENT = GREEN, VERMILLION, BLUE


CHI_SQUARE_95 = -2.0 * math.log(0.05)
"""A planar Gaussian lies within this squared Mahalanobis distance with probability 0.95."""


CIRCLE = np.stack([np.cos(t := np.linspace(0, 2 * np.pi, 49)[:-1]), np.sin(t)], axis=-1)


KITE = np.array([[1.0, 0.0], [-0.8, 0.65], [-0.4, 0.0], [-0.8, -0.65]])
"""The agent, its nose along +x."""


def ellipses(mean: Float[np.ndarray, "n 2"], covariance: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n v 2"]:
    """The borders of the regions that hold 95 % of N(mean, covariance) [m]."""
    values, vectors = np.linalg.eigh(covariance)
    axes = vectors * np.sqrt(CHI_SQUARE_95 * np.maximum(values, 0.0))[:, None, :]
    return mean[:, None, :] + CIRCLE @ axes.swapaxes(-1, -2)


def limits(films: Sequence[EpisodeData], margin: float = 0.04) -> Float[np.ndarray, "2 2"]:
    """Lower and upper corner [m] of the square that shows targets, agent and view of these films at every instant.

    Beliefs are shown as far as they reach beyond that by 15 % at most: one that nobody corrects may grow for ever.
    """
    core, soft = [], []
    for film in films:
        core.append(film.truth[film.present])
        core += [placed(pose, line) for pose in film.pose for line in film.outline]
        soft.append(ellipses(film.estimate[film.present], film.covariance[film.present]).reshape(-1, 2))
    points, beliefs = np.concatenate(core), np.concatenate(soft)
    low, high = points.min(axis=0), points.max(axis=0)
    reach = 0.15 * (high - low).max()
    if len(beliefs):
        low = np.minimum(low, np.maximum(beliefs.min(axis=0), low - reach))
        high = np.maximum(high, np.minimum(beliefs.max(axis=0), high + reach))
    half = (0.5 + margin) * (high - low).max()
    return np.stack([(low + high) / 2 - half, (low + high) / 2 + half])


def broken(tracks: Float[np.ndarray, "instants n d"], shown: Bool[np.ndarray, "instants n"]) -> np.ndarray:
    """Many tracks as one line: one after the other, with NaN between them and where they are not shown."""
    line = np.where(shown[..., None], tracks, np.nan)
    gap = np.full((1, *line.shape[1:]), np.nan)
    return np.concatenate([line, gap]).swapaxes(0, 1).reshape(-1, tracks.shape[-1])


class PlanarScene:
    """A planar scene in its axes, drawn once and moved: agent, path, view, targets with trails, beliefs.

    `trail` is how many steps back trails and path reach, None for all. `scale` grows the symbols. A `tint` is the one
    colour of agent and beliefs, for several agents in the same axes.
    """

    axes_class: ClassVar[Any] = Axes
    limits = staticmethod(limits)
    max_frames = 150
    """Of one animation."""
    planes: ClassVar[tuple[tuple[int, int], ...]] = ((0, 1),)
    """Pairs of the world's axes that a map shows: from above only."""
    panel_shape, panel_scale, panel_text = 1.0, 1.0, 8.0
    """In a small panel: its height over its width, the scale of symbols, the size of numbers [pt]."""

    @staticmethod
    def place(width: int, height: int, bottom: float, top: float) -> tuple[float, float, float, float]:
        """Where the axes stand in a picture [pixels]: left, bottom, width, height. A square, as high as it may be."""
        side = min(height - bottom - top, 0.54 * width)
        return 56.0, bottom, side, side

    def __init__(
        self,
        axes: Axes,
        film: EpisodeData,
        box: np.ndarray,
        trail: int | None = None,
        scale: float = 1.0,
        tint: str | None = None,
    ) -> None:
        own, seen, unseen, view = (tint,) * 4 if tint else (AGENT, SEEN, UNSEEN, SKY)
        self.axes, self.film, self.arc, self.trail = axes, film, film.arc(), trail
        self.size = 0.035 * scale * float(box[1, 0] - box[0, 0])
        axes.set_aspect("equal")
        axes.set_xlim(*box[:, 0])
        axes.set_ylim(*box[:, 1])

        def line(color: str, **style: Any) -> Line2D:
            return axes.add_line(Line2D([], [], color=color, **style))

        blank = np.zeros((3, 2))
        border = {"facecolor": view + "55", "edgecolor": own, "lw": 0.7 * scale}
        self.views = [Polygon(blank, zorder=1, **border) for _ in film.outline]
        self.path = line(own, lw=1.4 * scale, zorder=2)
        self.trails = line(GREY, lw=0.9 * scale, zorder=2)
        self.unseen = PolyCollection([], facecolors=unseen + "22", edgecolors=unseen, zorder=3)
        self.unseen.set(linewidth=1.0 * scale, linestyle=(0, (3, 2)))
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
        """All that moves, from the ground up."""
        beliefs = (self.unseen, self.unseen_means, self.seen, self.seen_means)
        return [*self.views, self.path, self.trails, *beliefs, self.targets, self.agent]

    def show(self, moment: int) -> None:
        """Move to a moment of the film (see `snapshot`)."""
        now = snapshot(self.film, self.arc, moment, self.trail)
        self.trails.set_data(*broken(now.tracks, now.tracked).T)
        self.path.set_data(*now.path.T)
        for view, border in zip(self.views, self.film.outline, strict=True):
            view.set_xy(placed(now.pose, border))
        self.agent.set_xy(placed(now.pose, self.size * KITE))
        self.targets.set_data(*now.truth.T)
        for areas, means, which in (
            (self.seen, self.seen_means, now.seen),
            (self.unseen, self.unseen_means, ~now.seen),
        ):
            areas.set_verts(list(ellipses(now.estimate[which], now.covariance[which])))
            means.set_data(*now.estimate[which].T)

    def label(self, size: float, x: bool = True, y: bool = True) -> None:
        """Quiet axes with small numbers, and the names of those that are asked for; y without a name has no numbers."""
        clean(self.axes, size)
        self.axes.tick_params(labelleft=y)
        for wanted, name, axis in ((x, "x [m]", self.axes.xaxis), (y, "y [m]", self.axes.yaxis)):
            if wanted:
                axis.set_label_text(name, fontsize=size)
                axis.labelpad = 2.5


def legend_entries() -> list[Artist]:
    """What the colours and symbols of a `PlanarScene` mean."""
    return [
        Line2D([], [], color=AGENT, lw=1.5, label="agent and its path"),
        Patch(facecolor=SKY + "55", edgecolor=AGENT, lw=0.7, label="field of view"),
        Line2D([], [], color=GREY, marker="s", ms=4, mfc=BLACK, mec=BLACK, lw=0.9, label="target, its track"),
        Patch(facecolor=SEEN + "40", edgecolor=SEEN, lw=1.3, label="estimate (95 %), just seen"),
        Patch(facecolor=UNSEEN + "22", edgecolor=UNSEEN, ls=(0, (3, 2)), label="estimate (95 %), not seen"),
    ]


def describe(film: EpisodeData) -> str:
    """Title, number of targets, and how well they were kept: the score, or where they come and go the share seen."""
    most = int(film.present.sum(axis=1).max())
    count = f"{most or 'no'} target{'s' * (most != 1)}"
    if not film.present.all():
        facts = [f"up to {count} at once", f"seen {film.seen_share:.1%} of their time"]
    else:
        facts = [count] if film.score is None else [count, f"score {film.score:.2f}"]
    return " · ".join([film.title, *facts] if film.title else facts)


def clean(axes: Axes, size: float = 8.0) -> None:
    """Quiet axes: thin grey frame, small numbers."""
    axes.tick_params(labelsize=size, length=2.5, width=0.6, color=GREY, pad=2)
    for spine in axes.spines.values():
        spine.set(linewidth=0.6, color=GREY)


def new_figure(width: float, height: float, dpi: int = 150, layout: Any = "constrained") -> Figure:
    """A white figure [inches] on its own canvas: nothing of pyplot, no global state."""
    figure = Figure(figsize=(width, height), dpi=dpi, facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure whole or not at all; the ending says the format (.png, .pdf, .svg)."""
    kinds = (".png", ".pdf", ".svg")
    if path.suffix.lower() not in kinds:
        raise InputError(f"{path}: expected a name that ends in {', '.join(kinds)}")
    buffer = io.BytesIO()
    figure.savefig(buffer, format=path.suffix[1:].lower())
    write_atomic(path, buffer.getvalue())
