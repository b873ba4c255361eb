"""Places where undetected targets are expected, as entries beside the tracks: a network can point at them, too.

What it is told of each is what the look-ahead expects of the way there, and so its first preference is the look-ahead.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.models.problem import Problem
from foveate.policies.lookahead import LookAhead
from foveate.policies.tokens import Tokens
from foveate.simulation.bodies import blocking
from foveate.simulation.records import Observation

PLACES = 12
"""Number of places that a network is told of: those with the best ways."""
PREFERENCE = 3.0
"""First log weight lost for each target that the way to another goal is expected to leave less of."""


class Searched(NamedTuple):
    """An observation with places behind its tracks, further `features` of all these, and what their ways cost.

    The features are 1 for a place, the existence of a track or the expected number of undetected targets at a place,
    and the scaled cost; `cost` [targets] is that of `LookAhead`, more than that of the best.
    """

    observation: Observation
    features: Float[Array, "n features"]
    cost: Float[Array, " n"]

    def told(self, tokens: Tokens) -> Tokens:
        """The tokens of the observation with these features in front; a cost includes the length of the way."""
        features = jnp.concatenate([self.features, tokens.features], axis=-1)
        # The look-ahead of a team leaves out what is others' by itself.
        nothing = [jnp.zeros_like(self.cost)] * (tokens.urgency.shape[1] - 1)
        urgency = jnp.stack([PREFERENCE * self.cost, *nothing], axis=-1)
        return tokens._replace(features=jnp.where(tokens.present[:, None], features, 0.0), urgency=urgency)


def with_places(observation: Observation) -> Searched:
    """Add the best of coarse places as entries with the prior's uncertainty.

    Raises InputError for an observation without undetected targets.
    """
    problem = None if observation.robot is None else observation.robot.problem
    if observation.undetected is None or observation.existence is None or problem is None:
        raise InputError("observation.undetected = None: expected that of detections without ids, for this policy")
    team = observation.team
    goals, motion, tracks = LookAhead(problem).goals(observation), problem.motion, observation.present.shape[0]
    best, chosen = jax.lax.top_k(-goals.cost[tracks:], min(PLACES, len(goals.number)))
    count, means = len(best), jax.vmap(motion.state_at)(goals.position_world[tracks:][chosen])
    prior = jnp.broadcast_to(problem.prior_information, (count, *problem.prior_information.shape))
    present = jnp.concatenate([observation.present, jnp.ones(count, bool)])
    cost = jnp.concatenate([goals.cost[:tracks], -best])
    cost = jnp.where(present, cost - jnp.min(cost), 0.0)
    existence = jnp.where(observation.present, observation.existence, 0.0)
    existence = jnp.concatenate([existence, goals.number[chosen]])
    nothing = jnp.zeros((count, observation.known_input.shape[1]), observation.known_input.dtype)
    more = replace(
        observation,
        mean=jnp.concatenate([observation.mean, means]),
        information=jnp.concatenate([observation.information, prior]),
        present=present,
        blocking=jnp.concatenate([blocking(observation), jnp.zeros(count, bool)]),
        known_input=jnp.concatenate([observation.known_input, nothing]),
        existence=existence,
        team=None if team is None else replace(team, claims=jnp.pad(team.claims, ((0, 0), (0, count)))),
    )
    is_place = jnp.arange(len(cost)) >= tracks
    features = jnp.stack([is_place.astype(existence.dtype), existence, jnp.log1p(cost)], axis=-1)
    return Searched(more, features, cost)


def token_count(problem: Problem, targets: int) -> int:
    """Number of tokens of a network: the targets, or tracks and places where detections have no ids."""
    return targets if problem.detections is None else problem.detections.tracks + PLACES
