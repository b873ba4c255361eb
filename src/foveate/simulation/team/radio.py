"""The radio of a team: whom a message reaches, and the newest that each robot knows of every member."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foveate.geometry.space import Space
from foveate.models.team import Radio
from foveate.simulation.team.records import TeamView
from foveate.types import Count


class Roster(eqx.Module):
    """What each robot (rows) knows of every member (columns): of which step, its pose, and its claims."""

    stamp: Int[Array, "M M"]
    pose: Float[Array, "M M ..."]
    claims: Float[Array, "M M n"]


def first_roster(poses: Float[Array, "M ..."], targets: int) -> Roster:
    """All know where all start, and nothing of their claims."""
    count = len(poses)
    return Roster(
        jnp.zeros((count, count), int),
        jnp.broadcast_to(poses, (count, *poses.shape)),
        jnp.zeros((count, count, targets), poses.dtype),
    )


def links(radio: Radio, space: Space, poses: Float[Array, "M ..."], uniform: Float[Array, "M M"]) -> Bool[Array, "M M"]:
    """True where a message reaches a receiver (rows) from another robot (columns)."""
    position = jax.vmap(space.position)(poses)
    square_m2 = jnp.sum((position[:, None] - position) ** 2, axis=-1)
    others = ~jnp.eye(len(poses), dtype=bool)
    return others & (square_m2 <= radio.range_m**2) & (uniform >= radio.loss)


def own_news(roster: Roster, step: Count, poses: Float[Array, "M ..."], claims: Float[Array, "M n"]) -> Roster:
    """The roster with what each robot knows of itself after a step."""
    own = jnp.arange(len(poses))
    return Roster(
        roster.stamp.at[own, own].set(step),
        roster.pose.at[own, own].set(poses),
        roster.claims.at[own, own].set(claims),
    )


def merged(own: Roster, sent: Roster, heard: Bool[Array, "M M"]) -> Roster:
    """Of each member the newest of what a robot knows and of what it hears, its sender's own news or passed on."""
    stamp = jnp.where(heard[..., None], sent.stamp, -1)  # receiver, sender, member
    sender = jnp.argmax(stamp, axis=1)
    member = jnp.arange(len(heard))
    newest = jax.tree.map(lambda x: x[sender, member], sent)
    is_newer = jnp.max(stamp, axis=1) > own.stamp

    def pick(new: Array, old: Array) -> Array:
        return jnp.where(is_newer.reshape(*is_newer.shape, *[1] * (new.ndim - 2)), new, old)

    return jax.tree.map(pick, newest, own)


def views(roster: Roster, step: Count) -> TeamView:
    """What each robot knows of its team before it decides: one view with a leading axis of robots."""
    number = jnp.arange(len(roster.stamp))
    return jax.vmap(TeamView)(number, roster.pose, step - roster.stamp, roster.claims)
