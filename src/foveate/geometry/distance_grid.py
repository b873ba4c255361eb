"""Signed distances to obstacles on a grid, interpolated: of one map, or of several of the same size.

The distance is > 0 outside of obstacles and < 0 inside, and exact at the nodes. Between them it errs by at most
`slack_m`, half the diagonal of a cell, as a distance changes by at most 1 m a metre.
"""

import math
from collections.abc import Callable
from itertools import product
from operator import mul
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.ndimage import distance_transform_edt

from foveate.types import Count, Scalar

Box = tuple[tuple[float, ...], tuple[float, ...]]
"""Low and high corner [m]."""


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

    def freest(self, box: Box | None = None) -> tuple[Float[np.ndarray, "maps d"], Float[np.ndarray, " maps"]]:
        """The node of each map that is farthest from all obstacles [m], and how far; in a box, or around a tiny one."""
        places, distance = self.positions(), self.distance
        if box is not None:
            low, high = (np.array(corner) + sign * 0.5 * self.cell_m for corner, sign in zip(box, (-1, 1), strict=True))
            inside = ((places >= low) & (places <= high)).all(axis=-1)
            distance = np.where(inside, distance, -np.inf)
        flat = distance.reshape(len(distance), -1)
        return places.reshape(-1, len(self.low))[flat.argmax(axis=1)], flat.max(axis=1)


Places = list[Float[Array, "*n"]]
"""Positions axis by axis, in cells from the first node."""


class DistanceGrid(eqx.Module):
    """Interpolated signed distances of the map with the number `index`.

    `distance` holds the distances at the nodes of all maps, and `least`, at the first node of each cell, what the
    distance in the cell is at least. Positions beyond the grid take the value at its border, which is never more than
    the distance to what is in the grid.
    """

    distance: Float[Array, " entries"]
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
        corners = [
            values[(slice(None), *(slice(i, i + n) for i, n in zip(corner, cells, strict=True)))]
            for corner in product((0, 1), repeat=d)
        ]
        # The distance at a place is at least the mean of those at all corners less its mean distance from them, which
        # is largest at a corner.
        away = np.mean([math.dist(corner, (0,) * d) for corner in product((0, 1), repeat=d)])
        least = np.mean(corners, axis=0) - away * nodes.cell_m
        least = np.pad(least, [(0, 0), *[(0, 1)] * d], mode="edge")  # numbered as the nodes are
        return cls(
            distance=jnp.asarray(values.ravel(), float),
            least=jnp.asarray(least.ravel(), float),
            low=jnp.asarray(nodes.low, float),
            cell=jnp.asarray(nodes.cell_m, float),
            index=jnp.zeros((), int),
            cells=cells,
        )

    def nodes(self) -> Nodes:
        """Distances at the nodes of the chosen map, as numpy arrays."""
        own = np.asarray(self.distance, float).reshape(-1, *self._counts)[int(self.index)]
        return Nodes(own[None], np.asarray(self.low, float), float(self.cell))

    @property
    def maps(self) -> int:
        """Number of maps."""
        return len(self.distance) // math.prod(self._counts)

    @property
    def slack(self) -> Scalar:
        """Largest error of an interpolated distance [m]: half the diagonal of a cell."""
        return 0.5 * math.sqrt(len(self.cells)) * self.cell

    def __call__(self, points_world: Float[Array, "*n d"]) -> Float[Array, "*n"]:
        """Signed distances [m] at positions [m], linear in each coordinate within a cell."""
        return self.at(self._places((points_world - self.low) / self.cell))

    def line(
        self, start_world: Float[Array, " d"], directions_world: Float[Array, "n d"]
    ) -> Callable[[Float[Array, " n"]], Places]:
        """The places on lines from a position [m] in directions of unit length, by how far along they are [m].

        They are given axis by axis, so that no array of points has to be written between two steps along a line.
        """
        first, slopes = self._places((start_world - self.low) / self.cell), self._places(directions_world / self.cell)
        return lambda along: [place + along * slope for place, slope in zip(first, slopes, strict=True)]

    def at(self, places: Places) -> Float[Array, "*n"]:
        """Signed distances [m] at places of a `line`."""
        entry, shares = self._cell_of(places)
        strides = [math.prod(self._counts[axis + 1 :]) for axis in range(len(self.cells))]
        # A number at a time from a table that fits into a cache, not a row of all corners from one 2^d times as large.
        found = [
            self.distance.at[entry + sum(map(mul, corner, strides))].get(mode="promise_in_bounds")
            for corner in product((0, 1), repeat=len(strides))
        ]
        for share in shares:
            half = len(found) // 2
            found = [low + share * (high - low) for low, high in zip(found[:half], found[half:], strict=True)]
        return found[0]

    def at_least(self, places: Places) -> Float[Array, "*n"]:
        """What the true distances [m] are at least at places of a `line`: about a cell less."""
        return self.least.at[self._cell_of(places)[0]].get(mode="promise_in_bounds")

    @property
    def _counts(self) -> tuple[int, ...]:
        """Number of nodes on each axis."""
        return tuple(count + 1 for count in self.cells)

    def _places(self, in_cells: Float[Array, "*n d"]) -> Places:
        return [in_cells[..., axis] for axis in range(len(self.cells))]

    def _cell_of(self, places: Places) -> tuple[Int[Array, "*n"], Places]:
        """Number of the first node of the cell of each place, and the place in the cell on each axis, from 0 to 1."""
        entry, shares = self.index, []
        for value, count in zip(places, self.cells, strict=True):
            inside = jnp.clip(value, 0.0, float(count))
            # Clipped as a whole number too: positions in padding may be no numbers.
            cell = jnp.clip(inside.astype(int), 0, count - 1)
            entry = entry * (count + 1) + cell
            shares.append(inside - cell.astype(inside.dtype))
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
