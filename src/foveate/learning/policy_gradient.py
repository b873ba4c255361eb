"""The paper's policy gradient: ascent on log det through the whole simulated episode (proposition 1).

The gradient is in reverse mode through one scan, so its cost does not grow with the number of parameters. Batches are
stratified by the number of targets, which does not change the expected gradient.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import optax

from foveate.experiment.learners import TrainingSettings
from foveate.learning.devices import Share
from foveate.learning.gradient import Group, mean_and_gradient
from foveate.learning.learner import EpochReport, Learner, episode_score, step_scores
from foveate.learning.strata import strata
from foveate.models.problem import Problem
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import Episode, Policy
from foveate.simulation.rollout import log_dets, weights
from foveate.types import Key, Scalar

CPU_BATCH_TARGETS = 384
"""Default number of targets, with padding, in a micro-batch on a CPU: they fit into a core's own cache."""

ACCELERATOR_BATCH_TARGETS = 131072
"""The same on an accelerator, which needs many to be busy and has the memory."""


def optimizer(settings: TrainingSettings) -> optax.GradientTransformation:
    """Adam on the clipped gradient."""
    rate = settings.learning_rate
    if settings.schedule == "cosine":
        rate = optax.cosine_decay_schedule(rate, settings.epochs)
    return optax.chain(optax.clip_by_global_norm(settings.gradient_bound), optax.adam(rate))


def begin(policy: Policy, settings: TrainingSettings) -> Learner:
    """A learner before its first epoch."""
    parameters = eqx.filter(policy, eqx.is_inexact_array)
    return Learner(policy, optimizer(settings).init(parameters), jnp.zeros((), int))


def micro_batch_size(settings: TrainingSettings, scenes: SceneSettings) -> int:
    """Episodes in a micro-batch: `settings.micro_batch`, or a number that suits the device."""
    targets = CPU_BATCH_TARGETS if jax.default_backend() == "cpu" else ACCELERATOR_BATCH_TARGETS
    return settings.micro_batch or max(1, targets // scenes.targets_max)


def shares(settings: TrainingSettings, scenes: SceneSettings) -> list[Share]:
    """The parts of a batch that have one shape."""
    return [
        Share(len(stratum.targets), micro_batch_size(settings, stratum.scenes), stratum.cost)
        for stratum in strata(scenes, settings.episodes)
    ]


def objective(problem: Problem, policy: Policy, episode: Episode, settings: TrainingSettings, key: Key) -> Scalar:
    """Differentiable log det [nat per target], or share of time in view, of an episode under the soft views."""
    values_of, is_terminal = weights if settings.objective == "seen" else log_dets, settings.objective == "terminal"
    values = values_of(problem, policy, episode, settings.protocol, key, settings.backpropagation)
    score = episode_score(values, episode, is_terminal)
    if settings.window is None or not is_terminal:
        return score
    # Windows cut the gradient: the score at the horizon has a derivative in the last window only. So the scores at the
    # ends of earlier windows enter with their derivatives, and with value zero.
    scores, ends = step_scores(values, episode), jnp.arange(1, len(values) + 1)
    earlier = (ends % settings.window == 0) & (ends < episode.horizon)
    return score + jnp.sum(jnp.where(earlier, scores - jax.lax.stop_gradient(scores), 0.0))


def epoch(
    problem: Problem, scenes: SceneSettings, settings: TrainingSettings, learner: Learner, key: Key
) -> tuple[Learner, EpochReport]:
    """One step of ascent on a new batch; the random numbers of epoch i depend on (key, i) alone."""
    parameters, rest = eqx.partition(learner.policy, eqx.is_inexact_array)
    episode_key, policy_key = jax.random.split(jax.random.fold_in(key, learner.epoch))
    keys = [jax.random.split(k, settings.episodes) for k in (episode_key, policy_key)]

    def loss(scenes: SceneSettings, parameters, episode):
        episode_key, policy_key, targets = episode
        drawn = training_episode(problem, scenes, episode_key, settings.noise, targets=targets)
        return -objective(problem, eqx.combine(parameters, rest), drawn, settings, policy_key)

    groups, end = [], 0
    for stratum, share in zip(strata(scenes, settings.episodes), shares(settings, scenes), strict=True):
        begin, end = end, end + share.episodes
        episodes = (*(k[begin:end] for k in keys), jnp.asarray(stratum.targets))
        groups.append(Group(functools.partial(loss, stratum.scenes), episodes, share))
    value, gradient = mean_and_gradient(groups, parameters)
    norm = optax.tree.norm(gradient)
    updates, state = optimizer(settings).update(gradient, learner.optimizer, parameters)
    policy = eqx.apply_updates(learner.policy, updates)
    report = EpochReport(-value, norm, jnp.isfinite(value) & jnp.isfinite(norm))
    return Learner(policy, state, learner.epoch + 1), report
