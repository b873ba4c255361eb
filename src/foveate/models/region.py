"""A region with borders that agent and targets keep, and the distance that the agent keeps from targets.

The agent's position moves from the start of a step to its end on a straight line, and stops at the first contact; its
turn is not affected. Targets follow their own motion, and are put back at the end of a step that has crossed a border.
"""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.types import Point, Scalar


class Region(eqx.Module):
    """A box from `low` to `high` [m], and what happens at its borders (see `scenario.region.RegionSettings`)."""

    low: Float[Array, " d"]
    high: Float[Array, " d"]
    restitution: Scalar
    agent: Literal["stop", "stay", "free"] = eqx.field(static=True, default="stop")
    targets: Literal["bounce", "stop", "free"] = eqx.field(static=True, default="bounce")

    def share_inside(self, before: Point, after: Point) -> Scalar:
        """Share of the way from `before` to `after` until a border; 0 for a step outwards that begins outside."""
        way = after - before
        room = jnp.maximum(jnp.where(way > 0, self.high - before, before - self.low), 0.0)
        length = jnp.abs(way)
        crosses = length > room
        share = jnp.min(jnp.where(crosses, room / jnp.where(crosses, length, 1.0), 1.0))
        return jnp.where(share < 1.0, 0.0, share) if self.agent == "stay" else share

    def put_back(
        self, position: Float[Array, "*b d"], *derivatives: Float[Array, "*b d"]
    ) -> tuple[Float[Array, "*b d"], ...]:
        """Positions beyond a border as they rebound from it, and their derivatives (velocity, ..) turned inwards.

        A distance h beyond the border becomes the distance e h inside of it, and a component u outwards becomes -e u,
        with e the restitution; 0 where targets stop. Nothing gets beyond the opposite border.
        """
        e = self.restitution if self.targets == "bounce" else jnp.zeros_like(self.restitution)
        nearest = jnp.clip(position, self.low, self.high)
        inside = jnp.clip(nearest + e * (nearest - position), self.low, self.high)

        def turned(values: Float[Array, "*b d"]) -> Float[Array, "*b d"]:
            outwards = ((position > self.high) & (values > 0)) | ((position < self.low) & (values < 0))
            return jnp.where(outwards, -e * values, values)

        return inside, *map(turned, derivatives)


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
