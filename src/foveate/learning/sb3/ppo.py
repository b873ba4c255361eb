"""Train by PPO of Stable-Baselines3 (extra `ppo`), the model-free baseline of the paper.

Episodes, features, network, limits, held-out scenes and run folder are those of the policy gradient; the best policy is
saved as JAX arrays.
"""

# Without the extra `ppo` there is no torch to check against.
# pyright: reportMissingImports=false

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import equinox as eqx
import jax
import numpy as np

from foveate.errors import InputError
from foveate.experiment.checkpoint import write_config
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PPOSettings
from foveate.experiment.run_folder import Outcome, Validation, claim
from foveate.learning.run_files import RunFiles
from foveate.learning.tensorboard import Events
from foveate.learning.validation import OnValidation, held_out_episodes, no_report, validate
from foveate.policies.attention import AttentionSettings
from foveate.simulation.environment import Environment

if TYPE_CHECKING:
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback

LOG_INTERVAL_UPDATES = 10**9
"""Updates between two lines of Stable-Baselines3's log: more than a training has, since our log replaces it."""


class _Validator:
    """Validates the actor, keeps the best one, and writes the files of the run."""

    def __init__(self, files: RunFiles, events: Events, on_validation: OnValidation) -> None:
        experiment = files.experiment
        problem = experiment.scenario.problem()
        # The JAX learners hold out the same scenes for the same seed.
        _, scenes_key, _, key = jax.random.split(jax.random.key(files.seed), 4)
        episodes = held_out_episodes(experiment, scenes_key)
        score_of = eqx.filter_jit(lambda policy, episodes: validate(experiment, policy, episodes, key))
        self.problem, self.score_of = problem, lambda policy: score_of(policy, episodes)
        self.files, self.events, self.on_validation = files, events, on_validation
        self.best_score, self.best_epoch, self.epoch, self.stop_reason = -math.inf, 0, 0, ""
        self.scores: list[float] = []
        self.began = self.last_time = time.perf_counter()
        self.last_epoch = 0

    def validate(self, model: "PPO", training: PPOSettings) -> None:
        """Validate the actor once; set `stop_reason` if a number is not finite."""
        from foveate.learning.sb3.network import ActorAndCritic, to_jax

        policy = to_jax(cast(ActorAndCritic, model.policy).actor, self.problem, network_of(self.files.experiment))
        held_out, at_limit = (float(x) for x in self.score_of(policy))
        # Weights that are not finite may give a finite score by tanh and the limits of the agent.
        finite = _is_finite(model) and math.isfinite(held_out)
        best = finite and held_out > self.best_score
        ended = time.perf_counter()
        validation = Validation(
            epoch=self.epoch,
            objective=float(np.mean(self.scores)) if self.scores else math.nan,
            gradient_norm=None,
            held_out=held_out,
            at_limit=at_limit,
            best=best,
            epochs_per_s=(self.epoch - self.last_epoch) / (ended - self.last_time),
            elapsed_s=ended - self.began,
            event="" if finite else "not finite",
            env_steps=model.num_timesteps,
        )
        self.last_time, self.last_epoch, self.scores = ended, self.epoch, []
        if best:
            self.best_score, self.best_epoch = held_out, self.epoch
            self.files.save_best(policy, validation)
        if not finite:
            self.stop_reason = f"iteration {self.epoch}: a weight or score was not finite; the best is kept"
        self.files.append(validation, self.events)
        self.events.add({name: float(value) for name, value in model.logger.name_to_value.items()}, self.epoch)
        self.on_validation(validation, training.steps)


