"""Validate a policy in training on held-out scenes."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from foveate.experiment.experiment import Experiment
from foveate.experiment.run_folder import Validation
from foveate.learning.learner import episode_score
from foveate.models.problem import Problem
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import PROTOCOLS, Episode, Policy, Trace
from foveate.simulation.rollout import rollout
from foveate.types import Key

OnValidation = Callable[[Validation, int], None]
"""Called with every validation and the total number of epochs (PPO of Stable-Baselines3: of steps)."""

MAX_FREE_ACTION = 0.99
"""Largest size of a command that is not at a limit: beyond it, tanh has hardly any gradient to recover by."""


def no_report(validation: Validation, total: int) -> None:
    """Ignore a validation."""


def held_out_episodes(experiment: Experiment, problem: Problem, key: Key) -> Episode:
    """Sample scenes that never train the policy, from the test distribution, with truth and noise."""
    scenes = experiment.scenario.scenes
    keys = jax.random.split(key, experiment.training.held_out)
    return jax.jit(jax.vmap(lambda k: training_episode(problem, scenes, k, noise=True, test=True)))(keys)


def validate(
    experiment: Experiment, problem: Problem, policy: Policy, episodes: Episode, key: Key
) -> tuple[jax.Array, jax.Array]:
    """Return the mean held-out score, by the training's objective, and the share of commands at a limit."""
    training = experiment.training
    objective, protocol = training.objective, PROTOCOLS[training.select]
    keys = jax.random.split(key, training.held_out)
    trace: Trace = jax.vmap(lambda e, k: rollout(problem, policy, e, protocol, k))(episodes, keys)
    values = trace.visible.astype(float) if objective == "seen" else trace.log_det
    score = jax.vmap(lambda v, e: episode_score(v, e, objective == "terminal"))(values, episodes)
    counts = jnp.arange(trace.action.shape[1]) < episodes.horizon[:, None]
    # A policy may hold one axis at its limit for good reason; with all axes at their limits it has collapsed.
    at_limit = jnp.all(jnp.abs(trace.action) > MAX_FREE_ACTION, axis=-1)
    return jnp.mean(score), jnp.mean(at_limit, where=counts)
