"""Ways around obstacles: the next place to drive to on the shortest way to a goal, by distances on a lattice."""

import math
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from foveate.geometry import sight
from foveate.geometry.distance_grid import DistanceGrid
from foveate.models.obstacles import Obstacles
from foveate.types import Flag, Point, Scalar

MOST_NODES = {2: 64, 3: 24}
"""Most nodes of the lattice on an axis, by the dimension of space."""

AHEAD = 16
"""Nodes of the way among which the next place is chosen: the farthest that can be reached in a straight line."""

REACH = 2
"""Nodes on each side of a goal, or of the agent, among which the way may end, or begin."""


class Lattice(NamedTuple):
    """Nodes of a lattice, and those where the agent's body is free."""

    nodes_world: Float[Array, "*counts d"]
    free: Bool[Array, "*counts"]
    pitch: Scalar


def lattice(obstacles: Obstacles) -> Lattice:
    """Every k-th node of the grid of distances, with k as small as MOST_NODES allows."""
    grid, d = obstacles.grid, len(obstacles.grid.cells)
    stride = max(1, math.ceil(max(grid.cells) / MOST_NODES[d]))
    axes = [np.arange(0, cells + 1, stride) for cells in grid.cells]
    index = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    nodes = grid.low + grid.cell * jnp.asarray(index, grid.low.dtype)
    return Lattice(nodes, grid(nodes) > sight.margin(grid, obstacles.radius), stride * grid.cell)


def geodesic(where: Lattice, seeds: Float[Array, "*counts"]) -> Float[Array, "*counts"]:
    """Least sum of a seed and the way from there [m], along the lattice and its diagonals; inf where none leads."""
    d, counts = where.free.ndim, where.free.shape
    offsets = [offset for offset in product((-1, 0, 1), repeat=d) if any(offset)]

    def relax(carry):
        distance, _ = carry
        padded = jnp.pad(distance, 1, constant_values=jnp.inf)
        found = distance
        for offset in offsets:
            part = padded[tuple(slice(1 + i, 1 + i + n) for i, n in zip(offset, counts, strict=True))]
            found = jnp.minimum(found, part + where.pitch * math.sqrt(sum(map(abs, offset))))
        found = jnp.where(where.free, found, jnp.inf)
        return found, jnp.any(found < distance)

    return jax.lax.while_loop(lambda carry: carry[1], relax, (seeds, jnp.array(True)))[0]


def next_place(obstacles: Obstacles, start: Point, goal: Point) -> tuple[Point, Flag]:
    """Where to drive to get from a start to a goal [m], and true if that is the goal itself, in a straight line.

    The goal itself, too, where no way leads to it. A straight line is one that the agent's body can go.
    """
    grid = obstacles.grid

    def clear(end: Point) -> Flag:
        return ~sight.share_free(grid, _line, (start, end), jnp.linalg.norm(end - start), obstacles.radius)[1]

    # A target may be nearer to a wall than the agent's body can be: seen from there, the goal is reached.
    straight = clear(goal)
    where = lattice(obstacles)
    distance = geodesic(where, _spread(where, *_around(grid, where, goal)))
    begin, cost = _around(grid, where, start)
    cost = cost + distance[tuple(begin.T)]
    here, exists = begin[jnp.argmin(cost)], jnp.isfinite(jnp.min(cost))
    path = _descend(distance, here)
    places = where.nodes_world[tuple(path.T)]
    # The first place always counts: something must be tried where the body is too near to a wall.
    reachable = jax.vmap(clear)(places).at[0].set(True)
    last = jnp.max(jnp.where(reachable, jnp.arange(AHEAD), 0))
    direct = straight | ~exists
    return jnp.where(direct, goal, places[last]), direct


def _line(ends: tuple[Point, Point], share: Scalar) -> Point:
    return ends[0] + share * (ends[1] - ends[0])


def _around(grid: DistanceGrid, where: Lattice, place: Point) -> tuple[Int[Array, "window d"], Float[Array, " window"]]:
    """Nodes around a place, and their distances from it [m]: inf where they are not free or not in sight of it."""
    counts = jnp.array(where.free.shape)
    middle = jnp.round((place - grid.low) / where.pitch).astype(int)
    offsets = jnp.array(list(product(range(-REACH, REACH + 1), repeat=len(place))))
    index = jnp.clip(middle + offsets, 0, counts - 1)
    nodes = where.nodes_world[tuple(index.T)]
    seen = sight.sees(grid, place, nodes, where.free[tuple(index.T)])
    return index, jnp.where(seen, jnp.linalg.norm(nodes - place, axis=-1), jnp.inf)


def _spread(where: Lattice, index: Int[Array, "window d"], values: Float[Array, " window"]) -> Float[Array, "*counts"]:
    """The values at their nodes, inf elsewhere."""
    empty = jnp.full(where.free.shape, jnp.inf, values.dtype)
    return empty.at[tuple(index.T)].min(values)


def _descend(distance: Float[Array, "*counts"], here: Int[Array, " d"]) -> Int[Array, "ahead d"]:
    """Nodes of the way down from a node, which ends at the least."""
    offsets = jnp.array(list(product((-1, 0, 1), repeat=len(here))))
    last = jnp.array(distance.shape) - 1

    def step(node, _):
        near = jnp.clip(node + offsets, 0, last)
        after = near[jnp.argmin(distance[tuple(near.T)])]
        return after, node

    return jax.lax.scan(step, here, None, AHEAD)[1]
