"""Shortest ways of a body around obstacles, looked up in the tables of `way_tables`.

A way goes towards the anchor nearest to its end, leaves for the end where that is shorter, and is cut short where the
body can go straight.
"""

from itertools import product
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from foveate.geometry import sight
from foveate.geometry.distance_grid import DistanceGrid, Nodes
from foveate.geometry.way_tables import Tables
from foveate.types import Point, Scalar

FIRST, LAST = (2, 4, 7, 11, 16), tuple(range(9))
"""Nodes after the first of a way, and before its last, that are tried as the next place in a straight line.

An anchor is hardly ever farther from an end than the latter: these are all, or a body could stop between two of them.
"""

HURRY = 1e-3
"""Share of what is left of a way that is added to it: of equally long ways one leads to a farther place."""


class Way(NamedTuple):
    """Ways to n places: where to drive next, in a straight line, and the length of each way [m].

    `is_straight` where that place is the end itself, which is also seen from the start; `is_seen` where no obstacle is
    on the line to the end, whether or not the body can go along it.
    """

    place_world: Float[Array, "n d"]
    length: Float[Array, " n"]
    is_straight: Bool[Array, " n"]
    is_seen: Bool[Array, " n"]


class Ways(eqx.Module):
    """Tables of the ways of a body on a lattice of every map, by the number of a node.

    `nearest` is the free node nearest to each node, `anchor` the anchor nearest to each free node by the length of the
    way; `distance` [m] is that to every anchor, and `after` the next node on the way there.
    """

    nearest: Int[Array, "maps nodes"]
    anchor: Int[Array, "maps nodes"]
    distance: Float[Array, "maps nodes anchors"]
    after: Int[Array, "maps nodes anchors"]
    low: Float[Array, " d"]
    pitch: Scalar
    counts: tuple[int, ...] = eqx.field(static=True)
    """Number of nodes on each axis."""

    @classmethod
    def of(cls, given: Tables, nodes: Nodes) -> "Ways":
        """The tables of maps as arrays."""
        return cls(
            nearest=jnp.asarray(given.nearest, int),
            anchor=jnp.asarray(given.anchor, int),
            distance=jnp.asarray(given.distance, float),
            after=jnp.asarray(given.after, int),
            low=jnp.asarray(nodes.low, float),
            pitch=jnp.asarray(given.stride * nodes.cell_m, float),
            counts=tuple((n - 1) // given.stride + 1 for n in nodes.distance.shape[1:]),
        )

    def free_places(self, grid: DistanceGrid, points_world: Float[Array, "n d"]) -> Float[Array, "n d"]:
        """The node nearest to each point [m] that the body can reach."""
        return self._place(self.nearest[grid.index, self._node(points_world)])

    def to(
        self,
        grid: DistanceGrid,
        radius: Scalar,
        eye: Point,
        points_world: Float[Array, "n d"],
        standoff: Scalar | float,
    ) -> Way:
        """Ways of a body from a place to n points [m], or to where it can be nearest to them.

        A way is straight where the point is seen, and the body can go up to `standoff` [m] before it. Ways have no
        derivative.
        """
        fixed, eye = jax.lax.stop_gradient(points_world), jax.lax.stop_gradient(eye)
        away = jnp.linalg.norm(fixed - eye, axis=-1)
        begin, end = (self.nearest[grid.index, self._node(place)] for place in (eye, fixed))
        anchor, beside = self.anchor[grid.index, end], self._beside(eye)
        first, last = self._towards(grid, begin[None], anchor, FIRST), self._towards(grid, end, anchor, LAST)

        def to_anchor(node: Int[Array, "n nodes"]) -> Float[Array, "n nodes"]:
            return self.distance[grid.index, node, anchor[:, None]]

        before = jnp.concatenate([jnp.broadcast_to(beside, (len(first), len(beside))), first], axis=1)
        rest = jnp.concatenate(
            [to_anchor(before) + to_anchor(end[:, None]), to_anchor(end[:, None]) - to_anchor(last)], 1
        )
        places = self._place(jnp.concatenate([before, last], axis=1))
        near = eye + jnp.maximum(1.0 - standoff / jnp.maximum(away, 1e-9), 0.0)[:, None] * (fixed - eye)
        clear, can_approach = self._clear(grid, radius, eye, places, near, len(beside))
        is_seen = sight.sees(grid, eye, fixed, jnp.ones_like(can_approach))
        is_straight = can_approach & is_seen
        hop = jnp.linalg.norm(places - eye, axis=-1)
        best = jnp.argmin(jnp.where(clear, hop + (1.0 + HURRY) * rest, jnp.inf), axis=1)[:, None]
        length = jnp.take_along_axis(hop + rest, best, 1)[:, 0]
        # The way that is gone leads by one anchor. By another it may be shorter, as it will be farther on.
        by_any = jnp.min(self.distance[grid.index, begin] + self.distance[grid.index, end], axis=-1)
        length = jnp.minimum(length, by_any + jnp.linalg.norm(self._place(begin) - eye))
        length = length + jnp.linalg.norm(fixed - self._place(end), axis=-1)
        place = jnp.take_along_axis(places, best[..., None], axis=1)[:, 0]
        # Where it can go nowhere, as in a corner, a body first gets away from the obstacle.
        slope = jax.grad(grid)(eye)
        back = eye + self.pitch * slope / jnp.maximum(jnp.linalg.norm(slope), 1e-6)
        place = jnp.where(clear.any(axis=1, keepdims=True), place, back)
        place = jnp.where(is_straight[:, None], points_world, place)
        least = jnp.maximum(away, jnp.linalg.norm(place - eye, axis=-1))
        return Way(place, jnp.where(is_straight, away, jnp.maximum(length, least)), is_straight, is_seen)

    def _clear(
        self,
        grid: DistanceGrid,
        radius: Scalar,
        eye: Point,
        places: Float[Array, "n places d"],
        near: Float[Array, "n d"],
        common: int,
    ) -> tuple[Bool[Array, "n places"], Bool[Array, " n"]]:
        """Places, of which the first `common` are the same for all, and near ones to which the body can go straight."""
        own = jnp.concatenate([places[:, common:], near[:, None]], axis=1)
        ends = jnp.concatenate([places[0, :common], own.reshape(-1, own.shape[-1])])
        clear = sight.passes(grid, eye, ends, radius)
        shared, clear = clear[:common], clear[common:].reshape(own.shape[:-1])
        shared = jnp.broadcast_to(shared, (len(places), common))
        return jnp.concatenate([shared, clear[:, :-1]], axis=1), clear[:, -1]

    def _beside(self, eye: Point) -> Int[Array, " nodes"]:
        """The nodes around a place."""
        offsets = self.pitch * jnp.array(list(product((-1.0, 0.0, 1.0), repeat=len(self.counts))))
        return self._node(eye + offsets)

    def _node(self, points_world: Float[Array, "*n d"]) -> Int[Array, "*n"]:
        number = jnp.zeros(points_world.shape[:-1], int)
        for axis, count in enumerate(self.counts):
            index = jnp.round((points_world[..., axis] - self.low[axis]) / self.pitch)
            # Clipped as a whole number too: positions in padding may be no numbers.
            index = jnp.clip(jnp.clip(index, 0.0, count - 1.0).astype(int), 0, count - 1)
            number = number * count + index
        return number

    def _place(self, node: Int[Array, "*n"]) -> Float[Array, "*n d"]:
        index = []
        for count in reversed(self.counts):
            index.append(node % count)
            node = node // count
        return self.low + self.pitch * jnp.stack(index[::-1], axis=-1).astype(self.low.dtype)

    def _towards(
        self, grid: DistanceGrid, node: Int[Array, "*n"], anchor: Int[Array, " n"], which: tuple[int, ...]
    ) -> Int[Array, "n places"]:
        """The nodes of these numbers on the ways to anchors."""

        def step(node, _):
            return self.after[grid.index, node, anchor], node

        first = jnp.broadcast_to(node, anchor.shape)
        return jax.lax.scan(step, first, None, which[-1] + 1)[1][np.array(which)].T
