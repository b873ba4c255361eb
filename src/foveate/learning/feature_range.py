"""The range of each feature that a pointer network meets before it is trained, for `clips_features`."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from foveate.errors import InputError
from foveate.experiment.learners import ActorCriticSettings
from foveate.io.jax_settings import compiled
from foveate.learning.worlds import World, informed
from foveate.models.precision import suits_quick_compilation
from foveate.policies.pointer import NO_LIMIT, PointerPolicy, command
from foveate.policies.tokens import Tokens
from foveate.simulation.records import TRUE, Observation
from foveate.simulation.rollout import Decide, simulate
from foveate.types import Action, Count, Key

EPISODES = 64
"""Episodes of each world."""

OUTSIDE = 0.05
"""Share of a world's features below the range, and above it: the least and the most may be of one odd episode."""


def with_feature_range(
    worlds: Sequence[World], policy: PointerPolicy, settings: ActorCriticSettings, key: Key
) -> PointerPolicy:
    """The policy, which clips each feature to the range over all worlds; the range of a world leaves out OUTSIDE.

    A range that the policy has, from a training before, is widened. In one robot's own world its limits and noises are
    constants, and those of others are then told as these.

    Raises InputError for a team, for a world without targets, and for features that are not finite.
    """
    if worlds[0].agents > 1:
        raise InputError("policy.clips_features = True: expected false in a team")
    keys, free = jax.random.split(key, len(worlds)), replace(policy, feature_range=None)
    ranges = [_range(world, informed(free, world, settings), key) for world, key in zip(worlds, keys, strict=True)]
    if policy.feature_range is not None:  # features without a range yet have that of these worlds
        low, high = np.asarray(policy.feature_range)
        ranges.append((np.where(low == -NO_LIMIT, np.inf, low), np.where(high == NO_LIMIT, -np.inf, high)))
    low, high = np.min([low for low, _ in ranges], axis=0), np.max([high for _, high in ranges], axis=0)
    return replace(policy, feature_range=jnp.asarray(np.stack([low, high]), float))


def _range(world: World, policy: PointerPolicy, key: Key) -> np.ndarray:
    def play(key: Key) -> tuple[Float[Array, "K n features"], Bool[Array, "K n"]]:
        scene_key, policy_key = jax.random.split(key)
        problem, episode = world.drawn(scene_key)
        tokens, number = simulate(problem, _noting(policy), episode, TRUE, policy_key, lambda done: done.notes)
        return tokens.features, tokens.present & (number < episode.horizon)[:, None]

    run = compiled(jax.vmap(play), suits_quick_compilation(world.problem))
    features, counts = (np.asarray(x) for x in run(jax.random.split(key, EPISODES)))
    told = features[counts]
    if not told.size or not np.isfinite(told).all():
        what = "a number that is not finite" if told.size else "no target"
        raise InputError(f"policy.clips_features = True: expected false: there is {what} in {EPISODES} episodes")
    return np.quantile(told, [OUTSIDE, 1 - OUTSIDE], axis=0)


def _noting(policy: PointerPolicy) -> Decide:
    """The policy's decisions, with its tokens and the number of the step as notes."""

    def decide(observation: Observation, memory: Any, key: Key) -> tuple[Action, Any, tuple[Tokens, Count]]:
        tokens = policy.tokens(observation)
        modes = policy.modes(tokens)
        action = modes.action[jnp.argmax(modes.log_weight)]
        return command(observation, action), memory, (tokens, observation.step)

    return decide
