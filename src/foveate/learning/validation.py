"""What all learners share: how a policy is judged while it learns, and the run folder that tells of it."""

import json
import math
from dataclasses import asdict
from pathlib import Path

import jax
import jax.numpy as jnp

from foveate.experiment.experiment import Experiment
from foveate.experiment.run_folder import METRICS, Validation
from foveate.io.files import append_line
from foveate.learning.objective import episode_score
from foveate.learning.tensorboard import Events
from foveate.models.problem import Problem
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import PROTOCOLS, Episode, Policy, Trace
from foveate.simulation.rollout import rollout
from foveate.types import Key

LIMIT = 0.99
"""A command this close to a limit of its axis (or tanh beyond it) has no gradient to come back by."""


def held_out_episodes(experiment: Experiment, problem: Problem, key: Key) -> Episode:
    """Scenes that never train the policy, from the test distribution, with truth and noise."""
    scenes = experiment.scenario.scenes
    keys = jax.random.split(key, experiment.training.held_out)
    return jax.jit(jax.vmap(lambda k: training_episode(problem, scenes, k, noise=True, test=True)))(keys)


def judge(
    experiment: Experiment, problem: Problem, policy: Policy, episodes: Episode, key: Key
) -> tuple[jax.Array, jax.Array]:
    """Mean held-out score, of what training is after, and the share of commands at a limit."""
    training = experiment.training
    objective, protocol = training.objective, PROTOCOLS[training.select]
    keys = jax.random.split(key, training.held_out)
    trace: Trace = jax.vmap(lambda e, k: rollout(problem, policy, e, protocol, k))(episodes, keys)
    values = trace.visible.astype(float) if objective == "seen" else trace.log_det
    score = jax.vmap(lambda v, e: episode_score(v, e, objective == "terminal"))(values, episodes)
    counts = jnp.arange(trace.action.shape[1]) < episodes.horizon[:, None]
    # A policy that stands at the limit of one axis may do so for good reason; at all of them it has collapsed.
    at_limit = jnp.all(jnp.abs(trace.action) > LIMIT, axis=-1)
    return jnp.mean(score), jnp.mean(at_limit, where=counts)


def write_validation(out: Path, check: Validation, events: Events) -> None:
    """Append a check to the metrics and the TensorBoard events of a run."""
    facts = {name: value if _is_json(value) else None for name, value in asdict(check).items()}
    append_line(out / METRICS, json.dumps(facts))
    names = ("objective", "gradient_norm", "held_out", "at_limit", "epochs_per_s")
    events.add({name: value for name in names if (value := getattr(check, name)) is not None}, check.epoch)


def _is_json(value: object) -> bool:
    """JSON has no NaN and no infinity."""
    return not isinstance(value, float) or math.isfinite(value)
