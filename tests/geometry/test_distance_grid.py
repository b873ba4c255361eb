"""Interpolated distances against shapely and brute force; the distance transform of cells is exact."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from foveate.geometry.distance_grid import DistanceGrid, Nodes, of_cells
from foveate.geometry.shapes import Shape, rectangle, union_distance

CELL_M = 0.25
SHAPES = [Shape(np.array([[0.0, 0.0], [2.0, 0.5], [1.5, 2.0]])), rectangle((-3.0, -2.0), (-1.0, 1.3))]


def grid_of(shapes, low, high, cell_m=CELL_M) -> DistanceGrid:
    counts = np.ceil((np.array(high) - low) / cell_m).astype(int) + 1
    nodes = Nodes(np.zeros((1, *counts)), np.array(low, float), cell_m)
    distance = union_distance(shapes, nodes.positions().reshape(-1, len(low)), 100.0)
    return DistanceGrid.of(nodes._replace(distance=distance.reshape(1, *counts)))


@pytest.mark.parametrize("precision", [jnp.float32, jnp.float64])
def test_the_distance_to_polygons_is_within_half_a_cell(precision):
    points = np.random.default_rng(0).uniform(-4.0, 4.0, (20_000, 2))
    grid = grid_of(SHAPES, (-5.0, -5.0), (5.0, 5.0))
    grid = jax.tree.map(lambda x: x.astype(precision) if x.dtype == jnp.float64 else x, grid)
    found = np.asarray(grid(jnp.asarray(points, precision)))
    union = shapely.union_all([shapely.Polygon(shape.corners) for shape in SHAPES])
    where = shapely.points(points)
    distance = shapely.distance(union.boundary, where)
    expected = np.where(shapely.contains(union, where), -distance, distance)
    assert np.abs(found - expected).max() <= 0.5 * CELL_M
    assert float(grid.slack) == pytest.approx(0.5 * np.sqrt(2) * CELL_M)


def test_cells_are_as_far_as_the_nearest_square():
    rng = np.random.default_rng(1)
    occupied = rng.random((9, 7)) < 0.25
    nodes = of_cells(occupied, np.array([1.0, -2.0]), 0.5)
    padded = np.pad(occupied, 1, constant_values=True)
    i, j = np.meshgrid(np.arange(-1, 10), np.arange(-1, 8), indexing="ij")
    squares = np.stack([i, j], axis=-1) * 0.5 + [1.0, -2.0]

    def to_squares(points, which):
        gap = np.maximum(np.abs(points[..., None, :] - (squares[which] + 0.25)) - 0.25, 0.0)
        return np.linalg.norm(gap, axis=-1).min(axis=-1)

    points = nodes.positions()
    expected = to_squares(points, padded) - to_squares(points, ~padded)
    np.testing.assert_allclose(nodes.distance[0], expected, atol=1e-9)
    assert (nodes.distance[0, 1:-1, 1:-1] < 0).tolist() == occupied.tolist()


def test_a_map_without_a_free_cell_is_all_inside():
    assert (of_cells(np.ones((3, 4), bool), np.zeros(2), 0.1).distance < 0).all()


def test_space_is_interpolated_along_each_axis():
    """A function that is linear in each coordinate is its own interpolation."""
    counts, low = (4, 3, 5), np.array([-1.0, 0.0, 2.0])
    x, y, z = np.moveaxis(Nodes(np.zeros((1, *counts)), low, 0.5).positions(), -1, 0)

    def values(x, y, z):
        return 1.0 + 2.0 * x - y + 0.5 * z + x * y * z - 3.0 * y * z

    grid = DistanceGrid.of(Nodes(np.stack([values(x, y, z), -values(x, y, z)]), low, 0.5))
    points = np.random.default_rng(2).uniform([-1.0, 0.0, 2.0], [0.5, 1.0, 4.0], (50, 3))
    np.testing.assert_allclose(grid(jnp.asarray(points)), values(*points.T), atol=1e-9)
    second = replace(grid, index=jnp.ones((), int))
    np.testing.assert_allclose(second(jnp.asarray(points)), -values(*points.T), atol=1e-9)
    assert grid.maps == 2
    np.testing.assert_array_equal(second.nodes().distance[0], -values(x, y, z))
    np.testing.assert_array_equal(second.nodes().positions(), Nodes(np.zeros((1, *counts)), low, 0.5).positions())


def test_beyond_the_grid_the_distance_is_that_at_its_border_and_never_too_long():
    grid = grid_of(SHAPES, (-5.0, -5.0), (5.0, 5.0))
    points = np.random.default_rng(3).uniform(-20.0, 20.0, (500, 2))
    found = np.asarray(grid(jnp.asarray(points)))
    np.testing.assert_allclose(found, grid(jnp.clip(jnp.asarray(points), -5.0, 5.0)))
    union = shapely.union_all([shapely.Polygon(shape.corners) for shape in SHAPES])
    assert (found <= shapely.distance(union, shapely.points(points)) + float(grid.slack)).all()


@pytest.mark.parametrize("d", [2, 3])
def test_the_least_distance_of_a_cell_is_one(d):
    """Of thin shapes, too, which the nodes hardly know."""
    rng = np.random.default_rng(4)
    needle = rectangle((-0.02,) * d, (3.0, 0.02, 0.02)[:d])
    grid, points = grid_of([needle], (-3.0,) * d, (4.0,) * d), rng.uniform(-3.0, 4.0, (20_000, d))
    line = grid.line(jnp.zeros(d), jnp.asarray(points))  # each a metre along a line of its own
    found, expected = np.asarray(grid.at_least(line(jnp.ones(len(points))))), needle.signed_distance(points)
    np.testing.assert_allclose(grid.at(line(jnp.ones(len(points)))), grid(jnp.asarray(points)), atol=1e-9)
    assert (found <= expected + 1e-9).all()
    assert (expected - found).mean() < 1.3 * CELL_M


def test_no_number_stays_no_number_and_reads_nothing_else():
    grid = grid_of(SHAPES, (-5.0, -5.0), (5.0, 5.0))
    found = np.asarray(grid(jnp.array([[jnp.nan, 0.0], [jnp.inf, 0.0], [0.0, 0.0]])))
    assert np.isnan(found[0])
    assert np.isfinite(found[1:]).all()


def test_the_freest_node_is_farthest_from_all_obstacles():
    nodes = of_cells(np.pad(np.zeros((5, 5), bool), 1, constant_values=True), np.zeros(2), 1.0)
    np.testing.assert_allclose(nodes.freest()[0], [[3.5, 3.5]])
