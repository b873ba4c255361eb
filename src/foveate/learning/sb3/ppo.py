"""The paper's rival: proximal policy optimisation, model-free, by Stable-Baselines3 (extra `ppo`).

It learns on the same episodes, from the same numbers, with the same network and limits as the policy gradient, is
judged on the same held-out scenes as often, and its best policy is kept in the same run folder, as JAX arrays.
"""

# Without the extra `ppo` there is no torch to check against.
# pyright: reportMissingImports=false

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import equinox as eqx
import jax
import numpy as np

from foveate.errors import InputError
from foveate.experiment.checkpoint import save_tree, write_config
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PPOSettings
from foveate.experiment.run_folder import BEST, Outcome, Validation, claim
from foveate.learning.tensorboard import Events
from foveate.learning.validation import held_out_episodes, judge, write_validation
from foveate.policies.attention import AttentionSettings
from foveate.simulation.environment import Environment

if TYPE_CHECKING:
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback


NEVER = 10**9
"""Updates after which Stable-Baselines3 writes its own log, were it asked for one."""


Report = Callable[[Validation, int], None]


class _Validator:
    """Judges the actor of a PPO now and then, keeps the best, and writes it all down."""

    def __init__(self, experiment: Experiment, out: Path, seed: int, report: Report, events: Events) -> None:
        problem = experiment.scenario.problem()
        keys = jax.random.split(jax.random.key(seed), 4)  # as the policy gradient: the same scenes are held out
        episodes = held_out_episodes(experiment, problem, keys[1])
        assess = eqx.filter_jit(lambda policy, episodes: judge(experiment, problem, policy, episodes, keys[3]))
        self.problem, self.assess = problem, lambda policy: assess(policy, episodes)
        self.experiment, self.out, self.seed, self.report, self.events = experiment, out, seed, report, events
        self.best_score, self.best_epoch, self.epoch, self.stopped = -math.inf, 0, 0, ""
        self.scores: list[float] = []
        self.began = self.last = time.perf_counter()
        self.last_epoch = 0

    def check(self, model: "PPO", training: PPOSettings) -> None:
        """One check; sets `stopped` where a number is not finite."""
        from foveate.learning.sb3.network import ActorAndCritic, to_jax

        policy = to_jax(cast(ActorAndCritic, model.policy).actor, self.problem, network_of(self.experiment))
        held_out, at_limit = (float(x) for x in self.assess(policy))
        finite = _is_finite(model) and math.isfinite(held_out)
        best = finite and held_out > self.best_score
        now = time.perf_counter()
        check = Validation(
            epoch=self.epoch,
            objective=float(np.mean(self.scores)) if self.scores else math.nan,
            gradient_norm=None,
            held_out=held_out,
            at_limit=at_limit,
            best=best,
            epochs_per_s=(self.epoch - self.last_epoch) / (now - self.last),
            elapsed_s=now - self.began,
            event="" if finite else "not finite",
            env_steps=model.num_timesteps,
        )
        self.last, self.last_epoch, self.scores = now, self.epoch, []
        if best:
            self.best_score, self.best_epoch = held_out, self.epoch
            facts = {"seed": self.seed, "epoch": self.epoch, "held_out": held_out}
            save_tree(self.out / BEST, policy, self.experiment, "policy", facts)
        if not finite:
            self.stopped = f"epoch {self.epoch}: a weight or score was not finite; the best is kept"
        write_validation(self.out, check, self.events)
        self.events.add({name: float(value) for name, value in model.logger.name_to_value.items()}, self.epoch)
        self.report(check, training.steps)


