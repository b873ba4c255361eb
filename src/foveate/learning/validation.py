"""Validate a policy in training on held-out scenes."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp

from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings, ValidationSettings
from foveate.experiment.run_folder import Validation
from foveate.learning.learner import objective_score
from foveate.learning.worlds import World, informed, worlds_of
from foveate.models.problem import Problem
from foveate.policies.pointer import PointerPolicy
from foveate.simulation.records import PROTOCOLS, Episode, Policy, Trace
from foveate.simulation.rollout import rollout
from foveate.types import Key

OnValidation = Callable[[Validation, int], None]
"""Called with every validation and the total number of epochs (PPO of Stable-Baselines3: of steps)."""

HeldOut = tuple[Problem | None, Episode]
"""Episodes of a world, and the robot of each; None where there is one robot."""

MAX_FREE_ACTION = 0.99
"""Largest size of a command that is not at a limit: beyond it, tanh has hardly any gradient to recover by."""


def no_report(validation: Validation, total: int) -> None:
    """Ignore a validation."""


def held_out_episodes(experiment: Experiment, key: Key) -> list[HeldOut]:
    """Sample scenes of each world that never train the policy, from the test distribution, with truth and noise."""
    worlds = worlds_of(experiment)
    keys = [key] if len(worlds) == 1 else jax.random.split(key, len(worlds))
    counts = [experiment.training.held_out_scenes(world.scenes) for world in worlds]
    return [
        world.held_out(jax.random.split(key, count)) for world, key, count in zip(worlds, keys, counts, strict=True)
    ]


def validate(
    experiment: Experiment, policy: Policy, held_out: Sequence[HeldOut], key: Key
) -> tuple[jax.Array, jax.Array]:
    """Return the mean held-out score, by the training's objective, and the share of commands at a limit."""
    found = [
        _validate(world, experiment.training, policy, *each, key)
        for world, each in zip(worlds_of(experiment), held_out, strict=True)
    ]
    score, at_limit = (jnp.mean(jnp.stack(each)) for each in zip(*found, strict=True))
    return score, at_limit


def _validate(
    world: World, training: ValidationSettings, policy: Policy, robots: Problem | None, episodes: Episode, key: Key
) -> tuple[jax.Array, jax.Array]:
    protocol = PROTOCOLS[training.select]
    keys = jax.random.split(key, len(episodes.horizon))
    if isinstance(policy, PointerPolicy) and isinstance(training, ActorCriticSettings):
        policy = informed(policy, world, training)

    def play(robot, episode, key):
        return rollout(world.problem if robot is None else robot, policy, episode, protocol, key)

    trace: Trace = jax.vmap(play)(robots, episodes, keys)
    score = jax.vmap(lambda t, e: objective_score(t, e, world.objective))(trace, episodes)
    counts = jnp.arange(trace.action.shape[1]) < episodes.horizon[:, None]
    # A policy may hold one axis at its limit for good reason; with all axes at their limits it has collapsed.
    at_limit = jnp.all(jnp.abs(trace.action) > MAX_FREE_ACTION, axis=-1)
    return jnp.mean(score), jnp.mean(at_limit, where=counts)
