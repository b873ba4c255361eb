"""Lines of sight, ranges along rays and free ways among obstacles, by steps along a grid of signed distances.

A ray may go on by as much as the nearest obstacle is away, and cannot have missed one (sphere tracing, Hart 1996).
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from foveate.geometry.distance_grid import DistanceGrid
from foveate.types import Flag, Point, Scalar

OPAQUE_CELLS = 0.5
"""A line that comes nearer to an obstacle than this, in cells, is blocked: corners lose at most that by the grid."""

STRIDE_CELLS = 0.75
"""Least step along a line of sight, in cells: an obstacle a cell thick has a point nearer than OPAQUE_CELLS to it."""

RAY_STEPS = 8
"""Steps along a ray, after which it ends: where it runs along an obstacle its range is then too short, by metres."""

WAY_CELLS = 1.0
"""Least step along a way, in cells."""

CLOSER_CELLS = 1e-5
"""What a body that begins too near to an obstacle may come closer to it, in cells: rounding."""

HALVINGS = 6
"""Halvings of the last step before a contact, which is then known to 1/64 of it."""

MIN_APPROACH = 1e-2
"""Least slope of the distance at a contact, per metre, with which its place has a derivative: that grows as 1/slope."""

P = TypeVar("P")


def sees(
    grid: DistanceGrid, eye: Point, points_world: Float[Array, "n d"], asked: Bool[Array, " n"]
) -> Bool[Array, " n"]:
    """Points [m] to which the line from the eye is free, among those that are asked for; false for all others."""
    opaque, stride = OPAQUE_CELLS * grid.cell, STRIDE_CELLS * grid.cell
    return _is_free(grid, eye, points_world, asked, opaque, grid.slack, stride)


def passes(grid: DistanceGrid, eye: Point, points_world: Float[Array, "n d"], radius_m: Scalar) -> Bool[Array, " n"]:
    """Points [m] to which a body can go in a straight line; one that begins too near may get no nearer."""
    least = margin(grid, radius_m)
    floor = jnp.minimum(least, grid(eye) - CLOSER_CELLS * grid.cell)
    asked = jnp.ones(points_world.shape[:1], bool)
    return _is_free(grid, eye, points_world, asked, floor, least, WAY_CELLS * grid.cell)


def _is_free(
    grid: DistanceGrid,
    eye: Point,
    points_world: Float[Array, "n d"],
    asked: Bool[Array, " n"],
    least: Scalar,
    lost: Scalar,
    stride: Scalar,
) -> Bool[Array, " n"]:
    """True where the distance is more than `least` all along a line, by steps of the distance less `lost` and a stride.

    As far as the distance less `lost` nothing is, and from there on a look every stride is enough.
    """
    way = points_world - eye
    length = jnp.linalg.norm(way, axis=-1)
    line = grid.line(eye, way / jnp.maximum(length, 1e-9)[:, None])

    def advance(carry):
        at, active, free = carry
        distance = grid.at(line(at))
        clear = distance > least
        free = jnp.where(active, clear, free)
        active = active & clear & (at < length)
        return jnp.minimum(at + jnp.maximum(distance - lost, 0.0) + stride, length), active, free

    first = jnp.zeros_like(length), asked, jnp.zeros_like(asked)
    return jax.lax.while_loop(lambda carry: jnp.any(carry[1]), advance, first)[2]


def least_distance(
    grid: DistanceGrid, eye: Point, points_world: Float[Array, "n d"], samples: int
) -> Float[Array, " n"]:
    """Least signed distance on the way from the eye to each point, less that of an opaque line [m]: < 0 if blocked.

    It is taken at `samples` places, with a derivative by eye and points.
    """
    share = jnp.linspace(1.0 / samples, 1.0, samples, dtype=eye.dtype)[:, None, None]
    places = eye + share * (points_world - eye)
    return jnp.min(grid(places), axis=0) - OPAQUE_CELLS * grid.cell


def ranges(
    grid: DistanceGrid, eye: Point, directions_world: Float[Array, "rays d"], most_m: Scalar | float
) -> Float[Array, " rays"]:
    """Free range along rays of unit length, at most `most_m` [m]: never too long, but too short along obstacles."""
    line = grid.line(eye, directions_world)

    def advance(_, at):
        return jnp.minimum(at + jnp.maximum(grid.at_least(line(at)), 0.0), most_m)

    return jax.lax.fori_loop(0, RAY_STEPS, advance, jnp.zeros_like(directions_world[:, 0]))


def fan(rays: int, dimension: int) -> Float[np.ndarray, "rays d"]:
    """Directions of equally spaced rays, the first straight ahead: on a circle, or on a sphere (Fibonacci lattice)."""
    if dimension == 2:
        angle = 2.0 * np.pi * np.arange(rays) / rays
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ahead = 1.0 - 2.0 * np.arange(rays) / max(1, rays - 1)
    around, turn = np.sqrt(1.0 - ahead**2), np.pi * (3.0 - np.sqrt(5.0)) * np.arange(rays)
    return np.stack([ahead, around * np.cos(turn), around * np.sin(turn)], axis=1)


def margin(grid: DistanceGrid, radius_m: Scalar) -> Scalar:
    """Distance on the grid [m] at which a body of this radius is stopped, so that it never touches.

    The grid may say `slack` too much, and between two places a step of WAY_CELLS apart another half of that is lost.
    """
    return radius_m + grid.slack + 0.5 * WAY_CELLS * grid.cell


def share_free(
    grid: DistanceGrid, way: Callable[[P, Scalar], Point], parameters: P, length_m: Scalar, radius_m: Scalar
) -> tuple[Scalar, Flag]:
    """Share of a way that a body can go before it touches an obstacle, and whether it does.

    Args:
        grid: Distances to obstacles.
        way: The position [m] at a share of the way, moving at a constant speed, as a function of the parameters.
        parameters: Parameters of the way, by which the share has a derivative.
        length_m: Length of the way [m].
        radius_m: Radius of the body [m].

    Returns:
        The share, from 0 to 1, and true for a contact. A body that begins too near may go where it gets no nearer.
    """
    least, fixed = margin(grid, radius_m), jax.lax.stop_gradient(parameters)
    length = jnp.maximum(jax.lax.stop_gradient(length_m), 1e-9)
    stride, begin = WAY_CELLS * grid.cell, jnp.zeros_like(length)

    def room(share: Scalar) -> Scalar:
        return grid(way(fixed, share)) - least

    first_room = room(begin)
    floor = jnp.minimum(first_room, 0.0)

    # As far as there is room the way is clear, and from there on a look every stride is enough.
    def advance(carry):
        done, clear_to, ahead, _ = carry
        there = room(ahead)
        clear = there >= floor
        done = jnp.where(clear, ahead, done)
        clear_to = jnp.where(clear, ahead + jnp.maximum(there, 0.0) / length, clear_to)
        return done, clear_to, jnp.minimum(clear_to + stride / length, 1.0), ~clear

    clear_to = jnp.maximum(first_room, 0.0) / length
    first = begin, clear_to, jnp.minimum(clear_to + stride / length, 1.0), jnp.array(False)
    done, clear_to, ahead, touches = jax.lax.while_loop(lambda carry: (carry[0] < 1.0) & ~carry[3], advance, first)
    # The grid may say less there than it should, and a body that stopped on such a place would begin too near.
    done = jnp.where(room(clear_to) >= floor, jnp.minimum(clear_to, ahead), done)

    def halve(_, pair):
        free, blocked = pair
        middle = 0.5 * (free + blocked)
        clear = room(middle) >= floor
        return jnp.where(clear, middle, free), jnp.where(clear, blocked, middle)

    share = jnp.where(touches, jax.lax.fori_loop(0, HALVINGS, halve, (done, ahead))[0], 1.0)
    return _with_derivative(grid, way, parameters, share, touches, length), touches


def _with_derivative(grid, way, parameters, share, touches, length):
    """The share with the derivative of the place of contact: the distance there does not change with the parameters."""
    moving = lambda s: grid(way(jax.lax.stop_gradient(parameters), s))  # noqa: E731
    distance = grid(way(parameters, share))
    slope = jax.jvp(moving, (share,), (jnp.ones_like(share),))[1]
    approaches = touches & (slope < -MIN_APPROACH * length)
    change = (distance - jax.lax.stop_gradient(distance)) / jnp.where(approaches, -slope, 1.0)
    return share + jnp.where(approaches, change, 0.0)
