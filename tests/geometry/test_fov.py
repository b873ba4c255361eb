"""Signed distances of every shape against oracles that share no formula with them, on 20,000 points a shape."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.fov_cases import (
    CASES,
    HEPTAGON,
    INTERSECTIONS,
    POINTS,
    STRATUM,
    answered,
    cast,
    contains,
    distance,
    extent,
    gradients,
)
from helpers.fov_oracles import ConvexHull, cone_distance_by_azimuth, halfspace_distance, projection

from foveate.geometry.fov import half_space
from foveate.geometry.fov_planar import polygon, triangle
from foveate.geometry.fov_spatial import intersection


@pytest.mark.parametrize("name", CASES)
def test_signed_distance_is_exact(name):
    """To 1e-11 of the size, near and a thousand times as far away; 1e-9 would do."""
    case = CASES[name]
    points, expected = answered(name)
    found = distance(case.shape, points)
    np.testing.assert_allclose(found, expected.distance, rtol=0, atol=1e-11 * case.size)
    clear = np.abs(expected.distance) > 1e-11 * case.size
    contained = np.asarray(contains(case.shape, jnp.asarray(points)))
    np.testing.assert_array_equal(contained[clear], expected.distance[clear] < 0)


SMOOTH = ("ball", "disc", "full disc", "half plane", "half space")


@pytest.mark.parametrize("name", CASES)
def test_points_reach_every_region(name):
    """Else the test above could pass without having looked."""
    size, expected = CASES[name].size, answered(name)[1]
    inside, near = expected.distance < 0, np.abs(expected.distance) < 1e-6 * size
    assert len(inside) == POINTS
    assert min(inside.sum(), (~inside).sum()) > 3000
    assert min((near & inside).sum(), (near & ~inside).sum()) > 1000
    assert np.sum(expected.distance > 10 * size) > 500
    kinds, counts = np.unique(expected.feature, return_counts=True)
    assert len(kinds) >= (1 if name in SMOOTH else 3 if name.startswith("frustum") else 2)
    assert counts.min() > 200
    if not name.startswith("half"):
        assert np.sum(expected.gap[STRATUM == "medial"] < 1e-3 * size) > 100


@pytest.mark.parametrize("name", [name for name in CASES if name.startswith(("triangle", "polygon", "frustum"))])
def test_oracle_of_polyhedra_solves_the_least_distance_programme(name):
    points, expected = answered(name)[0][::50], answered(name)[1].distance[::50]
    corners = CASES[name].oracle.keywords["corners"]
    size = CASES[name].size
    found = size * halfspace_distance(points / size, ConvexHull(corners / size).equations)
    # The programme squares the condition of a sharp corner.
    tolerance = 1e-4 if name == "triangle laser" else 1e-9
    np.testing.assert_allclose(found, expected, rtol=tolerance, atol=tolerance * size)


@pytest.mark.parametrize("name", [name for name in CASES if name.startswith("cone")])
def test_oracle_of_cones_is_nearest_over_all_azimuths(name):
    points, expected = answered(name)[0][::40], answered(name)[1].distance[::40]
    found = cone_distance_by_azimuth(points, **CASES[name].oracle.keywords)
    np.testing.assert_allclose(found, np.abs(expected), rtol=1e-12, atol=1e-9 * CASES[name].size)


def constraints_of(name):
    """Functions >= 0 in a convex shape, and a point in it."""
    tan = math.tan(0.5)
    camera = [
        lambda x: np.array([x[0] - 0.3, 5.0 - x[0]]),
        lambda x: x[0] * math.tan(0.6) - np.array([x[1], -x[1]]),
        lambda x: x[0] * math.tan(0.4) - np.array([x[2], -x[2]]),
    ]
    return {
        "sector wedge": ([lambda x: 4.0 - x @ x, lambda x: tan * x[0] - np.array([x[1], -x[1]])], [1.0, 0.0]),
        "cone apex": (
            [lambda x: 4.0 - x @ x, lambda x: (math.tan(0.75) * x[0]) ** 2 - x[1:] @ x[1:], lambda x: x[0]],
            [1.0, 0.1, 0.1],
        ),
        "ball": ([lambda x: 2.25 - np.sum((x - [0.5, -1.0, 0.2]) ** 2)], [0.5, -1.0, 0.2]),
        "frustum camera": (camera, [1.0, 0.0, 0.0]),
        "range-limited camera": ([*camera, lambda x: 16.0 - x @ x], [1.0, 0.0, 0.0]),
        "lens": (
            [lambda x: 1.0 - x @ x, lambda x: 1.0 - np.sum((x - [1.0, 0.0]) ** 2), lambda x: 0.5 - x[1]],
            [0.5, 0.0],
        ),
    }[name]


def projected(name, points):
    """Distances by a general optimiser, where it succeeds."""
    constraints, start = constraints_of(name)
    found = np.array([projection(point, np.array(start), constraints) for point in points])
    assert np.isfinite(found).mean() > 0.8
    return found


@pytest.mark.parametrize("name", ["sector wedge", "cone apex", "ball", "frustum camera"])
def test_oracles_agree_with_a_general_optimiser(name):
    points, expected = answered(name)[0], answered(name)[1].distance
    chosen = np.flatnonzero((expected > 0.05) & (expected < 10))[::120]
    found = projected(name, points[chosen])
    known = np.isfinite(found)
    assert np.all(found[known] > expected[chosen][known] - 1e-6)
    # Where it ends at an apex, it may end anywhere near it: the constraints are not smooth there.
    assert np.mean(found[known] < expected[chosen][known] + 1e-6) > (0.8 if name == "cone apex" else 0.999)


# --- intersections --------------------------------------------------------------------------------


def test_intersection_of_polygons_is_exact_inside_and_a_lower_bound_outside():
    corners = [[0, 0], [3, -3 * math.tan(0.5)], [3, 3 * math.tan(0.5)]]
    shape = intersection(triangle(3.0, 1.0), polygon(HEPTAGON), half_space([1.0, 0.0], 2.2))
    hulls = [ConvexHull(np.asarray(vertices, float)).equations for vertices in (corners, HEPTAGON)]
    points = np.random.default_rng(0).uniform([0, -1], [4, 2], (POINTS, 2))
    exact = halfspace_distance(points, np.concatenate([*hulls, [[1.0, 0.0, -2.2]]]))
    value = distance(shape, points)
    inside = exact <= 0
    assert inside.sum() > 1000
    np.testing.assert_allclose(value[inside], exact[inside], rtol=0, atol=1e-9)
    assert np.all(value[~inside] <= exact[~inside] + 1e-9)
    assert np.all(value[~inside] > 0)
    assert np.any(value[~inside] < exact[~inside] - 0.1)


@pytest.mark.parametrize("name", INTERSECTIONS)
def test_intersection_of_curved_shapes(name):
    """Inside, the ball of that radius about the point is the largest in the shape; outside, it is a lower bound."""
    shape, (constraints, _) = INTERSECTIONS[name], constraints_of(name)

    def contained(points):
        return np.array([all(np.all(function(point) >= 0) for function in constraints) for point in points])

    rng, d = np.random.default_rng(0), INTERSECTIONS[name].dimension
    points = rng.uniform(-1.5, 2, (2000, d)) * (2.0 if d == 3 else 1.0)
    value, gradient, _, _ = gradients(shape, points)
    inside = contained(points)
    np.testing.assert_array_equal(value <= 0, inside)
    assert inside.sum() > 100

    for i in np.flatnonzero(inside)[:100]:
        directions = rng.normal(size=(40, d))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        assert contained(points[i] - (1 - 1e-9) * value[i] * np.concatenate([directions, gradient[i][None]])).all()
        assert not contained(points[i][None] - (value[i] - 1e-9) * gradient[i]).any()

    chosen = np.flatnonzero(value > 0.05)[:100]
    exact = projected(name, points[chosen])
    known = np.isfinite(exact)
    assert np.all(value[chosen][known] <= exact[known] + 1e-6)
    assert np.any(value[chosen][known] < exact[known] - 0.01)


# --- precision and scale --------------------------------------------------------------------------


@pytest.mark.parametrize("name", CASES)
def test_float32_keeps_its_precision(name):
    """To a few rounding errors of the size, or of the point where it is far: of the shape as float32 has it."""
    case = CASES[name]
    points, shape = jnp.asarray(answered(name)[0], jnp.float32), cast(case.shape, jnp.float32)
    single = distance(shape, points)
    assert single.dtype == np.float32
    exact = distance(cast(shape, jnp.float64), points.astype(jnp.float64))
    scale = np.maximum(case.size, np.linalg.norm(points, axis=1))
    assert np.max(np.abs(single - exact) / scale) < 6e-7


def farthest(shape, directions: np.ndarray, reach: float, count: int) -> np.ndarray:
    """The largest range of `count` at which each direction is in view, by brute force; 0 where none is."""
    ranges = np.linspace(0, reach, count + 1)[1:]
    inside = np.asarray(contains(shape, jnp.asarray(ranges[:, None] * directions[..., None, :])))
    return np.where(inside, ranges, 0.0).max(axis=-1)


@pytest.mark.parametrize(
    "name", [name for name in CASES if not name.startswith(("half", "intersection", "frustum flat"))]
)
def test_extent_is_that_of_the_directions_in_view(name):
    """The depth ahead, and the largest bearing and elevation at which anything is in view."""
    shape, d = CASES[name].shape, CASES[name].shape.dimension
    reach = 1.01 * float(shape.depth) if np.isfinite(float(shape.depth)) else 1.01 * float(shape.base.depth)
    ahead_m, half_width, half_height = (float(size) for size in extent(shape))
    np.testing.assert_allclose(ahead_m, farthest(shape, np.eye(d)[0], reach, 1000), atol=2e-3 * reach)
    for half, axis in ((half_width, 1), (half_height, 2))[: d - 1]:
        if name.startswith("prism") and axis == 2:
            continue
        angles = np.linspace(0, np.pi, 181)
        signed = np.concatenate([angles, -angles])[:, None]
        directions = np.cos(signed) * np.eye(d)[0] + np.sin(signed) * np.eye(d)[axis]
        seen = farthest(shape, directions, reach, 400) > 0
        largest = np.abs(signed[seen]).max(initial=0.0)
        assert largest <= half + 1e-6
        assert half - largest < 0.04