def train(experiment: Experiment, out: Path, seed: int = 0, report: Report = lambda check, total: None) -> Outcome:
    """Train a policy by PPO into the run folder `out`; `report` is called at every check, with the steps of all.

    The same experiment and seed give the same checkpoint on the same machine. The policy that is kept is the best on
    held-out scenes, as with the policy gradient; the last line of the metrics tells how the final one did. Seeds the
    generators of Python, numpy and torch. Raises ValueError where `out` holds a run already, where the experiment
    is not one of PPO, and where Stable-Baselines3 is not installed.
    """
    training = experiment.training
    if not isinstance(training, PPOSettings):
        raise InputError("training.algorithm is missing: expected 'ppo'")
    network_of(experiment)
    _require_extra()
    claim(out, experiment)
    write_config(out, experiment)
    with Events(out) as events, _one_thread():
        judge = _Validator(experiment, out, seed, report, events)
        model = make_ppo(experiment, training, seed)
        try:
            model.learn(training.steps, _callback(judge, training), log_interval=NEVER)
        except ValueError as error:
            # torch rejects a Gaussian whose mean is not a number.
            if _is_finite(model):
                raise
            judge.stopped = f"epoch {judge.epoch}: a weight was not finite ({type(error).__name__}); the best is kept"
    return Outcome(
        epochs=judge.epoch,
        best_epoch=judge.best_epoch,
        best_score=judge.best_score,
        rollbacks=0,
        stopped=judge.stopped,
    )


def network_of(experiment: Experiment) -> AttentionSettings:
    """The network that PPO trains. Raises ValueError for one that has no twin in PyTorch here."""
    if not isinstance(experiment.policy, AttentionSettings):
        raise InputError(f"policy.kind = '{experiment.policy.kind}': expected 'attention', the network that PPO trains")
    return experiment.policy


def make_ppo(experiment: Experiment, training: PPOSettings, seed: int) -> "PPO":
    """Stable-Baselines3's PPO on the experiment's environments, before its first step."""
    from stable_baselines3 import PPO

    from foveate.learning.sb3.network import ActorAndCritic
    from foveate.learning.sb3.vec_env import TargetsVecEnv

    problem = experiment.scenario.problem()
    environment = Environment(problem, experiment.scenario.scenes, training.protocol, training.noise)
    vec_env = TargetsVecEnv(
        environment, network_of(experiment), training.environments, jax.random.key(seed), training.reward_scale
    )
    rate = training.learning_rate
    return PPO(
        ActorAndCritic,
        vec_env,
        learning_rate=rate if training.schedule == "constant" else lambda left: rate * max(left, 0.0),
        n_steps=training.rollout_steps,
        batch_size=training.batch,
        n_epochs=training.passes,
        gamma=training.discount,
        gae_lambda=training.gae_lambda,
        clip_range=training.clip,
        ent_coef=training.entropy_weight,
        vf_coef=training.value_weight,
        max_grad_norm=training.gradient_bound,
        policy_kwargs={
            "problem": problem,
            "settings": network_of(experiment),
            "critic_sees_time": training.critic_sees_time,
            "log_std_init": training.log_std,
        },
        seed=seed,
        device="cpu",
    )


def _callback(judge: _Validator, training: PPOSettings) -> "BaseCallback":
    from stable_baselines3.common.callbacks import BaseCallback

    class Checks(BaseCallback):
        """Counts updates and final scores; checks after the update that fills a multiple of `check_every` steps."""

        model: Any
        due = training.check_every

        def _on_step(self) -> bool:
            judge.scores += [info["score"] for info in self.locals["infos"] if info]
            return not judge.stopped

        def _on_rollout_start(self) -> None:
            # Each rollout but the first begins after an update.
            if self.num_timesteps:
                self._updated()

        def _on_training_end(self) -> None:
            self._updated()

        def _updated(self) -> None:
            judge.epoch += 1
            if self.num_timesteps >= self.due or self.num_timesteps >= training.steps:
                judge.check(self.model, training)
                self.due += training.check_every

    return Checks()


def _is_finite(model: "PPO") -> bool:
    return all(bool(weight.isfinite().all()) for weight in model.policy.parameters())


def _require_extra() -> None:
    try:
        import stable_baselines3  # noqa: F401
    except ImportError as error:
        raise InputError(f"PPO needs Stable-Baselines3 ({error}): pip install 'foveate[ppo]'") from error


@contextmanager
def _one_thread() -> Iterator[None]:
    """Networks this small run faster on one thread than on several."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
