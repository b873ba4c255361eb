"""Signed distances and their gradients by methods that share no formula with the code under test.

Convex polyhedra: all faces, edges and corners that scipy.spatial.ConvexHull finds, one by one. Curved shapes: a
numerical search over every piece of their boundary. The tests check these oracles in turn by mathematical programmes:
`halfspace_distance`, and `projection`, a general optimiser that is good to 1e-7.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize, nnls
from scipy.spatial import ConvexHull


class Answer(NamedTuple):
    distance: np.ndarray
    """(n,), signed."""
    gradient: np.ndarray
    """(n, d), of norm 1: from the nearest point of the boundary, or to it from inside."""
    gap: np.ndarray
    """(n,), how much farther the nearest point of another direction is; 0 on the medial axis."""
    feature: np.ndarray
    """(n,), which kind of boundary point is nearest."""


def on_segments(points, start, end):
    """The nearest points of segments, and whether each is a corner."""
    along = end - start
    square = np.sum(along**2)
    share = np.sum((points - start) * along, axis=-1) / square
    clipped = np.clip(share, 0, 1)
    # Measured from the nearer end, so that near a corner no digits are lost.
    middle = np.where(share[:, None] < 0.5, start + clipped[:, None] * along, end - (1 - clipped)[:, None] * along)
    return middle, np.where(share == clipped, 2, 3)


def on_triangle(points, corners):
    """The foot of each point on the plane of a triangle, NaN where it is outside of the triangle."""
    u, v = corners[1] - corners[0], corners[2] - corners[0]
    gram = np.array([[u @ u, u @ v], [u @ v, v @ v]])
    towards = points - corners[0]
    by_u, by_v = towards @ u, towards @ v
    determinant = gram[0, 0] * gram[1, 1] - gram[0, 1] ** 2
    s = (gram[1, 1] * by_u - gram[0, 1] * by_v) / determinant
    t = (gram[0, 0] * by_v - gram[0, 1] * by_u) / determinant
    within = (s >= 0) & (t >= 0) & (s + t <= 1)
    return np.where(within[:, None], corners[0] + s[:, None] * u + t[:, None] * v, np.nan)


def polyhedron_oracle(points, corners):
    """The convex hull of corners by all its faces, edges and corners, in long double; feature: 1, 2, 3 of these.

    Inside and outside alike the least distance to them all; outside is who is above the plane of any face.
    """
    points, corners = np.asarray(points, np.longdouble), np.asarray(corners, np.longdouble)
    hull = ConvexHull(corners.astype(float))
    faces = corners[hull.simplices]
    pairs = {tuple(sorted((face[i], face[i - 1]))) for face in hull.simplices for i in range(len(face))}
    found = [on_segments(points, *corners[list(pair)]) for pair in pairs]
    targets, kinds = [target for target, _ in found], [kind for _, kind in found]
    if corners.shape[1] == 3:
        targets += [on_triangle(points, face) for face in faces]
        kinds += [np.ones(len(points), int)] * len(faces)
        normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    else:
        kinds = [kind - 1 for kind in kinds]
        normals = (faces[:, 1] - faces[:, 0])[:, ::-1] * [1, -1]
    normals *= np.sign(np.sum(normals * hull.equations[:, :-1], axis=1, keepdims=True))
    outside = np.any([(points - face[0]) @ normal > 0 for face, normal in zip(faces, normals, strict=True)], axis=0)
    return answer(points, np.stack(targets), np.stack(kinds), outside)


def answer(points, targets, kinds, outside):
    """The Answer from candidates for the nearest point of the boundary (k, n, d), NaN where there is none."""
    distances = np.linalg.norm(points - targets, axis=2)
    distances = np.where(np.isnan(distances), np.inf, distances)
    best, each = distances.argmin(axis=0), np.arange(len(points))
    nearest, target = distances[best, each], targets[best, each]
    apart = np.linalg.norm(targets - target, axis=2)
    size = np.max(np.abs(target))
    rivals = np.where(apart > 1e-5 * nearest + 1e-9 * size, distances, np.inf)
    sign = np.where(outside, 1.0, -1.0)
    with np.errstate(invalid="ignore"):
        gradient = sign[:, None] * (points - target) / nearest[:, None]
    result = sign * nearest, gradient, rivals.min(axis=0) - nearest, kinds[best, each]
    return Answer(*(np.asarray(each, float) for each in result[:3]), result[3])


def halfspace_distance(points, faces):
    """Signed distance to {x : faces[:, :-1] x + faces[:, -1] <= 0}, unit normals, bounded or not.

    Outside: with z = x - p the least |z| with -N z >= N p + c, as NNLS (Lawson and Hanson, chapter 23).
    """
    normals = faces[:, :-1]
    last = np.zeros(points.shape[1] + 1)
    last[-1] = 1.0
    heights = points @ normals.T + faces[:, -1]
    distance = heights.max(axis=1)
    for i in np.flatnonzero(distance > 0):
        system = np.concatenate([-normals.T, heights[i][None] / distance[i]])
        residual = system @ nnls(system, last)[0] - last
        distance[i] *= np.linalg.norm(residual[:-1] / residual[-1])
    return distance


def search(points, piece, low, high, count):
    """The nearest points (n, d) of a curve or family of them: the best of `count` samples, then compass search."""
    step = (high - low) / (count - 1)
    near = np.linspace(low, high, count)[None]
    each = np.arange(len(points))
    for _ in range(40):
        towards = piece(near) - points[:, None]
        square = np.einsum("nki,nki->nk", towards, towards)
        best = np.broadcast_to(near, square.shape)[each, square.argmin(axis=1)]
        step /= 2
        near = best[:, None] + step * np.array([0, -1, 1])
    return piece(best[:, None])[:, 0]


def at_bearing(radius, bearing):
    return np.stack(np.broadcast_arrays(radius * np.cos(bearing), radius * np.sin(bearing)), axis=-1)


def sector_oracle(points, near, far, half):
    """An annular sector by a search over its arcs by bearing, its straight sides by range; feature: the piece."""
    arcs = [(lambda t, r=r: at_bearing(r, np.clip(t, -half, half)), -half, half) for r in (near, far) if r > 0]
    sides = [(lambda t, b=b: at_bearing(np.clip(t, near, far), b), near, far) for b in (-half, half)]
    parts = [
        np.concatenate([search(some, *piece, 17) for some in np.array_split(points, 20)]) for piece in arcs + sides
    ]
    radius = np.linalg.norm(points, axis=1)
    inside = (near <= radius) & (radius <= far) & (np.abs(np.arctan2(points[:, 1], points[:, 0])) <= half)
    kinds = np.broadcast_to(np.arange(len(parts))[:, None], (len(parts), len(points)))
    return answer(points, np.stack(parts), kinds, ~inside)


def cone_oracle(points, near, far, half):
    """A solid of revolution: that of its section through the point, both halves of it."""
    rho = np.linalg.norm(points[:, 1:], axis=1)
    section = sector_oracle(np.stack([points[:, 0], rho], axis=1), near, far, half)
    aside = section.gradient[:, 1:] * points[:, 1:] / np.where(rho > 0, rho, 1.0)[:, None]
    return section._replace(gradient=np.concatenate([section.gradient[:, :1], aside], axis=1))


def cone_distance_by_azimuth(points, near, far, half):
    """Distance to a cone's boundary that does not suppose that the nearest point is in the plane of the axis.

    By azimuth: the nearest point on a meridian arc of a cap, on a ruling of the side.
    """

    def at(radius, bearing, azimuth):
        aside = radius * np.sin(bearing)
        ahead = radius * np.cos(bearing) + 0 * azimuth
        return np.stack([ahead, aside * np.cos(azimuth), aside * np.sin(azimuth)], axis=-1)

    def meridian(radius):
        def piece(t):
            aside = points[:, 1:2] * np.cos(t) + points[:, 2:] * np.sin(t)
            return at(radius, np.clip(np.arctan2(aside, points[:, :1]), 0.0, half), t)

        return piece

    def ruling(t):
        direction = at(1.0, half, t)
        return at(np.clip(np.sum(points[:, None] * direction, axis=-1), near, far), half, t)

    pieces = [meridian(radius) for radius in (near, far) if radius > 0] + [ruling]
    # The azimuths at which a ruling comes nearer than a cone's apex may be few.
    targets = np.stack([search(points, piece, -math.pi, math.pi, 241) for piece in pieces])
    return np.linalg.norm(points - targets, axis=2).min(axis=0)


def shell_oracle(points, center, near, far):
    """A ball or disc about `center`, with a hole of radius `near` unless that is 0: along the ray through a point."""
    towards = points - center
    radius = np.linalg.norm(towards, axis=1)
    direction = np.where(radius[:, None] > 0, towards, [1.0] + [0.0] * (points.shape[1] - 1))
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    spheres = [far, -far] + ([near, -near] if near > 0 else [])  # the other end of the diameter matters at the center
    targets = np.stack([center + signed * direction for signed in spheres])
    kinds = np.broadcast_to(np.arange(len(spheres))[:, None], (len(spheres), len(points)))
    return answer(points, targets, kinds, (radius > far) | (radius < near))


def half_space_oracle(points, normal, offset):
    """One plane: its height, from which the nearest point follows."""
    height = points @ normal - offset
    gradient = np.broadcast_to(normal, points.shape)
    return Answer(height, gradient, np.full(len(points), np.inf), np.zeros(len(points), int))


def projection(point, start, constraints):
    """Distance from a point to the convex set where every constraint is >= 0, by SLSQP; NaN where it gives up."""
    result = minimize(
        lambda x: np.sum((x - point) ** 2),
        start,
        jac=lambda x: 2 * (x - point),
        method="SLSQP",
        constraints=[{"type": "ineq", "fun": function} for function in constraints],
        options={"ftol": 1e-15, "maxiter": 200},
    )
    feasible = all(np.min(function(result.x)) > -1e-8 for function in constraints)
    return math.sqrt(result.fun) if feasible and result.status in (0, 8) else math.nan
