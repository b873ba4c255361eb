"""Fields of view with their oracles, and points that reach every region of each of them."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from helpers import fov_oracles as oracles

from foveate.geometry.fov import FieldOfView, ball, half_space
from foveate.geometry.fov_planar import polygon, sector, triangle
from foveate.geometry.fov_spatial import cone, frustum, intersection, prism

POINTS = 20_000
EVERY = 5
"""Points at which derivatives are checked, one in 5, of every stratum."""
HEPTAGON = [[2.0 + math.cos(t), 0.5 + 0.4 * math.sin(t)] for t in (0.1, 0.9, 2.0, 2.8, 3.9, 4.4, 5.6)]


@dataclass(frozen=True, kw_only=True)
class Case:
    shape: FieldOfView
    oracle: Callable[[np.ndarray], oracles.Answer]
    boundary: Callable[[np.random.Generator, int], np.ndarray]
    """Random points of the whole boundary."""
    ridge: Callable[[np.random.Generator, int], np.ndarray]
    """Random points of its corners, edges, rims and apex."""
    medial: Callable[[np.random.Generator, np.ndarray], np.ndarray]
    """Points of the medial axis, or a plane of symmetry, near given ones."""

    @property
    def size(self) -> float:
        depth = float(self.shape.depth)
        return depth if math.isfinite(depth) else 1.0


def on_axis(rng, points):
    """Onto a plane of symmetry, or the axis."""
    kept = rng.choice([[True, False, True], [True, True, False], [True, False, False]], len(points))
    return np.where(kept[:, : points.shape[1]], points, 0.0)


def polyhedron(shape, corners):
    corners = np.asarray(corners, float)
    d = corners.shape[1]
    hull = oracles.ConvexHull(corners)
    center = corners.mean(axis=0)

    def boundary(rng, n):
        weights = rng.dirichlet(np.ones(d), n)
        return np.einsum("nk,nkd->nd", weights, corners[rng.choice(hull.simplices, n)])

    def ridge(rng, n):
        ends = corners[rng.choice(hull.simplices, n)][:, :2]  # of a triangle of the hull one side
        weight = rng.choice([0.0, 1.0], n) if d == 2 else np.clip(rng.uniform(-0.5, 1.5, n), 0, 1)
        return ends[:, 0] + weight[:, None] * (ends[:, 1] - ends[:, 0])

    def bisector(rng, points):
        """Of two sides of a polygon, from their corner inwards."""
        at = rng.integers(len(corners), size=len(points))
        order = np.argsort(np.arctan2(*(corners - center).T[::-1]))
        here, back, ahead = (corners[order][(at + k) % len(corners)] for k in (0, -1, 1))
        sides = [(end - here) / np.linalg.norm(end - here, axis=1, keepdims=True) for end in (back, ahead)]
        return here + rng.uniform(size=(len(points), 1)) * np.linalg.norm(here - center, axis=1)[:, None] * sum(sides)

    oracle = partial(oracles.polyhedron_oracle, corners=corners)
    medial = bisector if d == 2 else on_axis
    return Case(shape=shape, oracle=oracle, boundary=boundary, ridge=ridge, medial=medial)


def in_space(rng, points):
    """Points (x, rho) of a half-plane turned about the x axis by random angles."""
    azimuth = rng.uniform(-math.pi, math.pi, len(points))
    return np.stack([points[:, 0], points[:, 1] * np.cos(azimuth), points[:, 1] * np.sin(azimuth)], axis=1)


def revolved(shape, oracle, near, far, angle):
    """A sector, or the cone that it makes."""
    half = angle / 2
    place = in_space if shape.dimension == 3 else lambda rng, points: points

    def boundary(rng, n):
        radius = np.where(rng.uniform(size=n) < 0.5, rng.choice([near, far], n), rng.uniform(near, far, n))
        bearing = np.where(
            (radius == near) | (radius == far), rng.uniform(-half, half, n), rng.choice([-half, half], n)
        )
        return place(rng, oracles.at_bearing(radius, bearing))

    def ridge(rng, n):
        return place(rng, oracles.at_bearing(rng.choice([near, far], n), rng.choice([-half, half], n)))

    oracle = partial(oracle, near=near, far=far, half=half)
    return Case(shape=shape, oracle=oracle, boundary=boundary, ridge=ridge, medial=on_axis)


def shell(shape, center, near, far):
    center = np.asarray(center)

    def boundary(rng, n):
        direction = rng.normal(size=(n, len(center)))
        radius = rng.choice([near, far] if near > 0 else [far], (n, 1))
        return center + radius * direction / np.linalg.norm(direction, axis=1, keepdims=True)

    def medial(rng, points):
        direction = rng.normal(size=points.shape)
        middle = (near + far) / 2 if near > 0 else 0.0
        return center + middle * direction / np.linalg.norm(direction, axis=1, keepdims=True)

    oracle = partial(oracles.shell_oracle, center=center, near=near, far=far)
    return Case(shape=shape, oracle=oracle, boundary=boundary, ridge=boundary, medial=medial)


def plane(shape, normal, offset):
    normal = np.array(normal)

    def boundary(rng, n):
        points = rng.normal(size=(n, len(normal)))
        return points - (points @ normal - offset)[:, None] * normal

    oracle = partial(oracles.half_space_oracle, normal=normal, offset=offset)
    return Case(shape=shape, oracle=oracle, boundary=boundary, ridge=boundary, medial=lambda rng, points: points)


def upright(base):
    """The prism over a case of the plane."""

    def embedded(draw):
        return lambda rng, given: np.insert(
            draw(rng, given if isinstance(given, int) else given[:, :2]), 2, 1.0, axis=1
        )

    def oracle(points):
        answer = base.oracle(points[:, :2])
        return answer._replace(gradient=np.insert(answer.gradient, 2, 0.0, axis=1))

    draws = {name: embedded(getattr(base, name)) for name in ("boundary", "ridge", "medial")}
    return Case(shape=prism(base.shape), oracle=oracle, **draws)


def of_triangle(depth, angle):
    wide = depth * math.tan(angle / 2)
    return polyhedron(triangle(depth, angle), [[0, 0], [depth, -wide], [depth, wide]])


def of_frustum(near, far, width_angle, height_angle):
    signs = np.array([[1, j, k] for j in (-1, 1) for k in (-1, 1)])
    rays = signs * [1, math.tan(width_angle / 2), math.tan(height_angle / 2)]
    ends = [near * rays if near > 0 else np.zeros((1, 3)), far * rays]
    return polyhedron(frustum(near, far, width_angle, height_angle), np.concatenate(ends))


CASES = {
    "triangle paper": of_triangle(2.0, 2 * math.pi / 3),
    "triangle needle": of_triangle(3.0, 0.05),
    "triangle laser": of_triangle(1.0, 1e-5),
    "triangle flat": of_triangle(1.0, math.pi - 1e-3),
    "polygon": polyhedron(polygon(HEPTAGON), HEPTAGON),
    "frustum camera": of_frustum(0.3, 5.0, 1.2, 0.8),
    "frustum wide": of_frustum(1.0, 2.0, 2.4, 0.3),
    "frustum pyramid": of_frustum(0.0, 3.0, 1.0, 1.5),
    "frustum slab": of_frustum(1.5, 2.1, 0.6, 2.0),
    "frustum sheet": of_frustum(0.5, 4.0, 0.9, 1e-3),
    "frustum flat": of_frustum(0.0, 1.0, math.pi - 1e-3, 1.0),
    "ball": shell(ball([0.5, -1.0, 0.2], 1.5), [0.5, -1.0, 0.2], 0.0, 1.5),
    "disc": shell(ball([0.5, -1.0], 1.5), [0.5, -1.0], 0.0, 1.5),
    "full disc": shell(sector(1.5, 2 * math.pi), [0.0, 0.0], 0.0, 1.5),
    "full ring": shell(sector(1.5, 2 * math.pi, 1.2), [0.0, 0.0], 1.2, 1.5),
    "full shell": shell(cone(0.4, 2.0, 2 * math.pi), [0.0, 0.0, 0.0], 0.4, 2.0),
    "half plane": plane(half_space([3.0, 4.0], 0.7), [0.6, 0.8], 0.7),
    "half space": plane(half_space([1.0, 2.0, -2.0], 0.7), [1 / 3, 2 / 3, -2 / 3], 0.7),
}
CASES["prism"] = upright(CASES["polygon"])
for name, near, far, angle in [
    ("wedge", 0.0, 2.0, 1.0),
    ("laser", 0.0, 2.0, 1e-4),
    ("half ring", 0.5, 2.0, math.pi),
    ("reflex", 0.0, 2.0, 5.0),
    ("reflex ring", 1.0, 3.0, 4.5),
    ("slit ring", 0.5, 2.0, 2 * math.pi - 1e-3),
]:
    CASES[f"sector {name}"] = revolved(sector(far, angle, near), oracles.sector_oracle, near, far, angle)
for name, near, far, angle in [
    ("apex", 0.0, 2.0, 1.5),
    ("narrow", 0.5, 4.0, 0.6),
    ("laser", 0.0, 3.0, 1e-4),
    ("flat", 0.3, 2.0, math.pi),
    ("reflex", 0.4, 2.0, 4.8),
    ("slit", 0.0, 2.0, 2 * math.pi - 1e-3),
]:
    CASES[f"cone {name}"] = revolved(cone(near, far, angle), oracles.cone_oracle, near, far, angle)

INTERSECTIONS = {
    "lens": intersection(ball([0.0, 0.0], 1.0), ball([1.0, 0.0], 1.0), half_space([0.0, 1.0], 0.5)),
    "range-limited camera": intersection(frustum(0.3, 5.0, 1.2, 0.8), ball([0.0, 0.0, 0.0], 4.0)),
}
SHAPES = {name: case.shape for name, case in CASES.items()} | INTERSECTIONS

STRATA = {"wide": 4000, "boundary": 5000, "ridge": 4000, "inside": 3000, "medial": 2000, "far": 2000}
STRATUM = np.repeat(np.array(list(STRATA)), list(STRATA.values()))


def draw_points(case, seed=0):
    """20,000 points; `STRATUM` names what each is drawn for."""
    rng, size, d = np.random.default_rng(seed), case.size, case.shape.dimension

    def scattered(points):
        """Off the given points by 1e-9 to 0.3 of the size, or not at all."""
        offset = size * 10 ** rng.uniform(-9, -0.5, (len(points), 1)) * (rng.uniform(size=(len(points), 1)) < 0.9)
        return points + offset * rng.normal(size=points.shape)

    wide, boundary, ridge, inside, medial, far = STRATA.values()
    ends = case.boundary(rng, inside + medial), case.boundary(rng, inside + medial)
    chords = ends[0] + rng.uniform(size=(inside + medial, 1)) * (ends[1] - ends[0])
    directions = rng.normal(size=(far, d))
    return np.concatenate(
        [
            rng.uniform(-2 * size, 2 * size, (wide, d)),
            scattered(case.boundary(rng, boundary)),
            scattered(case.ridge(rng, ridge)),
            chords[:inside],
            case.medial(rng, chords[inside:]),
            directions * size * 10 ** rng.uniform(0.5, 3, (far, 1)),
        ]
    )


@cache
def answered(name):
    """The points of a case and what its oracle says of them."""
    points = draw_points(CASES[name])
    assert points.shape == (POINTS, CASES[name].shape.dimension)
    return points, CASES[name].oracle(points)


def cast(shape, dtype):
    """The same shape in another precision, its numbers rounded."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), shape)


@eqx.filter_jit
def _distance(shape, points):
    return shape.signed_distance(points)


@eqx.filter_jit
def contains(shape, points):
    """Which of the points are in the shape."""
    return shape.contains(points)


@eqx.filter_jit
def extent(shape):
    """How far the shape reaches."""
    return shape.extent


@eqx.filter_jit
def _gradients(shape, points):
    reverse = jax.value_and_grad(lambda shape, point: shape.signed_distance(point), (0, 1))
    value, (by_shape, by_point) = jax.vmap(reverse, (None, 0))(shape, points)
    return value, by_point, jax.vmap(jax.jacfwd(shape.signed_distance))(points), by_shape


def padded(points, count):
    """At least `count` points, so that shapes of a kind are compiled once."""
    return jnp.asarray(np.resize(points, (max(count, len(points)), points.shape[1])))


def distance(shape, points):
    """The signed distances of points (n, d)."""
    return np.asarray(_distance(shape, padded(points, POINTS)))[: len(points)]


def gradients(shape, points):
    """Signed distances; derivatives by the point, reverse and forward; by the shape, for points of any number."""
    *parts, by_shape = _gradients(shape, padded(points, POINTS // EVERY))
    return *(np.asarray(part)[: len(points)] for part in parts), by_shape
