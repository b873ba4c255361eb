"""Lines of sight, ranges and ways against shapely's exact segments, and their derivatives by finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from foveate.geometry import sight
from foveate.geometry.distance_grid import DistanceGrid, Nodes
from foveate.geometry.shapes import Shape, rectangle, union_distance
from foveate.geometry.ways import Ways
from foveate.models.obstacles import Obstacles
from foveate.models.sensor import Softness

CELL_M = 0.1
THIN = rectangle((1.0, -3.0), (1.1, 2.0))
"""A wall one cell thick."""


def polygon_of(shape: Shape) -> shapely.Geometry:
    if len(shape.corners) == 1:
        return shapely.Point(shape.corners[0]).buffer(shape.radius, 128)
    return shapely.Polygon(shape.corners)


def random_shapes(rng: np.random.Generator) -> list[Shape]:
    shapes = [THIN]
    for _ in range(10):
        centre, angles = rng.uniform(-5, 5, 2), np.sort(rng.uniform(0, 2 * np.pi, 5))
        hull = shapely.convex_hull(
            shapely.multipoints(centre + rng.uniform(0.4, 1.2) * np.stack([np.cos(angles), np.sin(angles)], 1))
        )
        shape = Shape(np.array(hull.normalize().reverse().exterior.coords)[:-1])
        if shape.thickness >= CELL_M:
            shapes.append(shape)
    return shapes + [Shape(rng.uniform(-5, 5, (1, 2)), float(rng.uniform(0.2, 0.8))) for _ in range(6)]


def grid_of(shapes, half=7.0, cell_m=CELL_M, d=2) -> DistanceGrid:
    count = round(2 * half / cell_m) + 1
    nodes = Nodes(np.zeros((1, *[count] * d)), np.full(d, -half), cell_m)
    distance = union_distance(shapes, nodes.positions().reshape(-1, d), 100.0)
    return DistanceGrid.of(nodes._replace(distance=distance.reshape(1, *[count] * d)))


SHAPES = random_shapes(np.random.default_rng(0))
UNION = shapely.union_all([polygon_of(shape) for shape in SHAPES])
GRID = grid_of(SHAPES)
sees, ranges = jax.jit(sight.sees), jax.jit(sight.ranges)


def free_points(rng, count, room=0.12):
    points = rng.uniform(-6.0, 6.0, (6 * count, 2))
    return points[shapely.distance(UNION, shapely.points(points)) > room][:count]


@pytest.mark.exhaustive
@pytest.mark.slow
def test_lines_of_sight_are_those_of_rays():
    """20,000 pairs: no wrong answer where the line passes, or cuts into, an obstacle by more than a cell."""
    rng = np.random.default_rng(1)
    eyes = free_points(rng, 100)
    ends = free_points(rng, 20_000).reshape(100, 200, 2)
    found = jax.jit(jax.vmap(sight.sees, (None, 0, 0, None)))(
        GRID, jnp.asarray(eyes), jnp.asarray(ends), jnp.ones(200, bool)
    )
    lines = shapely.linestrings(np.stack(np.broadcast_arrays(eyes[:, None], ends), axis=-2))
    clear = shapely.distance(UNION, lines)
    inner = shapely.union_all([shapely.buffer(polygon_of(shape), -0.25 * shape.thickness) for shape in SHAPES])
    deep = np.minimum(shapely.length(shapely.intersection(UNION, lines)) / 2, 1.0) > CELL_M
    crosses = shapely.intersects(inner, lines) | deep
    assert 0.2 < crosses.mean() < 0.9
    assert not np.asarray(found)[crosses].any()
    assert np.asarray(found)[clear > CELL_M].all()
    assert (np.asarray(found) != (clear > 0)).mean() < 0.02


def test_nothing_is_seen_through_a_wall_of_one_cell():
    rng = np.random.default_rng(2)
    wall = grid_of([THIN])
    eyes, ends = rng.uniform([-4, -2.5], [0.8, 1.5], (2000, 2)), rng.uniform([1.3, -2.5], [6, 1.5], (2000, 2))
    lines = shapely.linestrings(np.stack([eyes, ends], axis=1))
    through = shapely.intersects(shapely.LineString([(1.05, -2.9), (1.05, 1.9)]), lines)
    one = jax.vmap(lambda eye, end: sight.sees(wall, eye, end[None], jnp.ones(1, bool))[0])
    assert not np.asarray(jax.jit(one)(jnp.asarray(eyes), jnp.asarray(ends)))[through].any()


def test_who_is_not_asked_for_is_not_seen():
    ends = jnp.zeros((3, 2)) + jnp.array([6.5, 6.5])
    asked = jnp.array([True, False, True])
    assert sees(grid_of([THIN]), jnp.array([6.4, 6.4]), ends, asked).tolist() == asked.tolist()


def test_ranges_end_at_the_first_obstacle():
    rng = np.random.default_rng(3)
    eyes, fan = free_points(rng, 100), sight.fan(32, 2)
    found = np.asarray(jax.vmap(lambda eye: ranges(GRID, eye, jnp.asarray(fan), 6.0))(jnp.asarray(eyes)))
    rays = shapely.linestrings(np.stack(np.broadcast_arrays(eyes[:, None], eyes[:, None] + 6.0 * fan), axis=-2))
    hits = shapely.intersection(UNION, rays)
    expected = np.where(shapely.is_empty(hits), 6.0, shapely.distance(hits, shapely.points(eyes)[:, None]))
    error = found - expected
    assert error.max() < 1e-9
    assert (error > -4 * CELL_M).mean() > 0.7


def test_a_fan_is_spread_evenly():
    flat, round_ = sight.fan(8, 2), sight.fan(200, 3)
    np.testing.assert_allclose(flat[0], [1.0, 0.0])
    np.testing.assert_allclose(np.linalg.norm(round_, axis=1), 1.0)
    np.testing.assert_allclose(round_[0], [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(flat.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(round_.T @ round_ / 200, np.eye(3) / 3, atol=0.01)


def obstacles_of(grid: DistanceGrid, samples: int = 200) -> Obstacles:
    one, none = jnp.zeros((1, 1), int), jnp.zeros((1, 1, 1))  # a lattice of one node: no way is asked for
    ways = Ways(one, one, none, none.astype(int), jnp.zeros(2), jnp.asarray(1.0), counts=(1, 1))
    return Obstacles(grid, jnp.asarray(0.2), jnp.zeros((1, 2)), ways, training=1, samples=samples)


def test_the_soft_weight_becomes_the_hard_one():
    rng = np.random.default_rng(4)
    eyes, ends = free_points(rng, 400), free_points(rng, 400)
    soft = jax.jit(jax.vmap(lambda eye, end: obstacles_of(GRID).weight(eye, end[None], Softness(2.0, 1e-4))[0]))
    hard = jax.jit(jax.vmap(lambda eye, end: sight.sees(GRID, eye, end[None], jnp.ones(1, bool))[0]))
    weight, seen = (np.asarray(f(jnp.asarray(eyes), jnp.asarray(ends))) for f in (soft, hard))
    least = jax.vmap(lambda eye, end: sight.least_distance(GRID, eye, end[None], 200)[0])(
        jnp.asarray(eyes), jnp.asarray(ends)
    )
    decided = np.abs(np.asarray(least)) > 0.25 * CELL_M
    assert decided.mean() > 0.9
    np.testing.assert_allclose(weight[decided], seen[decided], atol=1e-6)


def test_the_soft_weight_falls_as_a_wall_comes_into_the_line():
    """The end of a wall moves across the line of sight, and the weight only falls."""
    weights = []
    for top in np.linspace(-1.5, 1.5, 11):
        wall = grid_of([rectangle((-0.5, -4.0), (0.5, top))])
        weights.append(
            float(obstacles_of(wall).weight(jnp.array([-3.0, 0.0]), jnp.array([[3.0, 0.0]]), Softness(2.0, 0.4))[0])
        )
    assert (np.diff(weights) <= 1e-9).all()
    assert weights[0] > 0.99
    assert weights[-1] < 0.15


@pytest.mark.slow
def test_the_derivative_of_the_soft_weight_is_that_of_finite_differences():
    rng, step = np.random.default_rng(5), 1e-6
    eyes, ends = free_points(rng, 60), free_points(rng, 60)

    @jax.jit
    def weight(pair):
        return obstacles_of(GRID).weight(pair[:2], pair[None, 2:], Softness(2.0, 0.4))[0]

    checked = 0
    for pair in np.concatenate([eyes, ends], axis=1):
        slope = np.asarray(jax.grad(weight)(jnp.asarray(pair)))
        ahead, back = (np.array([weight(jnp.asarray(pair + s * step * e)) for e in np.eye(4)]) for s in (1, -1))
        here = float(weight(jnp.asarray(pair)))
        right, left = (ahead - here) / step, (here - back) / step
        smooth = np.abs(right - left) < 1e-3  # the interpolation has kinks at the borders of cells
        np.testing.assert_allclose(slope[smooth], (0.5 * (right + left))[smooth], atol=2e-3)
        checked += smooth.sum()
    assert checked > 150


def straight(ends, share):
    return ends[0] + share * (ends[1] - ends[0])


def go(grid, start, end, radius):
    start, end = jnp.asarray(start), jnp.asarray(end)
    return sight.share_free(grid, straight, (start, end), jnp.linalg.norm(end - start), jnp.asarray(radius))


def test_a_way_ends_before_the_first_obstacle():
    """Never nearer than the radius, and no farther from it than the margin of a cell or so."""
    rng, radius = np.random.default_rng(6), 0.15
    margin = float(sight.margin(GRID, jnp.asarray(radius)))
    starts, ends = free_points(rng, 1000, room=margin + CELL_M), rng.uniform(-9.0, 9.0, (1000, 2))
    share, touches = jax.jit(jax.vmap(lambda a, b: go(GRID, a, b, radius)))(jnp.asarray(starts), jnp.asarray(ends))
    share, touches = np.asarray(share), np.asarray(touches)
    stops = starts + share[:, None] * (ends - starts)
    gone = shapely.linestrings(np.stack([starts, stops], axis=1))
    assert shapely.distance(UNION, gone).min() >= radius
    assert ((share < 1) == touches).all()
    assert 0.3 < touches.mean() < 0.95
    assert shapely.distance(UNION, shapely.points(stops[touches])).max() < margin + 0.75 * CELL_M
    whole = shapely.linestrings(np.stack([starts, ends], axis=1))
    assert not touches[shapely.distance(UNION, whole) > margin + 0.75 * CELL_M].any()


def test_a_body_at_a_wall_may_leave_it_and_not_enter():
    wall = grid_of([rectangle((0.0, -5.0), (2.0, 5.0))])
    share, _ = go(wall, [-3.0, 0.0], [1.0, 0.0], 0.2)
    there = np.array([-3.0 + 4.0 * float(share), 0.0])
    again, touches = go(wall, there, there + np.array([1.0, 0.0]), 0.2)
    assert bool(touches)
    assert float(again) < 0.01
    for way in ([-1.0, 0.0], [0.0, 1.0], [0.0, 0.0]):
        share, touches = go(wall, there, there + np.array(way), 0.2)
        assert (float(share), bool(touches)) == (1.0, False)


@pytest.mark.slow
def test_the_derivative_of_a_contact_is_that_of_finite_differences():
    """On a slanted wall: how far the body gets when it aims elsewhere."""
    wall = grid_of([Shape(np.array([[0.0, -6.0], [6.5, -6.0], [6.5, 6.0], [2.0, 6.0]]))])

    def place(end):
        start = jnp.array([-3.0, -0.5])
        share, _ = sight.share_free(wall, straight, (start, end), jnp.linalg.norm(end - start), jnp.asarray(0.2))
        return start + share * (end - start)

    end, step = jnp.array([4.0, 1.0]), 0.4
    found = jax.jacobian(place)(end)
    # The contact itself is known to 1/64 of a step only: over a long step that hardly counts.
    columns = [(place(end + step * e) - place(end - step * e)) / (2 * step) for e in jnp.eye(2)]
    np.testing.assert_allclose(found, np.stack(columns, axis=1), atol=0.03)
