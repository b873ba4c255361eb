"""Grid of the intensity of undetected targets: expected number of targets in each cell of a box."""

from collections.abc import Sequence
from functools import reduce

import equinox as eqx
import jax.numpy as jnp
from jax.scipy.special import ndtr
from jaxtyping import Array, Float

from foveate.types import Point, Scalar


class Grid(eqx.Module):
    """Cells of equal size in a box from `low` to `high` [m]; `shape` has their number along each axis.

    Beyond the border nothing is represented: what would be there counts in the border's cells, so that the expected
    number of targets is kept.
    """

    low: Point
    high: Point
    shape: tuple[int, ...] = eqx.field(static=True)

    @property
    def size(self) -> Point:
        """Size of a cell [m]."""
        return (self.high - self.low) / jnp.array(self.shape, self.low.dtype)

    @property
    def volume(self) -> Scalar:
        """Volume of a cell [m^d]."""
        return jnp.prod(self.size)

    def edges(self, axis: int) -> Float[Array, " edges"]:
        """Borders between the cells along an axis [m], the outer ones included."""
        count = self.shape[axis]
        share = jnp.linspace(0.0, 1.0, count + 1, dtype=self.low.dtype)
        return self.low[axis] + share * (self.high[axis] - self.low[axis])

    def centres(self) -> Float[Array, "*cells d"]:
        """Centre of every cell [m]."""
        along = [0.5 * (edges[1:] + edges[:-1]) for edges in map(self.edges, range(len(self.shape)))]
        return jnp.stack(jnp.meshgrid(*along, indexing="ij"), axis=-1)

    def shares(self, mean: Float[Array, "n d"], std: Float[Array, "n d"]) -> list[Float[Array, "n cells"]]:
        """For each axis, the share of N(mean, std^2) in every interval of cells; the outer two have the tails."""
        return [_shares(self.edges(axis), mean[:, axis], std[:, axis]) for axis in range(len(self.shape))]

    def within(self, axis: int, mean: Float[Array, " n"], std: Float[Array, " n"]) -> Float[Array, "n cells"]:
        """Share of N(mean, std^2) in every interval of cells along an axis, without the tails beyond the border."""
        below = ndtr((self.edges(axis) - mean[:, None]) / std[:, None])
        return below[:, 1:] - below[:, :-1]

    def deposit(
        self, weight: Float[Array, " n"], mean: Float[Array, "n d"], std: Float[Array, "n d"]
    ) -> Float[Array, "*cells"]:
        """Expected number per cell of n targets with these weights, positions N(mean, diag(std)^2) [m]."""
        first, *rest = self.shares(mean, std)
        return _summed(weight[:, None] * first, rest)

    def overlap(self, low: Point, high: Point) -> Float[Array, "*cells"]:
        """Share of the box from `low` to `high` [m] in each cell; their sum is the share of the box in the grid."""

        def along(axis: int) -> Float[Array, " cells"]:
            inside = jnp.clip(self.edges(axis), low[axis], high[axis])
            return (inside[1:] - inside[:-1]) / (high[axis] - low[axis])

        return reduce(lambda a, b: a[..., None] * b, [along(axis) for axis in range(len(self.shape))])

    def spread(self, intensity: Float[Array, "*cells"], variance: Point) -> Float[Array, "*cells"]:
        """The intensity after a random step N(0, diag(variance)) [m^2] of every target."""
        for axis in range(len(self.shape)):
            moves = _moves(self.edges(axis), variance[axis])
            intensity = jnp.moveaxis(
                jnp.tensordot(moves, intensity, axes=((0,), (axis,)), precision="highest"), 0, axis
            )
        return intensity

    def density(
        self, intensity: Float[Array, "*cells"], point: Float[Array, "m d"], std: Float[Array, "m d"]
    ) -> Float[Array, " m"]:
        """Intensity per volume [1/m^d] about points, weighed by N(0, diag(std)^2): sum_c u_c l(point | c).

        A target is anywhere in its cell: l is the share of N(point, std^2) in the cell, by the cell's volume. It is 0
        beyond the border: the targets out there, which count in the cells at it, may be anywhere.
        """
        first, *rest = [self.within(axis, point[:, axis], std[:, axis]) for axis in range(len(self.shape))]
        value = jnp.tensordot(first, intensity, axes=1, precision="highest")
        for share in rest:
            value = jnp.einsum("mc,mc...->m...", share, value, precision="highest")
        return value / self.volume


def _summed(first: Float[Array, "n a"], rest: Sequence[Float[Array, "n _"]]) -> Float[Array, "*cells"]:
    """Sum over n of the outer products of the rows."""
    *middle, last = (first, *rest) if rest else (jnp.ones_like(first[:, :1]), first)
    columns = reduce(lambda a, b: (a[..., None] * b[:, None]).reshape(len(b), -1), middle)
    cells = jnp.matmul(columns.T, last, precision="highest")
    return cells.reshape(*(part.shape[1] for part in (first, *rest)))


def _shares(
    edges: Float[Array, " edges"], mean: Float[Array, " n"], std: Float[Array, " n"]
) -> Float[Array, "n cells"]:
    """Share of N(mean, std^2) between the edges, the tails in the outer intervals."""
    below = ndtr((edges[1:-1] - mean[:, None]) / std[:, None])
    zero = jnp.zeros_like(mean)[:, None]
    below = jnp.concatenate([zero, below, 1.0 + zero], axis=1)
    return below[:, 1:] - below[:, :-1]


def _moves(edges: Float[Array, " edges"], variance: Scalar) -> Float[Array, "cells cells"]:
    """Probability of a move from one interval to another whose variance is exactly that of the step.

    Over short steps to the neighbours only: as all targets of an interval count as one point in its middle, a Gaussian
    would keep them there for ever. Over long ones by the Gaussian, less the variance that intervals add (Sheppard).
    """
    count, size = len(edges) - 1, edges[1] - edges[0]
    middle = 0.5 * (edges[1:] + edges[:-1])
    is_short = variance <= 0.5 * size**2
    std = jnp.sqrt(jnp.where(is_short, size**2, variance - size**2 / 12.0))
    long = _shares(edges, middle, jnp.broadcast_to(std, middle.shape))
    aside = jnp.where(is_short, 0.5 * variance / size**2, 0.0)
    eye = jnp.eye(count, dtype=edges.dtype)
    here = jnp.arange(count)
    left, right = eye[jnp.maximum(here - 1, 0)], eye[jnp.minimum(here + 1, count - 1)]
    return jnp.where(is_short, (1.0 - 2.0 * aside) * eye + aside * (left + right), long)
