"""Bodies of space as lines and polygons [m]: 95 % ellipsoids as an eye sees them, fields of view with faces."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

CHI_SQUARE_95 = 7.814727903251179
"""A Gaussian of space lies within this squared Mahalanobis distance with probability 0.95: chi2.ppf(0.95, 3)."""


CIRCLE = np.stack([np.cos(t := np.linspace(0, 2 * np.pi, 49)), np.sin(t)], axis=-1)


def ellipsoid_radii(covariance: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Semi-axes [m] of the regions that hold 95 % of N(0, covariance), as columns: they map the unit sphere there."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(CHI_SQUARE_95 * np.maximum(values, 1e-12))[:, None, :]


def contours(
    mean: Float[np.ndarray, "n 3"], covariance: Float[np.ndarray, "n 3 3"], eye: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "n v 3"]:
    """The closed lines along which 95 % ellipsoids are seen edge-on from `eye`: their border in a picture [m].

    With x = mean + L u, |u| = 1, the ray from c = L^-1 (eye - mean) touches the sphere where u . c = 1, a circle.
    """
    radii = ellipsoid_radii(covariance)
    c = np.linalg.solve(radii, (eye - mean)[..., None])[..., 0]
    away = np.maximum(np.linalg.norm(c, axis=-1, keepdims=True), 1.0)  # an eye inside sees no border
    normal, height = c / away, 1 / away
    # Two unit vectors across the normal: the frame of its singular value decomposition has them.
    across = np.linalg.svd(normal[:, None, :])[2][:, 1:]
    circle = height[..., None] * normal[:, None] + np.sqrt(1 - height[..., None] ** 2) * (CIRCLE @ across)
    return mean[:, None] + circle @ radii.swapaxes(-1, -2)


def meridians(
    mean: Float[np.ndarray, "n 3"], covariance: Float[np.ndarray, "n 3 3"], eye: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "m v 3"]:
    """The halves that face `eye` of the three principal sections of every ellipsoid [m], m = 3 n."""
    radii = ellipsoid_radii(covariance)
    c = np.linalg.solve(radii, (eye - mean)[..., None])[..., 0]
    lines = []
    half = np.linspace(-np.pi / 2, np.pi / 2, 17)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        # The middle of the half is the point of the section that faces the eye most.
        angle = np.arctan2(c[:, j], c[:, i])[:, None] + half
        u = np.zeros((len(mean), len(half), 3))
        u[..., i], u[..., j] = np.cos(angle), np.sin(angle)
        lines.append(mean[:, None] + u @ radii.swapaxes(-1, -2))
    return np.concatenate(lines)


def faces(outline: Sequence[Float[np.ndarray, "_ 3"]]) -> list[Float[np.ndarray, "_ 3"]]:
    """Polygons that span an outline: its closed lines, and what lies between two of them that straight edges join."""
    loops = [line[:-1] for line in outline if len(line) > 3 and np.allclose(line[0], line[-1])]
    edges = [line for line in outline if len(line) == 2]
    polygons = list(loops)
    for i, one in enumerate(loops):
        for other in loops[i + 1 :]:
            if len(one) == len(other) and any(_joins(edge, one, other) for edge in edges):
                sides = np.stack([one, np.roll(one, -1, 0), np.roll(other, -1, 0), other], axis=1)
                polygons += list(sides)
    return polygons


def _joins(edge: np.ndarray, one: np.ndarray, other: np.ndarray) -> bool:
    """Whether an edge leads from a corner of one loop to the same corner of the other."""
    return bool(np.any(np.isclose(one, edge[0]).all(axis=1) & np.isclose(other, edge[1]).all(axis=1)))
