"""Bodies that the agent keeps its distance from, targets and team-mates: where its way ends, and ways past them."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.types import Point, Scalar

CLEARANCE = 1.2
"""Ways past a body keep this many times the distance to be kept: at the distance itself the agent would stop."""

MOST_CLEARANCE = 1.7
"""Most times the distance to be kept, where a body may be elsewhere than believed."""

LEAVING_RAD = 1.75
"""Nearer than that the agent aims by this angle off the body: to its side, and a little away from it."""

TINY = 1e-6
"""Sine below which a goal is straight behind a body, and the way leads past on the left; also the least length [m]."""


class Bodies(NamedTuple):
    """Where bodies are in the world [m], at one instant or along the steps of a future; those `present` count.

    `std_m` says how sure that is; None where it is known.
    """

    positions_world: Float[Array, "*K n d"]
    present: Bool[Array, "*K n"]
    std_m: Float[Array, "*K n"] | None = None

    def radius_m(self, keep_m: Scalar) -> Float[Array, "*K n"]:
        """How far ways past them keep off [m]: further than `keep_m` [m], and more so where they may be elsewhere."""
        least = jnp.broadcast_to(CLEARANCE * keep_m, self.present.shape)
        return least if self.std_m is None else jnp.minimum(least + 2.0 * self.std_m, MOST_CLEARANCE * keep_m)


def share_clear(
    before: Point, after: Point, obstacles: Float[Array, "n d"], exist: Bool[Array, " n"], distance_m: Scalar
) -> Scalar:
    """Share of the way from `before` to `after` until it is within `distance_m` [m] of a point, approaching it.

    With q = before - point and way w, |q + t w| = d first at t = (q.q - d^2) / (-q.w + sqrt((q.w)^2 - w.w (q.q -
    d^2))). A way that begins too near may only lead away.
    """
    way, q = after - before, before - obstacles
    approach = -jnp.sum(q * way, axis=-1)
    room = jnp.maximum(jnp.sum(q**2, axis=-1) - distance_m**2, 0.0)
    square = approach**2 - jnp.sum(way**2) * room
    touches = exist & (approach > 0) & (square > 0)
    until = room / jnp.where(touches, approach + jnp.sqrt(jnp.where(touches, square, 1.0)), 1.0)
    return jnp.min(jnp.where(touches & (until < 1.0), until, 1.0), initial=1.0)


def aim_past(
    goal_body: Point,
    standoff_m: Scalar | float,
    bodies_body: Float[Array, "n d"],
    present: Bool[Array, " n"],
    radius_m: Float[Array, " n"],
) -> Point:
    """Where to aim on the way to a goal [m], all in the body frame: at the goal, or beside the first body in the way.

    A body is in the way if the straight line, up to `standoff_m` [m] before the goal, comes within its `radius_m` [m];
    not if the goal itself is that near to it. The aim is as far away as the goal, on the tangent of that ball on the
    goal's side.
    """
    # One more that is not there: the first of none has no index. Padding may hold anything.
    bodies_body = jnp.pad(jnp.where(present[:, None], bodies_body, 0.0), ((0, 1), (0, 0)))
    radius, present = jnp.pad(jnp.where(present, radius_m, 0.0), (0, 1)), jnp.pad(present, (0, 1))
    length = jnp.sqrt(jnp.sum(goal_body**2) + TINY**2)
    unit = goal_body / length
    along = bodies_body @ unit
    square = jnp.sum(bodies_body**2, axis=-1)
    half_chord = jnp.sqrt(jnp.maximum(radius**2 - (square - along**2), 0.0))
    apart = jnp.sum((bodies_body - goal_body) ** 2, axis=-1) > radius**2
    blocks = present & apart & (along > 0) & (half_chord > 0) & (along - half_chord < length - standoff_m)
    first = jnp.argmin(jnp.where(blocks, along - half_chord, jnp.inf))
    away = jnp.sqrt(square[first] + TINY**2)
    towards = bodies_body[first] / away
    beside = unit - (unit @ towards) * towards
    left = jnp.zeros_like(unit).at[:2].set(jnp.stack([-towards[1], towards[0]]))
    # Straight above there is no left of the body: that of the agent, y.
    left = jnp.where(jnp.sum(left**2) > TINY**2, left, jnp.zeros_like(unit).at[1].set(1.0))
    beside = jnp.where(jnp.sum(beside**2) > TINY**2, beside, left)
    beside = beside / jnp.sqrt(jnp.sum(beside**2))
    # The arcsine has no finite slope at 1.
    share = radius[first] / away
    angle = jnp.where(share < 1.0, jnp.arcsin(jnp.minimum(share, 1.0 - TINY)), LEAVING_RAD)
    return jnp.where(blocks.any(), length * (jnp.cos(angle) * towards + jnp.sin(angle) * beside), goal_body)
