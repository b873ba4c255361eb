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
from foveate.policies.assigned_pointer import AssignedPointer
from foveate.policies.pointer import NO_LIMIT, PointerPolicy, command
from foveate.policies.tokens import Tokens
from foveate.simulation.records import TRUE, Observation
from foveate.simulation.rollout import Decide, simulate
from foveate.simulation.team import rollout as team
from foveate.simulation.team.rollout import TeamDecide
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

    Raises InputError for a team without an assignment, for a world without targets, and for features that are not
    finite.
    """
    if worlds[0].problem.team is not None and not isinstance(policy, AssignedPointer):
        raise InputError("policy.clips_features = True: expected false in a team, or a policy.assignment")
    keys, free = jax.random.split(key, len(worlds)), replace(policy, feature_range=None)
    ranges = [_range(world, informed(free, world, settings), key) for world, key in zip(worlds, keys, strict=True)]
    if policy.feature_range is not None:  # features without a range yet have that of these worlds
        low, high = np.asarray(policy.feature_range)
        ranges.append(np.stack([np.where(low == -NO_LIMIT, np.inf, low), np.where(high == NO_LIMIT, -np.inf, high)]))
    low, high = np.min([low for low, _ in ranges], axis=0), np.max([high for _, high in ranges], axis=0)
    return replace(policy, feature_range=jnp.asarray(np.stack([low, high]), float))


def _range(world: World, policy: PointerPolicy, key: Key) -> np.ndarray:
    def play(key: Key) -> tuple[Float[Array, "K *M n features"], Bool[Array, "K *M n"]]:
        scene_key, policy_key = jax.random.split(key)
        problem, episode = world.drawn(scene_key)
        if episode.team is None:
            notes = simulate(problem, _noting(policy), episode, TRUE, policy_key, lambda done: done.notes)
        else:
            memory = jax.vmap(policy.start)(team.first_observations(problem, episode, TRUE))
            what = problem, _noting_in_team(policy), episode, TRUE, policy_key, lambda done: done.notes
            notes = team.simulate(*what, memory=memory)[2]
        tokens, number = notes
        counts = tokens.present & (number < episode.horizon)[..., None]
        return tokens.features, counts

    run = compiled(jax.vmap(play), suits_quick_compilation(world.problem))
    features, counts = (np.asarray(x) for x in run(jax.random.split(key, EPISODES)))
    told = features[counts]
    if not told.size or not np.isfinite(told).all():
        what = "a number that is not finite" if told.size else "no target"
        raise InputError(f"policy.clips_features = True: expected false: there is {what} in {EPISODES} episodes")
    return np.quantile(told, [OUTSIDE, 1 - OUTSIDE], axis=0)


def _noting_in_team(policy: PointerPolicy) -> TeamDecide:
    """The policy's decisions, with its tokens and the number of the step as notes."""

    def decide(observation: Observation, memory: Any, key: Key) -> tuple[Action, Array, Any, tuple[Tokens, Count]]:
        seen, memory = policy.shown(observation, memory)
        tokens = policy.tokens(seen)
        modes = policy.modes(tokens)
        mode = jnp.argmax(modes.log_weight)
        memory = policy.claimed(seen, memory, mode)
        return command(seen, modes.action[mode]), policy.claims(seen, memory), memory, (tokens, seen.step)

    return decide


def _noting(policy: PointerPolicy) -> Decide:
    """The same of a single robot."""
    decide = _noting_in_team(policy)

    def alone(observation: Observation, memory: Any, key: Key) -> tuple[Action, Any, tuple[Tokens, Count]]:
        action, _, memory, notes = decide(observation, memory, key)
        return action, memory, notes

    return alone
