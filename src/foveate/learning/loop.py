"""Train a policy with one of the JAX learners: validate it, keep the best, roll back from collapses, resume."""

import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp

from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.experiment.first_policy import first_policy
from foveate.experiment.learners import ActorCriticSettings, PPOSettings, TrainingSettings
from foveate.experiment.run_folder import Outcome, Validation
from foveate.io.jax_settings import compiled, quick_compilation
from foveate.learning import actor_critic, policy_gradient
from foveate.learning.devices import from_first_process, on_all_devices, schedule
from foveate.learning.feature_range import with_feature_range
from foveate.learning.learner import EpochReport, Learner, run_epochs
from foveate.learning.preference import best_preference
from foveate.learning.run_files import resume_run, start_run
from foveate.learning.selection import Decision, Progress, decide
from foveate.learning.shards import devices_for
from foveate.learning.tensorboard import Events
from foveate.learning.validation import OnValidation, held_out_episodes, no_report, validate
from foveate.learning.worlds import worlds_of
from foveate.models.precision import suits_quick_compilation
from foveate.policies.pointer import PointerPolicy
from foveate.simulation.records import Policy
from foveate.types import Count, Key

NO_REPORT = EpochReport(jnp.array(jnp.nan), jnp.array(jnp.nan), jnp.array(True))
"""Of a policy before its first iteration."""

PLANAR_COMPILER_OPTIONS = quick_compilation() | {"xla_backend_optimization_level": 1}
"""For XLA, in the plane: compilation takes half the time, and the program runs no slower (in space, without the first
option, it would take 1.6 times as long)."""


@jax.default_matmul_precision("highest")  # by default accelerators round factors to 10 bits
def train(
    experiment: Experiment, out: Path, seed: int = 0, resume: bool = False, on_validation: OnValidation = no_report
) -> Outcome:
    """Train a policy into the run folder `out`.

    The same experiment and seed give the same checkpoint, bit for bit, on the same machine, also of a training that was
    interrupted and resumed. Raises InputError if `out` already holds a run (or, resumed, another one).
    """
    training = experiment.training
    if isinstance(training, PPOSettings):
        raise InputError(f"training.algorithm = {training.algorithm!r}: expected one of a JAX learner")
    policy_key, scenes_key, training_key, validation_key = jax.random.split(jax.random.key(seed), 4)
    episodes = held_out_episodes(experiment, scenes_key)
    quick = suits_quick_compilation(experiment.scenario.problem())
    score_of = compiled(lambda policy, episodes, key: validate(experiment, policy, episodes, key), quick)
    policy = first_policy(experiment, policy_key)
    if not resume and isinstance(policy, PointerPolicy) and not experiment.begins_with:
        policy = best_preference(policy, lambda policy: score_of(policy, episodes, validation_key)[0])
    if not resume and isinstance(policy, PointerPolicy) and policy.feature_range is not None:
        assert isinstance(training, ActorCriticSettings), "no other learner trains pointer networks"
        policy = with_feature_range(worlds_of(experiment), policy, training, jax.random.fold_in(policy_key, 2))
    begun = Progress.of(_begin(experiment, policy, policy_key))
    files, progress, elapsed = (resume_run if resume else start_run)(out, experiment, seed, begun)
    advance = advance_of(experiment)
    began, stop_reason = time.perf_counter() - elapsed, None

    def validated(learner: Learner, report: EpochReport, count: int, started: float) -> tuple[Decision, Validation]:
        # Processes on different machines may round differently, but must decide alike.
        score, at_limit = from_first_process(*map(float, score_of(learner.policy, episodes, validation_key)))
        finite = bool(report.finite) and bool(jnp.isfinite(score))
        decision = decide(progress, learner, score, at_limit, finite, training, float(report.gradient_norm))
        ended = time.perf_counter()
        facts = {"held_out": score, "at_limit": at_limit, "epochs_per_s": count / (ended - started)}
        return decision, _validation(experiment, learner, report, decision, **facts, elapsed_s=ended - began)

    first = int(progress.learner.epoch)
    with Events(out, first + 1 if resume else 0) as events:
        if not progress.is_validated and isinstance(training, ActorCriticSettings):
            # The untrained policy is a heuristic already: a training never ends below it.
            decision, validation = validated(progress.learner, NO_REPORT, 0, time.perf_counter())
            progress = decision.progress
            files.save(progress, validation, events)
        while stop_reason is None and (done := int(progress.learner.epoch)) < training.epochs:
            count, started = min(training.check_every, training.epochs - done), time.perf_counter()
            learner, report = advance(jnp.array(count), progress.learner, training_key)
            decision, validation = validated(learner, report, count, started)
            progress, stop_reason = decision.progress, decision.stop_reason
            files.save(progress, validation, events)
            on_validation(validation, training.epochs)
    return _outcome(progress, stop_reason or "")


