"""Labels of points that cover neither each other, nor the points, nor lines."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from foveate.io.figures import GREY

HALO = withStroke(linewidth=2.5, foreground="white")
"""Keeps a label legible on a line."""
SIZE_PT, RADII_PT = 8.0, (7.0, 14.0, 24.0, 36.0)
"""Size of a label, and the distances from its point at which places are tried, nearest first."""
SIDES = tuple((np.cos(angle), np.sin(angle)) for angle in np.radians([0, 60, -60, 90, -90, 120, -120, 180]))
"""Directions from the point that are tried, the best first."""
POINT_PT = 4.0
"""Half the size of a point."""
LEADER_PT = 10.0
"""A label farther from its point than this has a line to it."""

Label = tuple[float, float, str]
"""x and y in data units, and the text."""


def place_labels(axes: Axes, labels: Sequence[Label], levels: Sequence[float] = ()) -> None:
    """Write each label beside its point, at the place that covers the least; a far one has a line to its point.

    Places depend on the size of the axes: draw the figure before. `levels` are horizontal lines to keep clear of.
    """
    if not labels:
        return
    scale = axes.figure.dpi / 72
    points = axes.transData.transform([(x, y) for x, y, _ in labels]) / scale
    frame = np.array(axes.get_window_extent().extents) / scale
    heights = axes.transData.transform([(labels[0][0], level) for level in levels]).reshape(-1, 2)[:, 1] / scale
    boxes = [np.concatenate([point - POINT_PT, point + POINT_PT]) for point in points]
    boxes += [np.array([frame[0], y - 1, frame[2], y + 1]) for y in heights]
    # The most crowded first: they have the fewest places.
    near = np.linalg.norm(points[:, None] - points[None], axis=-1)
    for i in np.argsort(np.sort(near, axis=1)[:, 1:4].sum(axis=1), kind="stable"):
        size = np.array([0.62 * SIZE_PT * len(labels[i][2]), 1.25 * SIZE_PT])
        offset, box = min(_places(points[i], size), key=lambda place: _cost(*place, boxes, frame))
        boxes.append(box)
        far = float(np.linalg.norm(offset)) > LEADER_PT
        text = axes.annotate(
            labels[i][2], labels[i][:2], tuple(offset), textcoords="offset points", fontsize=SIZE_PT, zorder=6,
            ha=_side(offset[0], "left", "right"), va="center", path_effects=[HALO],
            arrowprops={"arrowstyle": "-", "color": GREY, "lw": 0.6, "shrinkA": 0, "shrinkB": 2} if far else None,
        )  # fmt: skip
        text.set_in_layout(False)


def _side(offset: float, positive: str, negative: str) -> str:
    return positive if offset > 0.5 else negative if offset < -0.5 else "center"


def _places(point: np.ndarray, size: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Offsets of the text from its point, and the boxes that it would fill [pt]."""
    places = []
    for radius in RADII_PT:
        for side in SIDES:
            offset = radius * np.array(side)
            left = {"left": 0.0, "right": -size[0], "center": -size[0] / 2}[_side(offset[0], "left", "right")]
            low = point + offset + np.array([left, -size[1] / 2])
            places.append((offset, np.concatenate([low, low + size])))
    return places


def _cost(offset: np.ndarray, box: np.ndarray, others: Sequence[np.ndarray], frame: np.ndarray) -> float:
    """Area covered [pt^2], much more for what is beyond the frame, and a little for the distance."""
    covered = sum(_overlap(box, other) for other in others)
    outside = (box[2] - box[0]) * (box[3] - box[1]) - _overlap(box, frame)
    return covered + 10.0 * outside + 0.5 * float(np.linalg.norm(offset))


def _overlap(one: np.ndarray, other: np.ndarray) -> float:
    sides = np.minimum(one[2:], other[2:]) - np.maximum(one[:2], other[:2])
    return float(np.prod(np.maximum(sides, 0.0)))
