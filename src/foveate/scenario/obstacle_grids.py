"""Grids of signed distances for the obstacles of a scenario."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from foveate.geometry.distance_grid import Box, Nodes, of_cells
from foveate.geometry.shapes import Shape, union_distance
from foveate.geometry.way_tables import Tables, tables
from foveate.geometry.ways import Ways
from foveate.io.occupancy import OccupancyGrid
from foveate.io.validate import require

MAX_NODES = 1 << 24
"""Most nodes of all maps together: a quarter of a gigabyte in the plane, half of one in space."""
PAD_M = 1.0
"""Width of the border that a grid has around shapes and starts, beyond which distances do not grow."""


def shape_nodes(maps: Sequence[Sequence[Shape]], box: Box, cell_m: float) -> Nodes:
    """Exact signed distances to the shapes of each map, on a grid that holds the box and a border around it.

    Raises InputError for more than MAX_NODES nodes.
    """
    low, high = np.array(box[0]) - PAD_M, np.array(box[1]) + PAD_M
    counts = np.maximum(2, np.ceil((high - low) / cell_m).astype(int) + 1)
    total = len(maps) * int(np.prod(counts.astype(float)))
    right = f"expected a larger cell, or fewer maps: all maps together have {total} nodes, at most {MAX_NODES}"
    require(total <= MAX_NODES, "resolution_m", cell_m, right)
    nodes = Nodes(np.zeros((1, *counts)), low, cell_m)
    points, most = nodes.positions().reshape(-1, len(low)), float(np.linalg.norm(high - low))
    distance = np.stack([union_distance(shapes, points, most).astype(np.float32) for shapes in maps])
    return nodes._replace(distance=distance.reshape(len(maps), *counts))


def map_nodes(grid: OccupancyGrid) -> Nodes:
    """Signed distances to the occupied cells of a robot's map."""
    return _cell_nodes(grid.occupied.tobytes(), grid.occupied.shape, tuple(grid.low.tolist()), grid.cell_m)


@lru_cache(maxsize=4)
def _cell_nodes(occupied: bytes, shape: tuple[int, int], low: tuple[float, ...], cell_m: float) -> Nodes:
    """Signed distances to the occupied cells of a map, given as bytes so that equal maps are computed once."""
    return of_cells(np.frombuffer(occupied, bool).reshape(shape), np.array(low), cell_m)


def occupied_cells(nodes: Nodes) -> OccupancyGrid:
    """The first map of the plane as cells about its nodes, each occupied if its node is: the inverse of `map_nodes`."""
    return OccupancyGrid(nodes.distance[0] <= 0, nodes.low - 0.5 * nodes.cell_m, nodes.cell_m)


def extruded(nodes: Nodes, heights_m: tuple[float, float], box: Box) -> Nodes:
    """Signed distances to obstacles of the plane that stand between two heights [m]."""
    low, high = min(heights_m[0], box[0][2]) - PAD_M, max(heights_m[1], box[1][2]) + PAD_M
    count = int(np.ceil((high - low) / nodes.cell_m)) + 1
    total = nodes.distance.size * count
    right = f"expected a coarser map: with its heights it has {total} nodes, at most {MAX_NODES}"
    require(total <= MAX_NODES, "resolution", nodes.cell_m, right)
    z = low + nodes.cell_m * np.arange(count)
    above = np.abs(z - np.mean(heights_m)) - 0.5 * (heights_m[1] - heights_m[0])
    flat = nodes.distance[..., None]
    outside = np.hypot(np.maximum(flat, 0.0), np.maximum(above, 0.0))
    return Nodes(outside + np.minimum(np.maximum(flat, above), 0.0), np.append(nodes.low, low), nodes.cell_m)


def ways_among(nodes: Nodes, least_m: float) -> Ways:
    """The ways of a body that keeps `least_m` [m] from obstacles; equal maps are computed once."""
    distance = nodes.distance.astype(np.float32)
    tables = _ways(distance.tobytes(), distance.shape, tuple(nodes.low.tolist()), nodes.cell_m, least_m)
    return Ways.of(tables, nodes)


@lru_cache(maxsize=4)
def _ways(distance: bytes, shape: tuple[int, ...], low: tuple[float, ...], cell_m: float, least_m: float) -> Tables:
    values = np.frombuffer(distance, np.float32).reshape(shape)
    return tables(Nodes(values, np.array(low), cell_m), least_m)
