"""What a pointer network is told of its team, beside each target: who is near it, how sure that is, who goes for it.

All numbers are of the newest that the robot has heard of each mate, in the network's own units. They do not depend on
the number of mates or on their order: a network serves teams of any size.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.models.problem import Problem
from foveate.policies.assigned import shares
from foveate.simulation.records import Observation
from foveate.types import Scalar

TEAM_FEATURES = 8
"""Number of features of a target that are about the team."""

FRESH_STEPS = 10.0
"""Age at which news of a mate counts for a third."""

NEAR = 0.05
"""Least distance that is told, in depths of the view."""

FAR = 100.0
"""Distance of a mate where there is none, in depths of the view."""


class TeamTokens(NamedTuple):
    """Features (n, TEAM_FEATURES) of every target, and 0 where it is the robot's own by greedy assignment, else 1."""

    features: Float[Array, "n features"]
    not_own: Float[Array, " n"]


def team_tokens(
    observation: Observation, problem: Problem, position_world: Float[Array, "n d"], depth: Scalar
) -> TeamTokens:
    """What is told of the team; without one, as if there were no mates."""
    team, present, zero = observation.team, observation.present, jnp.zeros_like(position_world[:, 0])
    if team is None:
        nothing = [zero + math.log(FAR), zero - 1.0, *[zero] * 5, zero + 1.0]
        return TeamTokens(jnp.stack(nothing, axis=-1), zero)
    space = problem.agent.space
    distance = jax.vmap(lambda pose: jnp.linalg.norm(space.to_body(pose, position_world), axis=-1))(team.pose) / depth
    is_mate = jnp.arange(len(team.age)) != team.number
    fresh = jnp.where(is_mate, jnp.exp(-team.age.astype(distance.dtype) / FRESH_STEPS), 0.0)[:, None]
    own, mates = distance[team.number], jnp.where(is_mate[:, None], distance, FAR)
    nearest = jnp.argmin(mates, axis=0)
    least = jnp.min(mates, axis=0)
    claimed = fresh * team.claims
    share = shares(distance * depth, present, is_greedy=True)[team.number].astype(distance.dtype)
    nearer = jnp.sum(jnp.where(mates < own, fresh, 0.0), axis=0)
    features = [
        jnp.log(least + NEAR),
        jnp.tanh(own - least),
        fresh[nearest, 0],
        jnp.max(claimed, axis=0),
        jnp.log1p(jnp.sum(jnp.abs(claimed), axis=0)),
        jnp.log1p(nearer),
        zero + jnp.log1p(jnp.sum(fresh)) / 2.0,
        share,
    ]
    # A robot without a target of its own goes where it likes.
    not_own = jnp.where(jnp.any(share > 0), 1.0 - share, 0.0)
    return TeamTokens(jnp.stack(features, axis=-1), not_own)
