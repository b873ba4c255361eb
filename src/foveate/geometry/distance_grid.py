"""Signed distances to obstacles on a grid, interpolated: of one map, or of several of the same size.

The distance is > 0 outside of obstacles and < 0 inside, and exact at the nodes. Between them it errs by at most
`slack_m`, half the diagonal of a cell, as a distance changes by at most 1 m a metre.
"""

import math
from itertools import product
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.ndimage import distance_transform_edt

from foveate.types import Count, Scalar


class Nodes(NamedTuple):
    """Signed distances [m] at the nodes of `maps` grids, the x axis first; `low` is the position of the first node."""

    distance: Float[np.ndarray, "maps *nodes"]
    low: Float[np.ndarray, " d"]
    cell_m: float

    @property
    def high(self) -> Float[np.ndarray, " d"]:
        """Position of the last node [m]."""
        return self.low + self.cell_m * (np.array(self.distance.shape[1:]) - 1)

    @property
    def slack_m(self) -> float:
        """Largest error of an interpolated distance [m]: half the diagonal of a cell."""
        return 0.5 * math.sqrt(len(self.low)) * self.cell_m

    def positions(self) -> Float[np.ndarray, "*nodes d"]:
        """Positions of the nodes [m]."""
        axes = [low + self.cell_m * np.arange(n) for low, n in zip(self.low, self.distance.shape[1:], strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)

    def freest(self) -> Float[np.ndarray, "maps d"]:
        """The node of each map that is farthest from all obstacles [m]."""
        best = self.distance.reshape(len(self.distance), -1).argmax(axis=1)
        return self.positions().reshape(-1, len(self.low))[best]


class DistanceGrid(eqx.Module):
    """Interpolated signed distances of the map with the number `index`.

    `corners` holds the distances at all corners of every cell of every map, so that one access reads a cell, and
    `least` what the distance in a cell is at least. Positions beyond the grid take the value at its border, which is
    never more than the distance to what is in the grid.
    """

    corners: Float[Array, "entries corners"]
    least: Float[Array, " entries"]
    low: Float[Array, " d"]
    cell: Scalar
    index: Count
    cells: tuple[int, ...] = eqx.field(static=True)
    """Number of cells on each axis."""

    @classmethod
    def of(cls, nodes: Nodes) -> "DistanceGrid":
        """The grid of distances at nodes, at least two on each axis, with the first map chosen."""
        values, d = nodes.distance, len(nodes.low)
        cells = tuple(n - 1 for n in values.shape[1:])
        parts = [
            values[(slice(None), *(slice(i, i + n) for i, n in zip(corner, cells, strict=True)))].ravel()
            for corner in product((0, 1), repeat=d)
        ]
        corners = np.stack(parts, axis=-1)
        # The distance at a place is at least the mean of those at all corners less its mean distance from them, which
        # is largest at a corner.
        away = np.mean([math.dist(corner, (0,) * d) for corner in product((0, 1), repeat=d)])
        return cls(
            corners=jnp.asarray(corners, float),
            least=jnp.asarray(corners.mean(axis=-1) - away * nodes.cell_m, float),
            low=jnp.asarray(nodes.low, float),
            cell=jnp.asarray(nodes.cell_m, float),
            index=jnp.zeros((), int),
            cells=cells,
        )

    def nodes(self) -> Nodes:
        """Distances at the nodes of the chosen map, as numpy arrays."""
        first = int(self.index) * math.prod(self.cells)
        own = np.asarray(self.corners, float)[first : first + math.prod(self.cells)].reshape(*self.cells, -1)
        distance = np.zeros(tuple(n + 1 for n in self.cells))
        for i, corner in enumerate(product((0, 1), repeat=len(self.cells))):
            distance[tuple(slice(at, at + n) for at, n in zip(corner, self.cells, strict=True))] = own[..., i]
        return Nodes(distance[None], np.asarray(self.low, float), float(self.cell))

    @property
    def maps(self) -> int:
        """Number of maps."""
        return len(self.corners) // math.prod(self.cells)

    @property
    def slack(self) -> Scalar:
        """Largest error of an interpolated distance [m]: half the diagonal of a cell."""
        return 0.5 * math.sqrt(len(self.cells)) * self.cell

    def __call__(self, points_world: Float[Array, "*n d"]) -> Float[Array, "*n"]:
        """Signed distances [m] at positions [m], linear in each coordinate within a cell."""
        entry, shares = self._cell_of(points_world)
        found = self.corners.at[entry].get(mode="promise_in_bounds")
        for share in shares:
            half = found.shape[-1] // 2
            found = found[..., :half] + share[..., None] * (found[..., half:] - found[..., :half])
        return found[..., 0]

    def at_least(self, points_world: Float[Array, "*n d"]) -> Float[Array, "*n"]:
        """What the true distances [m] are at least at positions [m]: about a cell less."""
        return self.least.at[self._cell_of(points_world)[0]].get(mode="promise_in_bounds")

    def _cell_of(self, points_world: Float[Array, "*n d"]) -> tuple[Int[Array, "*n"], list[Float[Array, "*n"]]]:
        """Number of the cell of each position, and its place in the cell on each axis, from 0 to 1."""
        entry, shares = self.index, []
        for axis, count in enumerate(self.cells):
            value = jnp.clip((points_world[..., axis] - self.low[axis]) / self.cell, 0.0, float(count))
            # Clipped as a whole number too: positions in padding may be no numbers.
            cell = jnp.clip(value.astype(int), 0, count - 1)
            entry = entry * count + cell
            shares.append(value - cell.astype(value.dtype))
        return entry, shares


def of_cells(occupied: Bool[np.ndarray, "*cells"], low: Float[np.ndarray, " d"], cell_m: float) -> Nodes:
    """Exact signed distances to the union of occupied cells at the middle of each, with all beyond the map occupied.

    The distance transform (SciPy) runs on the corners and middles of all cells: the point of a union of cells that is
    nearest to one of them is one of them too, which makes it exact. `low` is the lowest corner of the map [m].
    """
    padded = np.pad(occupied, 1, constant_values=True)
    taken, free = (np.zeros(np.array(padded.shape) * 2 + 1, bool) for _ in range(2))
    for offset in product((0, 1, 2), repeat=padded.ndim):
        at = tuple(slice(i, i + 2 * n - 1, 2) for i, n in zip(offset, padded.shape, strict=True))
        taken[at] |= padded
        free[at] |= ~padded
    outside = np.asarray(distance_transform_edt(~taken, sampling=0.5 * cell_m))
    # Without a free cell the transform has nothing to measure to.
    inside = np.asarray(distance_transform_edt(~free, sampling=0.5 * cell_m)) if free.any() else cell_m
    middles = (slice(1, None, 2),) * padded.ndim
    return Nodes((outside - inside)[middles][None], np.asarray(low, float) - 0.5 * cell_m, cell_m)
