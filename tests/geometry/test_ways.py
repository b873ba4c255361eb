"""Ways around obstacles: lengths are those of shapely's visibility graph, and whoever follows them arrives."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from foveate.geometry import sight
from foveate.geometry.distance_grid import DistanceGrid
from foveate.geometry.shapes import rectangle
from foveate.geometry.way_tables import tables
from foveate.geometry.ways import Ways
from foveate.scenario.obstacle_grids import shape_nodes

RADIUS = jnp.array(0.2)
SHAPES = [rectangle((0.0, -4.0), (0.5, 3.0)), rectangle((-4.0, 2.5), (0.5, 3.0)), rectangle((2.5, -1.0), (5.0, -0.5))]
NODES = shape_nodes([SHAPES], ((-5.0, -5.0), (5.0, 5.0)), 0.2)
GRID = DistanceGrid.of(NODES)
LEAST = float(sight.margin(GRID, RADIUS))


@pytest.fixture(scope="module")
def ways():
    return Ways.of(tables(NODES, LEAST), NODES)


def places(count: int, seed: int) -> np.ndarray:
    """Random places at which the body is free."""
    found = np.random.default_rng(seed).uniform(-5.0, 5.0, (4 * count, 2))
    return found[np.asarray(GRID(jnp.asarray(found))) > LEAST + 0.05][:count]


def shortest(starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Lengths of the shortest ways of a ball of the radius LEAST, along corners of the grown obstacles."""
    grown = shapely.union_all([shapely.Polygon(shape.corners).buffer(LEAST, 4) for shape in SHAPES])
    corners = [np.array(part.exterior.coords)[:-1] for part in shapely.get_parts(grown)]
    nodes = np.concatenate([starts, ends, *corners])
    pairs = np.array(list(itertools.combinations(range(len(nodes)), 2)))
    lines = shapely.linestrings(nodes[pairs])
    pairs = pairs[~shapely.intersects(grown.buffer(-1e-6), lines)]
    length = np.linalg.norm(nodes[pairs[:, 0]] - nodes[pairs[:, 1]], axis=1)
    graph = csr_matrix((length, (pairs[:, 0], pairs[:, 1])), (len(nodes), len(nodes)))
    count = len(starts)
    return dijkstra(graph, directed=False, indices=range(count))[range(count), range(count, 2 * count)]


def test_lengths_are_those_of_the_visibility_graph(ways):
    starts, ends = places(20, 0), places(20, 1)
    ask = jax.jit(lambda start, end: ways.to(GRID, RADIUS, start, end[None], 0.0))
    found = [ask(jnp.asarray(a), jnp.asarray(b)) for a, b in zip(starts, ends, strict=True)]
    expected = shortest(starts, ends)
    length = np.array([float(way.length[0]) for way in found])
    # A lattice has eight directions, which costs up to 8 %; and a way bends at a node.
    assert (length > expected - 0.02).all()
    assert (length < 1.1 * expected + 0.8).all(), (length, expected)
    straight = np.array([bool(way.is_straight[0]) for way in found])
    assert 0 < straight.sum() < len(straight)
    np.testing.assert_allclose(length[straight], np.linalg.norm(ends - starts, axis=1)[straight], rtol=1e-6)


def test_the_body_arrives_by_straight_lines(ways):
    starts, ends = jnp.asarray(places(60, 2)), jnp.asarray(places(60, 3))

    def follow(start, end):
        def go(place, _):
            way = ways.to(GRID, RADIUS, place, end[None], 0.0)
            after = way.place_world[0]
            # A body that is beside a corner first gets away from it; else it can go all of each line.
            touches = ~sight.passes(GRID, place, after[None], RADIUS)[0]
            return after, touches

        return jax.lax.scan(go, start, None, 12)

    last, touches = jax.jit(jax.vmap(follow))(starts, ends)
    np.testing.assert_allclose(last, ends, atol=1e-5)
    assert not np.asarray(touches).any()


def test_an_end_in_a_wall_or_beyond_the_map_leads_to_the_nearest_place(ways):
    ends = jnp.array([[0.25, -2.0], [9.0, 0.0]])
    way = jax.jit(lambda: ways.to(GRID, RADIUS, jnp.array([-3.0, -2.0]), ends, 0.0))()
    assert not np.asarray(way.is_straight).any()
    assert np.isfinite(np.asarray(way.length)).all()
    reached = np.asarray(ways.free_places(GRID, ends))
    assert (np.asarray(GRID(jnp.asarray(reached))) > LEAST).all()
    assert np.linalg.norm(reached[0] - ends[0]) < 1.0
    # Around the wall's lower end, or its upper one: not through it.
    assert float(way.length[1]) > 13.0


def test_parts_of_a_map_that_are_shut_off_are_no_ends():
    box = [(-2.0, -2.0, 2.0, -1.5), (-2.0, 1.5, 2.0, 2.0), (-2.0, -2.0, -1.5, 2.0), (1.5, -2.0, 2.0, 2.0)]
    nodes = shape_nodes([[rectangle(each[:2], each[2:]) for each in box]], ((-5.0, -5.0), (5.0, 5.0)), 0.2)
    grid = DistanceGrid.of(nodes)
    found = np.asarray(Ways.of(tables(nodes, LEAST), nodes).free_places(grid, jnp.array([[0.0, 0.0]])))
    assert np.abs(found).max() > 2.0