def train(experiment: Experiment, out: Path, seed: int = 0, on_validation: OnValidation = no_report) -> Outcome:
    """Train a policy by PPO into the run folder `out`, and keep the best on held-out scenes.

    The same experiment and seed give the same checkpoint on the same machine. Seeds the generators of Python, numpy and
    torch. Raises InputError if `out` already holds a run, the experiment is not one of PPO, or Stable-Baselines3 is not
    installed.
    """
    training = experiment.training
    if not isinstance(training, PPOSettings):
        raise InputError("training.algorithm is missing: expected 'ppo'")
    network_of(experiment)
    _require_extra()
    claim(out, experiment)
    write_config(out, experiment)
    files = RunFiles(out=out, experiment=experiment, seed=seed)
    with Events(out) as events, _one_thread():
        validator = _Validator(files, events, on_validation)
        model = make_ppo(experiment, training, seed)
        try:
            model.learn(training.steps, _callback(validator, training), log_interval=LOG_INTERVAL_UPDATES)
        except ValueError as error:
            # torch rejects a Gaussian whose mean is not a number.
            if _is_finite(model):
                raise
            reason = f"a weight was not finite ({type(error).__name__})"
            validator.stop_reason = f"iteration {validator.epoch}: {reason}; the best is kept"
    return Outcome(
        epochs=validator.epoch,
        best_epoch=validator.best_epoch,
        best_score=validator.best_score,
        rollbacks=0,
        stopped=validator.stop_reason,
    )


def network_of(experiment: Experiment) -> AttentionSettings:
    """The network that PPO trains. Raises InputError for one that is not implemented in PyTorch."""
    if not isinstance(experiment.policy, AttentionSettings):
        raise InputError(f"policy.kind = '{experiment.policy.kind}': expected 'attention', the network that PPO trains")
    return experiment.policy


def make_ppo(experiment: Experiment, training: PPOSettings, seed: int) -> "PPO":
    """Build Stable-Baselines3's PPO on the experiment's environments, before its first step."""
    from stable_baselines3 import PPO

    from foveate.learning.sb3.network import ActorAndCritic
    from foveate.learning.sb3.vec_env import TargetsVecEnv

    problem = experiment.scenario.problem()
    environment = Environment(problem, experiment.scenario.scenes, training.protocol, training.noise)
    key, network, rate = jax.random.key(seed), network_of(experiment), training.learning_rate
    # The last rollout may pass the number of steps: the share left, which the schedule follows, then falls below 0.
    return PPO(
        ActorAndCritic,
        TargetsVecEnv(environment, network, training.environments, key, training.reward_scale),
        learning_rate=rate if training.schedule == "constant" else lambda left: rate * max(left, 0.0),
        n_steps=training.rollout_steps,
        batch_size=training.batch,
        n_epochs=training.update_epochs,
        gamma=training.discount,
        gae_lambda=training.gae_lambda,
        clip_range=training.clip,
        ent_coef=training.entropy_weight,
        vf_coef=training.value_weight,
        max_grad_norm=training.gradient_bound,
        policy_kwargs={
            "problem": problem,
            "settings": network,
            "critic_sees_time": training.critic_sees_time,
            "log_std_init": training.log_std,
        },
        seed=seed,
        device="cpu",
    )


def _callback(validator: _Validator, training: PPOSettings) -> "BaseCallback":
    from stable_baselines3.common.callbacks import BaseCallback

    class Validations(BaseCallback):
        """Counts updates, collects final scores; validates after the update that completes `check_every` more steps."""

        model: Any
        due = training.check_every

        def _on_step(self) -> bool:
            validator.scores += [info["score"] for info in self.locals["infos"] if info]
            return not validator.stop_reason

        def _on_rollout_start(self) -> None:
            # Each rollout but the first begins after an update.
            if self.num_timesteps:
                self._on_training_end()

        def _on_training_end(self) -> None:
            validator.epoch += 1
            if self.num_timesteps >= self.due or self.num_timesteps >= training.steps:
                validator.validate(self.model, training)
                self.due += training.check_every

    return Validations()


def _is_finite(model: "PPO") -> bool:
    return all(bool(weight.isfinite().all()) for weight in model.policy.parameters())


def _require_extra() -> None:
    try:
        import stable_baselines3  # noqa: F401
    except ImportError as error:
        raise InputError(f"PPO needs Stable-Baselines3 ({error}): pip install 'foveate[ppo]'") from error


@contextmanager
def _one_thread() -> Iterator[None]:
    """Run torch on one thread: networks this small are slower on several."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
