"""Train a policy with one of the JAX learners: validate it, keep the best, roll back from collapses, resume."""

import time
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp

from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings, PPOSettings, TrainingSettings
from foveate.experiment.run_folder import Outcome, Validation
from foveate.learning import actor_critic, policy_gradient
from foveate.learning.devices import from_first_process, on_all_devices, sharded
from foveate.learning.learner import EpochReport, Learner, run_epochs
from foveate.learning.run_files import resume_run, start_run
from foveate.learning.selection import Progress, decide
from foveate.learning.tensorboard import Events
from foveate.learning.validation import OnValidation, held_out_episodes, no_report, validate
from foveate.models.problem import Problem
from foveate.policies.pointer import PointerPolicy
from foveate.simulation.records import Policy
from foveate.types import Count, Key

PLANAR_COMPILER_OPTIONS = {"xla_cpu_use_fusion_emitters": False} if jax.__version__.startswith("0.10.") else {}
"""For XLA, in the plane: compilation takes three quarters of the time, and the program runs no slower (in space it
would take 1.6 times as long). Other versions may not know the option."""


@jax.default_matmul_precision("highest")  # by default accelerators round factors to 10 bits
def train(
    experiment: Experiment, out: Path, seed: int = 0, resume: bool = False, on_validation: OnValidation = no_report
) -> Outcome:
    """Train a policy into the run folder `out`.

    The same experiment and seed give the same checkpoint, bit for bit, on the same machine, also of a training that was
    interrupted and resumed. Raises InputError if `out` already holds a run (or, resumed, another one).
    """
    problem, training = experiment.scenario.problem(), experiment.training
    if isinstance(training, PPOSettings):
        raise InputError(f"training.algorithm = {training.algorithm!r}: expected one of a JAX learner")
    policy_key, scenes_key, training_key, validation_key = jax.random.split(jax.random.key(seed), 4)
    begun = Progress.of(_begin(problem, experiment.policy.policy(problem, policy_key), training, policy_key))
    episodes = held_out_episodes(experiment, problem, scenes_key)
    files, progress, elapsed = (resume_run if resume else start_run)(out, experiment, seed, begun)
    advance = advance_of(experiment, problem)
    score_of = eqx.filter_jit(lambda policy, episodes, key: validate(experiment, problem, policy, episodes, key))
    began, stop_reason = time.perf_counter() - elapsed, None
    with Events(out, int(progress.learner.epoch) + 1 if resume else 0) as events:
        while stop_reason is None and (done := int(progress.learner.epoch)) < training.epochs:
            count, started = min(training.check_every, training.epochs - done), time.perf_counter()
            learner, report = advance(jnp.array(count), progress.learner, training_key)
            # Processes on different machines may round differently, but must decide alike.
            score, at_limit = from_first_process(*map(float, score_of(learner.policy, episodes, validation_key)))
            finite = bool(report.finite) and bool(jnp.isfinite(score))
            decision = decide(progress, learner, score, at_limit, finite, training)
            progress, stop_reason, ended = decision.progress, decision.stop_reason, time.perf_counter()
            validation = Validation(
                epoch=int(learner.epoch),
                objective=float(report.objective),
                gradient_norm=float(report.gradient_norm),
                held_out=score,
                at_limit=at_limit,
                best=decision.is_best,
                epochs_per_s=count / (ended - started),
                elapsed_s=ended - began,
                event=decision.event,
                env_steps=round(int(learner.epoch) * training.episodes * experiment.scenario.scenes.mean_horizon),
            )
            files.save(progress, validation, events)
            on_validation(validation, training.epochs)
    return _outcome(progress, stop_reason or "")


def _outcome(progress: Progress, stopped: str) -> Outcome:
    return Outcome(
        epochs=int(progress.learner.epoch),
        best_epoch=int(progress.best_epoch),
        best_score=float(progress.best_score),
        rollbacks=int(progress.rollbacks),
        stopped=stopped,
    )


def _begin(problem: Problem, policy: Policy, training: TrainingSettings | ActorCriticSettings, key: Key) -> Learner:
    if isinstance(training, ActorCriticSettings):
        return actor_critic.begin(problem, policy, training, jax.random.fold_in(key, 1))
    if isinstance(policy, PointerPolicy):
        raise InputError("policy.kind = 'pointer': expected training.algorithm = 'actor-critic', which samples modes")
    return policy_gradient.begin(policy, training)


def advance_of(experiment: Experiment, problem: Problem) -> Callable:
    """Compiled function of (count, learner, key) that trains for `count` epochs.

    The key is an argument, not a constant, so that all seeds share one compiled program.
    """
    scenes, training = experiment.scenario.scenes, experiment.training

    def epoch(learner: Learner, key: Key) -> tuple[Learner, EpochReport]:
        if isinstance(training, ActorCriticSettings):
            return actor_critic.epoch(problem, scenes, training, learner, key)
        assert isinstance(training, TrainingSettings), "PPO of Stable-Baselines3 has its own loop"
        return policy_gradient.epoch(problem, scenes, training, learner, key)

    def epochs(count: Count, learner: Learner, key: Key) -> tuple[Learner, EpochReport]:
        return run_epochs(epoch, count, learner, key)

    if not isinstance(training, TrainingSettings):
        # Minibatches of the actor-critic are shuffled steps of all episodes: they run on one device.
        return eqx.filter_jit(epochs)
    micro_batch = policy_gradient.micro_batch_size(training, scenes)
    devices = sharded(training.episodes, micro_batch).devices
    options = PLANAR_COMPILER_OPTIONS if problem.agent.space.dimension == 2 else {}
    return on_all_devices(jax.jit(epochs, compiler_options=options), devices)