def _validation(
    experiment: Experiment, learner: Learner, report: EpochReport, decision: Decision, **facts: float
) -> Validation:
    return Validation(
        epoch=int(learner.epoch),
        objective=float(report.objective),
        gradient_norm=float(report.gradient_norm),
        best=decision.is_best,
        event=decision.event,
        env_steps=round(int(learner.epoch) * _decisions(experiment)),
        **facts,
    )


def _decisions(experiment: Experiment) -> float:
    """Expected decisions of an iteration."""
    training = experiment.training
    if isinstance(training, ActorCriticSettings):
        return float(sum(training.decisions(world.scenes, world.agents) for world in worlds_of(experiment)))
    assert isinstance(training, TrainingSettings), "PPO of Stable-Baselines3 has its own loop"
    return training.episodes * experiment.scenario.scenes.mean_horizon


def _outcome(progress: Progress, stopped: str) -> Outcome:
    return Outcome(
        epochs=int(progress.learner.epoch),
        best_epoch=int(progress.best_epoch),
        best_score=float(progress.best_score),
        rollbacks=int(progress.rollbacks),
        stopped=stopped,
    )


def _begin(experiment: Experiment, policy: Policy, key: Key) -> Learner:
    training = experiment.training
    if isinstance(training, ActorCriticSettings):
        return actor_critic.begin(worlds_of(experiment), policy, training, jax.random.fold_in(key, 1))
    assert isinstance(training, TrainingSettings), "PPO of Stable-Baselines3 has its own loop"
    if (team := experiment.scenario.team) is not None and team.agents > 1:
        right = "expected 1, or training.algorithm = 'actor-critic', which trains teams"
        raise InputError(f"scenario.team.agents = {team.agents}: {right}")
    if isinstance(policy, PointerPolicy):
        raise InputError("policy.kind = 'pointer': expected training.algorithm = 'actor-critic', which samples modes")
    return policy_gradient.begin(policy, training)


def advance_of(experiment: Experiment) -> Callable:
    """Compiled function of (count, learner, key) that trains for `count` epochs.

    The key is an argument, not a constant, so that all seeds share one compiled program.
    """
    scenes, training = experiment.scenario.scenes, experiment.training
    problem, worlds = experiment.scenario.problem(), worlds_of(experiment)

    def epoch(learner: Learner, key: Key) -> tuple[Learner, EpochReport]:
        if isinstance(training, ActorCriticSettings):
            return actor_critic.epoch(worlds, training, learner, key)
        assert isinstance(training, TrainingSettings), "PPO of Stable-Baselines3 has its own loop"
        return policy_gradient.epoch(problem, scenes, training, learner, key)

    def epochs(count: Count, learner: Learner, key: Key) -> tuple[Learner, EpochReport]:
        return run_epochs(epoch, count, learner, key)

    if not isinstance(training, TrainingSettings):
        return on_all_devices(jax.jit(epochs), devices_for(actor_critic.SHARDS))
    devices = schedule(policy_gradient.shares(training, scenes)).devices
    options = PLANAR_COMPILER_OPTIONS if suits_quick_compilation(problem) else {}
    return on_all_devices(jax.jit(epochs, compiler_options=options), devices)
