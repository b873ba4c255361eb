"""Places where undetected targets are expected, as entries beside the tracks: a network can point at them, too."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.models.problem import Problem
from foveate.policies.search import Alternate
from foveate.policies.tokens import Tokens
from foveate.simulation.records import Observation

PLACES = 12
"""Number of places that a network is told of: those most worth a look."""
LEAST_WORTH = 1e-3
"""A look that is worth less [targets] is worth nothing."""
PREFERENCE = 2.0
"""First log weight of a token for each unit of the logarithm of its worth."""


class Searched(NamedTuple):
    """An observation with places behind its tracks, further `features` of all these, and the logarithm of their worth.

    The features are 1 for a place, the existence of a track or the expected number of targets near a place, and the
    logarithm.
    """

    observation: Observation
    features: Float[Array, "n features"]
    log_worth: Float[Array, " n"]

    def told(self, tokens: Tokens) -> Tokens:
        """The tokens of the observation with these features in front; what a look is worth has the price of the way."""
        features = jnp.concatenate([self.features, tokens.features], axis=-1)
        urgency = jnp.stack([-PREFERENCE * self.log_worth, jnp.zeros_like(self.log_worth)], axis=-1)
        return tokens._replace(features=jnp.where(tokens.present[:, None], features, 0.0), urgency=urgency)


def with_places(observation: Observation) -> Searched:
    """Add the best of coarse places as entries with the prior's uncertainty.

    Raises InputError for an observation without undetected targets.
    """
    problem = None if observation.robot is None else observation.robot.problem
    if observation.undetected is None or observation.existence is None or problem is None:
        raise InputError("observation.undetected = None: expected that of detections without ids, for this policy")
    rule, motion = Alternate(problem, 0.0), problem.motion
    number, worth, position_world = rule.places(observation)
    best, chosen = jax.lax.top_k(worth, min(PLACES, len(worth)))
    count, means = len(best), jax.vmap(motion.state_at)(position_world[chosen])
    prior = jnp.broadcast_to(problem.prior_information, (count, *problem.prior_information.shape))
    existence = jnp.concatenate([jnp.where(observation.present, observation.existence, 0.0), number[chosen]])
    worth = jnp.concatenate([rule.saved(observation), best])
    log_worth = jnp.log(worth + LEAST_WORTH)
    is_place = jnp.arange(len(worth)) >= len(observation.present)
    nothing = jnp.zeros((count, observation.known_input.shape[1]), observation.known_input.dtype)
    more = replace(
        observation,
        mean=jnp.concatenate([observation.mean, means]),
        information=jnp.concatenate([observation.information, prior]),
        present=jnp.concatenate([observation.present, jnp.ones(count, bool)]),
        known_input=jnp.concatenate([observation.known_input, nothing]),
        existence=existence,
    )
    features = jnp.stack([is_place.astype(existence.dtype), existence, log_worth / 3.0], axis=-1)
    return Searched(more, features, log_worth)


def token_count(problem: Problem, targets: int) -> int:
    """Number of tokens of a network: the targets, or tracks and places where detections have no ids."""
    return targets if problem.detections is None else problem.detections.tracks + PLACES
