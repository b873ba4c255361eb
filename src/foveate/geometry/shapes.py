"""Convex polygons and circles, in the plane or extruded in space, with exact signed distances, as numpy arrays."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

POINTS_PER_CHUNK = 1 << 18
"""Points whose distances are computed at once: what a cache holds."""


class Shape(NamedTuple):
    """A convex polygon, its corners in counterclockwise order, grown by `radius` [m]; a circle has one corner.

    With `low` and `high` [m] it is extruded between these heights.
    """

    corners: Float[np.ndarray, "v 2"]
    radius: float = 0.0
    low: float | None = None
    high: float | None = None

    @property
    def dimension(self) -> int:
        """Dimension of space."""
        return 2 if self.low is None else 3

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner [m] of the box around it."""
        low, high = self.corners.min(axis=0) - self.radius, self.corners.max(axis=0) + self.radius
        if self.low is None or self.high is None:
            return low, high
        return np.append(low, self.low), np.append(high, self.high)

    @property
    def thickness(self) -> float:
        """Least extent over all directions [m]: of a polygon, normal to one of its edges."""
        least = 2.0 * self.radius
        if len(self.corners) > 1:
            along = np.roll(self.corners, -1, axis=0) - self.corners
            normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
            least += float(np.ptp(self.corners @ normal.T, axis=0).min())
        return least if self.low is None or self.high is None else min(least, self.high - self.low)

    def signed_distance(self, points: Float[np.ndarray, "*n d"]) -> Float[np.ndarray, "*n"]:
        """Distance of points to the border [m]: > 0 outside, < 0 inside."""
        distance = _to_polygon(self.corners, points[..., :2]) - self.radius
        if self.low is None or self.high is None:
            return distance
        above = np.abs(points[..., 2] - 0.5 * (self.low + self.high)) - 0.5 * (self.high - self.low)
        outside = np.hypot(np.maximum(distance, 0.0), np.maximum(above, 0.0))
        return outside + np.minimum(np.maximum(distance, above), 0.0)


def is_convex(corners: Sequence[Sequence[float]]) -> bool:
    """True for a polygon of at least three corners, convex and in counterclockwise order, no three in a line."""
    if len(corners) < 3:
        return False
    along = np.roll(np.array(corners, float), -1, axis=0) - np.array(corners, float)
    after = np.roll(along, -1, axis=0)
    turn = np.arctan2(along[:, 0] * after[:, 1] - along[:, 1] * after[:, 0], np.sum(along * after, axis=1))
    # A star turns left at every corner, too, but more than once around.
    return bool((turn > 1e-9).all() and abs(turn.sum() - 2 * np.pi) < 1e-6)


def rectangle(low: Sequence[float], high: Sequence[float]) -> Shape:
    """A rectangle, or in space a box, between two corners [m]."""
    (x0, y0), (x1, y1) = low[:2], high[:2]
    heights = (float(low[2]), float(high[2])) if len(low) == 3 else (None, None)
    return Shape(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float), 0.0, *heights)


def union_distance(shapes: Sequence[Shape], points: Float[np.ndarray, "n d"], most: float) -> Float[np.ndarray, " n"]:
    """Signed distance of points to the union of shapes [m], at most `most`; exact outside of all.

    Inside of several shapes it is the depth in the deepest: where they overlap the depth in the union may be larger.
    """
    distance = np.full(len(points), most)
    for first in range(0, len(points), POINTS_PER_CHUNK):
        chunk = slice(first, first + POINTS_PER_CHUNK)
        for shape in shapes:
            distance[chunk] = np.minimum(distance[chunk], shape.signed_distance(points[chunk]))
    return distance


def _to_polygon(corners: Float[np.ndarray, "v 2"], points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
    """Signed distance to a convex polygon [m], or the distance to its only corner."""
    if len(corners) == 1:
        return np.hypot(*np.moveaxis(points - corners[0], -1, 0))
    if len(corners) == 4 and len(np.unique(corners[:, 0])) == len(np.unique(corners[:, 1])) == 2:
        # Aligned with the axes, as most walls of random maps are: several times quicker.
        low, high = corners.min(axis=0), corners.max(axis=0)
        x, y = np.moveaxis(np.abs(points - 0.5 * (low + high)) - 0.5 * (high - low), -1, 0)
        return np.hypot(np.maximum(x, 0.0), np.maximum(y, 0.0)) + np.minimum(np.maximum(x, y), 0.0)
    square, inside = np.inf, True
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        x, y = np.moveaxis(points - start, -1, 0)
        u, v = end - start
        share = np.clip((x * u + y * v) / (u * u + v * v), 0.0, 1.0)
        square = np.minimum(square, (x - share * u) ** 2 + (y - share * v) ** 2)
        inside = inside & (u * y - v * x >= 0.0)
    return np.where(inside, -1.0, 1.0) * np.sqrt(square)
