"""Tables of the shortest ways of a body around the obstacles of maps, in numpy and SciPy, made once for every map.

Nodes of a lattice at which the body is free are connected with their neighbours. Some of them, spread over the map, are
anchors: each the one farthest from those before (Gonzalez 1985). A table has the shortest way from every node to each
(Dijkstra).
"""

import math
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from foveate.geometry.distance_grid import Nodes

MOST_NODES = {2: 64, 3: 24}
"""Most nodes of the lattice on an axis, by the dimension of space."""

ANCHORS = 32
"""Anchors of a map."""

SPARE_CELLS = 0.02
"""What a node has more than the distance at which a body is stopped, in cells: rounding."""


class Tables(NamedTuple):
    """Ways on every map, by the number of a node, of which there is one at every `stride`-th node of the grid.

    `nearest` is the free node nearest to each node, `anchor` the anchor nearest to each free node by the length of the
    way; `distance` [m] is that to every anchor, and `after` the next node on the way there.
    """

    nearest: Int[np.ndarray, "maps nodes"]
    anchor: Int[np.ndarray, "maps nodes"]
    distance: Float[np.ndarray, "maps nodes anchors"]
    after: Int[np.ndarray, "maps nodes anchors"]
    stride: int


def tables(nodes: Nodes, least_m: float) -> Tables:
    """The tables of all maps, for a body that is free where the distance is more than `least_m` [m].

    The stride is as small as MOST_NODES allows.
    """
    most, d = max(nodes.distance.shape[1:]) - 1, len(nodes.low)
    stride = max(1, math.ceil(most / MOST_NODES[d]))
    least_m += SPARE_CELLS * nodes.cell_m
    parts = [_tables(each, least_m, stride, nodes.cell_m) for each in nodes.distance]
    nearest, anchor, distance, after = (np.stack(part) for part in zip(*parts, strict=True))
    return Tables(nearest, anchor, distance, after, stride)


def _tables(
    distance: Float[np.ndarray, "*nodes"], least_m: float, stride: int, cell_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """nearest, anchor, distance and after of one map."""
    graph = _graph(distance, least_m, stride, cell_m)
    lattice = distance[(slice(None, None, stride),) * distance.ndim]
    shape, room = lattice.shape, lattice.ravel()
    # Of a robot that can be in one of several parts, and a target in another, nothing good can be said.
    part = connected_components(graph, directed=False)[1]
    usable = part == np.bincount(part, weights=room > least_m).argmax()
    index = np.asarray(distance_transform_edt(~usable.reshape(shape), return_distances=False, return_indices=True))
    nearest = np.ravel_multi_index(tuple(index), shape).ravel()

    own, least = np.arange(len(room)), np.full(len(room), np.inf)
    anchor, lengths, afters = np.zeros(len(room), int), [], []
    place = int(np.where(usable, room, -np.inf).argmax())
    for number in range(ANCHORS):
        length, after = dijkstra(graph, indices=place, return_predecessors=True)
        anchor = np.where(length < least, number, anchor)
        least = np.minimum(least, length)
        lengths.append(length)
        afters.append(np.where(after < 0, own, after))
        place = int(np.where(usable, least, -np.inf).argmax())
    return nearest, anchor, np.stack(lengths, axis=1), np.stack(afters, axis=1)


def _graph(distance: Float[np.ndarray, "*nodes"], least_m: float, stride: int, cell_m: float) -> csr_matrix:
    """Edges between neighbours on the lattice along which the distance is more than `least_m`, with their lengths [m].

    The distance is looked at where an edge meets nodes of the grid, and in the middle of its cells.
    """
    shape = distance[(slice(None, None, stride),) * distance.ndim].shape
    number = np.arange(math.prod(shape)).reshape(shape)
    rows, columns, lengths = [], [], []
    for offset in product((-1, 0, 1), repeat=distance.ndim):
        if not any(offset):
            continue
        begin, end = (
            np.ix_(*(np.arange(max(0, -sign * i), n - max(0, sign * i)) for i, n in zip(offset, shape, strict=True)))
            for sign in (1, -1)
        )
        corners = list(product(*({0, i} for i in offset)))
        room = np.full(number[begin].shape, np.inf)
        for part in range(stride + 1):
            at = [axis * stride + part * i for axis, i in zip(begin, offset, strict=True)]
            room = np.minimum(room, distance[tuple(at)])
            if part < stride:
                cell = [distance[tuple(axis + i for axis, i in zip(at, corner, strict=True))] for corner in corners]
                room = np.minimum(room, np.mean(cell, axis=0))
        is_free = room > least_m
        rows.append(number[begin][is_free])
        columns.append(number[end][is_free])
        lengths.append(np.full(is_free.sum(), stride * cell_m * math.sqrt(sum(map(abs, offset)))))
    edges = np.concatenate(rows), np.concatenate(columns)
    return csr_matrix((np.concatenate(lengths), edges), shape=(number.size, number.size))
