"""Beliefs and the field of view as shapes to draw, without ROS."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from foveate.ros.records import Estimate, Position, Quaternion

CONFIDENCE = 0.95
"""Probability of the ellipses and ellipsoids."""
FLAT_M = 0.05
"""Height of an ellipse in the plane [m]."""


class Shape(NamedTuple):
    """A thing to draw: an ellipsoid with axes of lengths `size` [m], a text, or a line of this width through points."""

    namespace: str
    kind: str
    position: Position
    quaternion: Quaternion
    size: Position
    colour: tuple[float, float, float, float]
    text: str = ""
    points: tuple[Position, ...] = ()


UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)
BELIEF, VIEW, TRUTH = (0.0, 0.45, 0.7, 0.35), (0.84, 0.37, 0.0, 1.0), (0.0, 0.62, 0.45, 1.0)
"""Red, green, blue and opacity; of the figures' colours, without the library that draws those."""


def belief_shapes(estimates: Iterable[Estimate], dimension: int) -> list[Shape]:
    """An ellipse (ellipsoid in space) of 95 % and the id of each target."""
    shapes, radius = [], float(np.sqrt(chi2.ppf(CONFIDENCE, dimension)))
    for target, mean, covariance in estimates:
        values, axes = np.linalg.eigh(covariance[:dimension, :dimension])
        sizes = 2.0 * radius * np.sqrt(np.maximum(values, 0.0))
        R = np.eye(3)
        R[:dimension, :dimension] = axes * np.where(np.linalg.det(axes) < 0, -1.0, 1.0) ** (np.arange(dimension) == 0)
        at, size = _three(mean[:dimension]), _three(sizes, FLAT_M)
        shapes.append(Shape("beliefs", "ellipsoid", at, quaternion_of(R), size, BELIEF))
        above = (at[0], at[1], at[2] + 0.5 * size[2] + 0.3)
        shapes.append(Shape("ids", "text", above, UPRIGHT, (0.0, 0.0, 0.4), (0.1, 0.1, 0.1, 1.0), target))
    return shapes


def view_shapes(outline: Sequence[Float[np.ndarray, "_ d"]]) -> list[Shape]:
    """The border of the field of view, in the body frame."""
    return [
        Shape("view", "line", (0.0, 0.0, 0.0), UPRIGHT, (0.05, 0.0, 0.0), VIEW, points=tuple(map(_three, line)))
        for line in outline
    ]


def truth_shapes(positions: Float[np.ndarray, "n d"]) -> list[Shape]:
    """Small balls at the true positions."""
    size = (0.4, 0.4, 0.4)
    return [Shape("targets", "ellipsoid", _three(position), UPRIGHT, size, TRUTH) for position in positions]


def _three(numbers: Float[np.ndarray, " d"], third: float = 0.0) -> Position:
    x, y, *rest = map(float, numbers)
    return x, y, rest[0] if rest else third


def quaternion_of(R: Float[np.ndarray, "3 3"]) -> Quaternion:
    """Unit quaternion x, y, z, w of a rotation matrix, by its largest component (Shepperd 1978)."""
    squares = np.array([1 + 2 * R[i, i] - np.trace(R) for i in range(3)] + [1 + np.trace(R)])
    i = int(np.argmax(squares))
    if i == 3:
        numbers = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], squares[3]]
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        numbers = [0.0, 0.0, 0.0, R[k, j] - R[j, k]]
        numbers[i], numbers[j], numbers[k] = squares[i], R[j, i] + R[i, j], R[k, i] + R[i, k]
    x, y, z, w = (np.array(numbers) / np.linalg.norm(numbers)).tolist()
    return x, y, z, w
