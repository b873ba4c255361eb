"""Signed distances of shapes against shapely, and their extrusions against the nearest of many points on the border."""

import numpy as np
import pytest
import shapely

from foveate.geometry.shapes import Shape, is_convex, rectangle, union_distance

HEXAGON = np.stack([np.cos(t := np.arange(6) * np.pi / 3), np.sin(t)], axis=-1) * [2.0, 1.0] + [0.5, -0.3]
SLANTED = np.array([[0.0, 0.0], [3.0, 1.0], [2.0, 2.5]])


def shapely_distance(polygon: shapely.Geometry, points: np.ndarray) -> np.ndarray:
    where = shapely.points(points)
    distance = shapely.distance(polygon.boundary, where)
    return np.where(shapely.contains(polygon, where), -distance, distance)


@pytest.mark.parametrize("corners", [HEXAGON, SLANTED, rectangle((-1.0, 0.0), (2.0, 0.5)).corners])
def test_distances_to_polygons_are_shapelys(corners):
    points = np.random.default_rng(0).uniform(-4.0, 5.0, (500, 2))
    expected = shapely_distance(shapely.Polygon(corners), points)
    np.testing.assert_allclose(Shape(corners).signed_distance(points), expected, atol=1e-12)


def test_a_circle_is_a_grown_point():
    points = np.random.default_rng(1).uniform(-3.0, 3.0, (200, 2))
    circle = Shape(np.array([[0.5, 1.0]]), 0.8)
    np.testing.assert_allclose(circle.signed_distance(points), np.hypot(*(points - [0.5, 1.0]).T) - 0.8)


def test_the_distance_to_a_union_is_exact_outside_and_limited():
    shapes = [Shape(HEXAGON), Shape(SLANTED), Shape(np.array([[-2.0, 2.0]]), 0.7)]
    points = np.random.default_rng(2).uniform(-6.0, 6.0, (500, 2))
    union = shapely.union_all(
        [shapely.Polygon(HEXAGON), shapely.Polygon(SLANTED), shapely.Point(-2, 2).buffer(0.7, 256)]
    )
    expected, found = shapely_distance(union, points), union_distance(shapes, points, 3.0)
    outside = expected > 0
    np.testing.assert_allclose(found[outside], np.minimum(expected, 3.0)[outside], atol=1e-4)
    assert (found[~outside] < 0).all()


def test_an_extruded_shape_is_as_far_as_its_border():
    """The border: its side at all heights, its bottom and its top, sampled."""
    prism = Shape(HEXAGON, 0.0, 0.5, 2.0)
    rng = np.random.default_rng(3)
    polygon = shapely.Polygon(HEXAGON)
    ring = np.array(
        [p.coords[0] for p in shapely.line_interpolate_point(polygon.boundary, np.linspace(0, 1, 400), normalized=True)]
    )
    side = np.concatenate([np.column_stack([ring, np.full(len(ring), z)]) for z in np.linspace(0.5, 2.0, 60)])
    fill = rng.uniform([-2, -1.5], [3, 1], (20000, 2))
    fill = fill[shapely.contains(polygon, shapely.points(fill))]
    caps = [np.column_stack([fill, np.full(len(fill), z)]) for z in (0.5, 2.0)]
    border = np.concatenate([side, *caps])
    points = rng.uniform([-3, -3, -1], [4, 3, 3.5], (200, 3))
    nearest = np.array([np.linalg.norm(border - point, axis=1).min() for point in points])
    inside = shapely.contains(polygon, shapely.points(points[:, :2])) & (points[:, 2] > 0.5) & (points[:, 2] < 2.0)
    found = prism.signed_distance(points)
    assert inside.any()
    np.testing.assert_array_equal(found < 0, inside)
    np.testing.assert_allclose(np.abs(found), nearest, atol=0.03)


def test_thickness_and_bounds():
    assert rectangle((0.0, 0.0), (3.0, 0.4)).thickness == pytest.approx(0.4)
    assert Shape(np.array([[1.0, 1.0]]), 0.3).thickness == pytest.approx(0.6)
    assert rectangle((0.0, 0.0, 0.0), (3.0, 2.0, 0.1)).thickness == pytest.approx(0.1)
    # The height of an equilateral triangle of side 2 is the square root of 3.
    assert Shape(np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 3**0.5]])).thickness == pytest.approx(3**0.5)
    low, high = Shape(SLANTED, 0.5, 1.0, 2.0).bounds
    assert low.tolist() == [-0.5, -0.5, 1.0]
    assert high.tolist() == [3.5, 3.0, 2.0]


def test_only_convex_counterclockwise_polygons_are_taken():
    assert is_convex(HEXAGON.tolist())
    star = [[np.cos(t), np.sin(t)] for t in np.arange(5) * 4 * np.pi / 5]
    wrong = (HEXAGON[::-1], HEXAGON[:2], star, [[0, 0], [2, 0], [1, 0.2], [1, 2]], [[0, 0], [1, 0], [2, 0], [1, 1]])
    assert not any(is_convex(np.array(each, float).tolist()) for each in wrong)
