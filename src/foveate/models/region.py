"""A region with borders that agent and targets keep.

The agent's position moves from the start of a step to its end on a straight line, and stops at the first contact; its
turn is not affected. Targets follow their own motion, and are put back at the end of a step that has crossed a border.
"""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

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
