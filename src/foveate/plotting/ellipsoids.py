"""95 % ellipses and ellipsoids of Gaussian beliefs, faces of fields of view, and boxes, as lines and polygons [m].

A region is the image of the unit disc or ball, x = mean + L u with |u| <= 1; the columns of L are its semi-axes.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float

from foveate.geometry.fov import FieldOfView
from foveate.models.gate import gate_limit

CIRCLE = np.stack([np.cos(t := np.linspace(0, 2 * np.pi, 49)), np.sin(t)], axis=-1)
"""Unit circle as a closed line of 48 segments."""

MIN_VARIANCE_M2 = 1e-12
"""Smallest variance drawn, (1 um)^2: rounding may make one negative, and `contours` divides by its root."""


def chi_square_95(dimension: int) -> float:
    """Squared Mahalanobis distance within which a Gaussian lies with probability 0.95."""
    limit = gate_limit(0.95, dimension)
    assert limit is not None, "None only without a probability"
    return limit


def principal_axes(
    covariance: Float[np.ndarray, "*m d d"],
) -> tuple[Float[np.ndarray, "*m d d"], Float[np.ndarray, "*m d"]]:
    """Directions (columns) and lengths [m] of the semi-axes of the 95 % regions of N(0, covariance)."""
    values, directions = np.linalg.eigh(covariance)
    return directions, np.sqrt(chi_square_95(values.shape[-1]) * np.maximum(values, MIN_VARIANCE_M2))


def semi_axes(covariance: Float[np.ndarray, "*m d d"]) -> Float[np.ndarray, "*m d d"]:
    """L: semi-axes [m] of the 95 % regions of N(0, covariance), as columns."""
    directions, lengths = principal_axes(covariance)
    return directions * lengths[..., None, :]


def half_widths(covariance: Float[np.ndarray, "*m d d"]) -> Float[np.ndarray, "*m d"]:
    """Half the side lengths [m] of the axis-aligned boxes around the 95 % regions of N(0, covariance)."""
    return np.sqrt(chi_square_95(covariance.shape[-1]) * np.diagonal(covariance, axis1=-2, axis2=-1))


def ellipses(mean: Float[np.ndarray, "n 2"], covariance: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n v 2"]:
    """Polygons [m] around the 95 % regions of N(mean, covariance); the first corner is not repeated."""
    return mean[:, None, :] + CIRCLE[:-1] @ semi_axes(covariance).swapaxes(-1, -2)


def contours(
    mean: Float[np.ndarray, "n 3"], covariance: Float[np.ndarray, "n 3 3"], eye: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "n v 3"]:
    """Silhouettes of the 95 % ellipsoids seen from `eye`, as closed lines [m].

    With x = mean + L u, |u| = 1, the ray from c = L^-1 (eye - mean) touches the sphere where u . c = 1, a circle.
    """
    L = semi_axes(covariance)
    c = np.linalg.solve(L, (eye - mean)[..., None])[..., 0]
    distance = np.maximum(np.linalg.norm(c, axis=-1, keepdims=True), 1.0)  # seen from inside: a point
    normal, height = c / distance, 1 / distance
    # Two unit vectors normal to it, by singular value decomposition: a cross product with a fixed vector may vanish.
    across = np.linalg.svd(normal[:, None, :])[2][:, 1:]
    circle = height[..., None] * normal[:, None] + np.sqrt(1 - height[..., None] ** 2) * (CIRCLE @ across)
    return mean[:, None] + circle @ L.swapaxes(-1, -2)


def meridians(
    mean: Float[np.ndarray, "n 3"], covariance: Float[np.ndarray, "n 3 3"], eye: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "m v 3"]:
    """Front halves, seen from `eye`, of the three principal sections of each ellipsoid [m]; m = 3 n."""
    L = semi_axes(covariance)
    c = np.linalg.solve(L, (eye - mean)[..., None])[..., 0]
    lines, half = [], np.linspace(-np.pi / 2, np.pi / 2, 17)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        # The middle of each half is the point of the section closest to facing the eye.
        angle = np.arctan2(c[:, j], c[:, i])[:, None] + half
        u = np.zeros((len(mean), len(half), 3))
        u[..., i], u[..., j] = np.cos(angle), np.sin(angle)
        lines.append(mean[:, None] + u @ L.swapaxes(-1, -2))
    return np.concatenate(lines)


def lifted(points: Float[np.ndarray, "*m d"], height: float = 0.0) -> Float[np.ndarray, "*m 3"]:
    """Lift planar points to a height [m]; spatial ones are returned unchanged."""
    if points.shape[-1] == 3:
        return points
    return np.concatenate([points, np.full((*points.shape[:-1], 1), height)], axis=-1)


def borders(view: FieldOfView) -> tuple[Float[np.ndarray, "_ d"], ...]:
    """Lines of a field of view in the body frame [m]: one in the plane, several in space."""
    outline = view.outline()
    return tuple(np.asarray(line, float) for line in ([outline] if isinstance(outline, np.ndarray) else outline))


def faces(outline: Sequence[Float[np.ndarray, "_ 3"]]) -> list[Float[np.ndarray, "_ 3"]]:
    """Faces of an outline: its closed lines, and the quadrilaterals between two loops that edges connect."""
    loops = [line[:-1] for line in outline if len(line) > 3 and is_closed(line)]
    edges = [line for line in outline if len(line) == 2]
    polygons = list(loops)
    for loop, other in combinations(loops, 2):
        if len(loop) == len(other):
            # An edge connects the loops if it leads from a corner of one to the same corner of the other.
            at_corners = [np.isclose(loop, a).all(axis=1) & np.isclose(other, b).all(axis=1) for a, b in edges]
            if np.any(at_corners):
                polygons += list(np.stack([loop, np.roll(loop, -1, 0), np.roll(other, -1, 0), other], axis=1))
    return polygons


def box_lines(box: Float[np.ndarray, "2 d"]) -> list[Float[np.ndarray, "_ d"]]:
    """Edges of a box from its lower to its upper corner: a rectangle; or floor, ceiling, and the four edges between."""
    (x, y), (x2, y2) = box[:, :2]
    rectangle = np.array([(x, y), (x2, y), (x2, y2), (x, y2), (x, y)])
    if box.shape[1] == 2:
        return [rectangle]
    floor, ceiling = (np.column_stack([rectangle, np.full(5, height)]) for height in box[:, 2])
    return [floor, ceiling, *np.stack([floor[:-1], ceiling[:-1]], axis=1)]


def is_closed(line: Float[np.ndarray, "n d"]) -> bool:
    """Test whether a line ends where it begins."""
    return bool(np.allclose(line[0], line[-1]))
