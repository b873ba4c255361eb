"""Meshes, lines and turns of a browser's scene, drawn by viser."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.colors import to_rgb
from scipy.spatial.transform import Rotation

from foveate.plotting.ellipsoids import CIRCLE, faces, is_closed, lifted, principal_axes

NO_SEGMENTS = np.zeros((1, 2, 3))
"""Line of no length: viser accepts no empty one."""

Mesh = tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]


def color(name: str) -> tuple[int, ...]:
    """RGB of a matplotlib colour, from 0 to 255."""
    return tuple(round(255 * part) for part in to_rgb(name))


def segments(line: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 2 3"]:
    """Cut a line into its segments, except those with an end at NaN."""
    pairs = np.stack([line[:-1], line[1:]], axis=1)
    return pairs[np.isfinite(pairs).all(axis=(1, 2))]


def set_segments(handle: Any, parts: Sequence[Float[np.ndarray, "_ 2 3"]]) -> None:
    """Set the segments of a line in the scene; hide it without any."""
    points = np.concatenate([np.zeros((0, 2, 3)), *parts])
    handle.visible = bool(len(points))
    if len(points):
        handle.points = points


def add_line(scene: Any, name: str, tint: str, thickness: float, parts: np.ndarray = NO_SEGMENTS) -> Any:
    """Add a line of these segments, of a width in pixels; return its handle."""
    return scene.add_line_segments(name, parts, color(tint), thickness=thickness, thickness_units="screen")


def ball() -> Mesh:
    """Mesh of the unit sphere, 12 x 24 quadrilaterals."""
    polar, around = np.meshgrid(np.linspace(0, np.pi, 13), np.linspace(0, 2 * np.pi, 25), indexing="ij")
    points = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
    corner = np.arange(12)[:, None] * 25 + np.arange(24)
    quads = np.stack([corner, corner + 25, corner + 26, corner + 1], axis=-1).reshape(-1, 4)
    return points.reshape(-1, 3), np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def disc() -> Mesh:
    """Mesh of the unit disc on the floor."""
    return _fan(lifted(CIRCLE), np.zeros(3))


def fan(line: Float[np.ndarray, "n d"]) -> Mesh:
    """Mesh of the area within a closed line: a fan from the origin if the line passes it, else from its middle."""
    # From its apex, a sector of more than half a turn is a fan; from its middle it is not.
    points = lifted(line)
    apex = np.abs(points).sum(axis=1) < 1e-9
    return _fan(points, np.zeros(3) if apex.any() else points[:-1].mean(axis=0))


def _fan(points: Float[np.ndarray, "n 3"], middle: Float[np.ndarray, "3"]) -> Mesh:
    n = len(points)
    return np.concatenate([points, [middle]]), np.stack([np.full(n - 1, n), np.arange(n - 1), np.arange(1, n)], axis=-1)


def view_mesh(outline: Sequence[Float[np.ndarray, "_ d"]]) -> Mesh:
    """Mesh of the faces of a field of view in the body frame, of its borders."""
    vertices, triangles = np.zeros((0, 3)), np.zeros((0, 3), int)
    is_planar = all(line.shape[1] == 2 for line in outline)
    for line in outline if is_planar else faces(outline):
        corners, parts = fan(line if is_closed(line) else np.concatenate([line, line[:1]]))
        triangles = np.concatenate([triangles, parts + len(vertices)])
        vertices = np.concatenate([vertices, corners])
    return vertices, triangles


def quaternion(R: Float[np.ndarray, "d d"]) -> Float[np.ndarray, "4"]:
    """Quaternion [w, x, y, z] of a planar or spatial rotation."""
    full = np.eye(3)
    full[: len(R), : len(R)] = R
    return Rotation.from_matrix(full).as_quat(scalar_first=True)


def turn_and_scale(covariance: Float[np.ndarray, "d d"]) -> tuple[Float[np.ndarray, "4"], tuple[float, float, float]]:
    """Quaternion and scale [m] that map the unit disc or sphere to the 95 % region of N(0, covariance)."""
    directions, lengths = principal_axes(covariance)
    # Eigenvectors may form a reflection, which has no quaternion; reversing one axis leaves the region the same.
    directions[:, 0] *= np.sign(np.linalg.det(directions))
    first, second, *third = lengths.tolist()
    return quaternion(directions), (first, second, third[0] if third else 1.0)
