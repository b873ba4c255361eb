"""What all learners share: how a policy is judged while it learns, and the run folder that tells of it."""

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path

import jax
import jax.numpy as jnp

from foveate.checkpoint import BEST, CONFIG, LAST
from foveate.episodes import training_episode
from foveate.files import LOCK, append_line, is_temporary, write_atomic
from foveate.learning.events import Events
from foveate.learning.policy_gradient import episode_score
from foveate.problem import Episode, Policy, Problem, Trace
from foveate.rollout import PROTOCOLS, rollout
from foveate.settings import Experiment, PPOSettings
from foveate.types import Key

METRICS = "metrics.jsonl"
LIMIT = 0.99
"""A command this close to a limit of its axis (or tanh beyond it) has no gradient to come back by."""


@dataclass(frozen=True, kw_only=True)
class Check:
    """One judgement of a policy in training, a line of `metrics.jsonl`.

    An epoch is one step of the policy gradient, or of PPO one rollout with all passes over it; `env_steps` is how many
    steps of simulated episodes all epochs took (in the mean over the scenes drawn, where they are not counted).
    `objective` is the mean over the epochs since the last check, `held_out` the score of the protocol that selects
    the best, `at_limit` the share of held-out commands with every axis at a limit; PPO tells no `gradient_norm`.
    """

    epoch: int
    objective: float
    gradient_norm: float | None
    held_out: float
    at_limit: float
    best: bool
    epochs_per_s: float
    elapsed_s: float
    event: str = ""
    env_steps: int = 0


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How a training ended."""

    epochs: int
    best_epoch: int
    best_score: float
    returns: int
    stopped: str


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


def claim(out: Path, experiment: Experiment) -> None:
    """Make the run folder `out`, but for its config.toml: that is written last, where there is something to go on with.

    What a training left that was killed before that is no run. Raises ValueError where something else is there.
    """
    require_free(out, experiment)
    (out / BEST).parent.mkdir(parents=True, exist_ok=True)
    write_atomic(out / METRICS, b"")


def require_free(out: Path, experiment: Experiment) -> None:
    """Raise ValueError where a run, or something else, is there already."""
    if out.exists() and not _is_free(out):
        resume = "" if isinstance(experiment.training, PPOSettings) else f", or go on with --resume {out}"
        raise ValueError(f"{out}: exists already: choose another --out{resume}")


def _is_free(out: Path) -> bool:
    """A folder without anything, or with a beginning from before the first check."""
    if not out.is_dir() or (out / CONFIG).exists():
        return False
    inside = [path for path in out.rglob("*") if not is_temporary(path)]
    remains = {out / LOCK, out / METRICS, (out / LAST).parent, out / LAST}
    return set(inside) <= remains and all(path.stat().st_size == 0 for path in inside if path.name == METRICS)


def write_check(out: Path, check: Check, events: Events) -> None:
    """Append a check to the metrics and the TensorBoard events of a run."""
    facts = {name: value if _is_json(value) else None for name, value in asdict(check).items()}
    append_line(out / METRICS, json.dumps(facts))
    names = ("objective", "gradient_norm", "held_out", "at_limit", "epochs_per_s")
    events.add({name: value for name in names if (value := getattr(check, name)) is not None}, check.epoch)


def _is_json(value: object) -> bool:
    """JSON has no NaN and no infinity."""
    return not isinstance(value, float) or math.isfinite(value)
