"""Training that survives: the loop around the learner. It judges, keeps the best, notices collapse, and can go on."""

import json
import time
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import optax

from foveate.errors import InputError
from foveate.experiment.checkpoint import VERSION, load_tree, save_tree, write_config
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings, PPOSettings, TrainingSettings
from foveate.experiment.run_folder import BEST, CONFIG, LAST, METRICS, Outcome, Validation, claim
from foveate.io.files import read_text, write_atomic
from foveate.io.npz import load_arrays
from foveate.io.toml import load_toml, read_toml
from foveate.learning import actor_critic, policy_gradient
from foveate.learning.devices import agreed, on_all_devices, sharded
from foveate.learning.learner import Learner, Report, epochs
from foveate.learning.tensorboard import Events
from foveate.learning.validation import held_out_episodes, judge, write_validation
from foveate.models.problem import Problem
from foveate.policies.pointer import PointerPolicy
from foveate.simulation.records import Policy
from foveate.types import Count, Key

Learning = TrainingSettings | ActorCriticSettings


QUICKLY = {"xla_cpu_use_fusion_emitters": False} if jax.__version__.startswith("0.10.") else {}
"""For XLA, in the plane: compiles in three quarters of the time what runs no slower (in space it runs 1.6 times as
long). Other versions may not know it."""


COLLAPSED_SHARE = 0.9


COLLAPSED_SCORE = 1.0


COLLAPSED_SEEN = 0.5
"""A held-out score this far [nat per target] below its best, or this share of the best time in view, for
COLLAPSED_VALIDATIONS checks in a row, is a collapse."""


COLLAPSED_VALIDATIONS = 10


ROLLBACKS = 3
"""How often a collapsed training goes back to its best before it gives up."""


class Progress(eqx.Module):
    """All that a training needs to go on exactly where it was; saved at every check."""

    learner: Learner
    best: Learner
    best_score: jax.Array
    best_epoch: jax.Array
    below: jax.Array
    rollbacks: jax.Array


@jax.default_matmul_precision("highest")  # accelerators round factors to 10 bits by themselves
def train(
    experiment: Experiment,
    out: Path,
    seed: int = 0,
    resume: bool = False,
    report: Callable[[Validation, int], None] = lambda check, total: None,
) -> Outcome:
    """Train a policy into the run folder `out`; `report` is called at every check.

    The same experiment and seed give the same checkpoint, bit for bit, on the same machine, also when the training
    was interrupted and resumed. Raises ValueError where `out` already holds a run (or, resumed, another one).
    """
    problem, training = experiment.scenario.problem(), experiment.training
    if isinstance(training, PPOSettings):
        raise InputError(f"training.algorithm = {training.algorithm!r}: expected one that learns here")
    keys = jax.random.split(jax.random.key(seed), 4)
    learner = _begin(problem, experiment.policy.policy(problem, keys[0]), training, keys[0])
    if not resume:
        claim(out, experiment)
    zero = jnp.zeros((), int)
    progress = Progress(learner, learner, jnp.array(-jnp.inf), zero, zero, zero)
    episodes = held_out_episodes(experiment, problem, keys[1])
    elapsed, content = 0.0, None
    if resume:
        progress, elapsed, content = _resumed(out, experiment, seed, progress)
    else:
        save_tree(out / LAST, progress, experiment, "training", {"seed": seed, "epoch": 0, "elapsed_s": 0.0})
        write_config(out, experiment)
    advance = advance_of(experiment, problem)
    assess = eqx.filter_jit(lambda policy, episodes, key: judge(experiment, problem, policy, episodes, key))
    began, stopped = time.perf_counter() - elapsed, ""
    with Events(out, int(progress.learner.epoch) + 1 if resume else 0) as events:
        while not stopped and (done := int(progress.learner.epoch)) < training.epochs:
            count = min(training.check_every, training.epochs - done)
            started = time.perf_counter()
            learner, numbers = advance(jnp.array(count), progress.learner, keys[2])
            score, at_limit = agreed(*(float(x) for x in assess(learner.policy, episodes, keys[3])))
            finite = bool(numbers.finite) and jnp.isfinite(score)
            progress, event, stopped = _next(progress, learner, score, at_limit, bool(finite), training)
            now = time.perf_counter()
            check = Validation(
                epoch=int(learner.epoch),
                objective=float(numbers.objective),
                gradient_norm=float(numbers.gradient_norm),
                held_out=score,
                at_limit=at_limit,
                best=not stopped and int(progress.best_epoch) == int(learner.epoch),
                epochs_per_s=count / (now - started),
                elapsed_s=now - began,
                event=event,
                env_steps=round(int(learner.epoch) * training.episodes * experiment.scenario.scenes.mean_horizon),
            )
            _keep(out, experiment, seed, progress, check, events, content)
            report(check, training.epochs)
    return Outcome(
        epochs=int(progress.learner.epoch),
        best_epoch=int(progress.best_epoch),
        best_score=float(progress.best_score),
        rollbacks=int(progress.rollbacks),
        stopped=stopped,
    )


def _begin(problem: Problem, policy: Policy, training: Learning, key: Key) -> Learner:
    """The learner before its first epoch."""
    if isinstance(training, ActorCriticSettings):
        return actor_critic.begin(problem, policy, training, jax.random.fold_in(key, 1))
    if isinstance(policy, PointerPolicy):
        raise InputError("policy.kind = 'pointer': expected training.algorithm = 'actor-critic', which tries its modes")
    return policy_gradient.begin(policy, training)


def advance_of(experiment: Experiment, problem: Problem) -> Callable:
    """The compiled function of (count, learner, key) that goes on by so many epochs.

    Keys and scenes are arguments, not constants, so that all seeds share one compiled program.
    """
    scenes, training = experiment.scenario.scenes, experiment.training

    def one(learner: Learner, key: Key) -> tuple[Learner, Report]:
        if isinstance(training, ActorCriticSettings):
            return actor_critic.epoch(problem, scenes, training, learner, key)
        assert isinstance(training, TrainingSettings), "of two settings with epochs this is the other"
        return policy_gradient.epoch(problem, scenes, training, learner, key)

    def several(count: Count, learner: Learner, key: Key) -> tuple[Learner, Report]:
        return epochs(one, count, learner, key)

    if not isinstance(training, TrainingSettings):
        # Learning by trying is not shared out: it runs on one device.
        return eqx.filter_jit(several)
    micro_batch = policy_gradient.micro_batch_size(training, scenes)
    devices = sharded(training.episodes, micro_batch).devices
    options = QUICKLY if problem.agent.space.dimension == 2 else {}
    return on_all_devices(jax.jit(several, compiler_options=options), devices)


def _is_low(score: float, best: float, objective: str) -> bool:
    """Far below the best: in nats, or where time in view is what counts, in shares of the best."""
    return score < (COLLAPSED_SEEN * best if objective == "seen" else best - COLLAPSED_SCORE)


def _next(
    progress: Progress, learner: Learner, score: float, at_limit: float, finite: bool, training: Learning
) -> tuple[Progress, str, str]:
    """What follows from one check: the progress to go on with, what happened, and why to stop (empty: go on)."""
    if not finite:
        kept = eqx.tree_at(lambda p: p.learner, progress, progress.best)
        return (
            kept,
            "not finite",
            f"epoch {int(learner.epoch)}: a gradient or score was not finite; the best is kept",
        )
    at_limits = at_limit > COLLAPSED_SHARE
    learned = bool(jnp.isfinite(progress.best_score))
    # The first finite check is kept whatever it is, so that every run has a policy.
    if score > float(progress.best_score) and not (at_limits and learned):
        zero = jnp.zeros((), int)
        best = (learner, learner, jnp.array(score), learner.epoch, zero)
        return Progress(*best, progress.rollbacks), "", ""
    below = int(progress.below) + 1 if _is_low(score, float(progress.best_score), training.objective) else 0
    if not at_limits and below < COLLAPSED_VALIDATIONS:
        held = (progress.best, progress.best_score, progress.best_epoch, jnp.array(below), progress.rollbacks)
        return Progress(learner, *held), "", ""
    why = f"{at_limit:.0%} of commands at a limit" if at_limits else f"held-out score {score:.2f} for {below} checks"
    if int(progress.rollbacks) == ROLLBACKS:
        return (
            progress,
            "collapse",
            f"epoch {int(learner.epoch)}: collapsed ({why}) once more after {ROLLBACKS} rollbacks to the best",
        )
    # The epoch goes on counting, so that the way back is walked on other scenes and the learning rate stays low.
    done = (learner.epoch * training.updates).astype(jnp.int32)
    count = optax.tree.set(progress.best.optimizer, count=done)
    back = eqx.tree_at(lambda best: (best.optimizer, best.epoch), progress.best, (count, learner.epoch))
    held = (progress.best, progress.best_score, progress.best_epoch, jnp.zeros((), int), progress.rollbacks + 1)
    return Progress(back, *held), f"collapse ({why}): back to epoch {int(progress.best_epoch)}", ""


def stored_run(run: Path) -> tuple[Experiment, int]:
    """The experiment and the seed that a run folder was trained with, to go on with it."""
    if not (run / CONFIG).exists():
        raise InputError(f"{run}: holds no training to go on with: begin one, with --out {run}")
    experiment = load_toml(Experiment, run / CONFIG)
    if isinstance(experiment.training, PPOSettings):
        raise InputError(f"{run}: was trained by PPO, which does not go on where it stopped: train anew")
    header, _ = load_arrays(run / LAST, "training", VERSION)
    return experiment, int(header["facts"]["seed"])


def _resumed(out: Path, experiment: Experiment, seed: int, like: Progress) -> tuple[Progress, float, str]:
    """Where a training was, how long it took so far, and the digest of its config.toml."""
    stored, content = read_toml(Experiment, out / CONFIG)
    if stored != experiment:
        raise InputError(f"{out}: was begun with another experiment: expected that of its {CONFIG}")
    progress, facts = load_tree(out / LAST, like, "training", content)
    if facts["seed"] != seed:
        raise InputError(f"{out}: was trained with --seed {facts['seed']}: expected the same, got {seed}")
    lines = read_text(out / METRICS, "metrics of a run").splitlines()
    epochs = [_epoch_of(out, lines, i) for i in range(len(lines))]
    kept = [line for line, epoch in zip(lines, epochs, strict=True) if epoch <= int(progress.learner.epoch)]
    write_atomic(out / METRICS, "".join(f"{line}\n" for line in kept).encode())
    return progress, float(facts["elapsed_s"]), content


def _epoch_of(out: Path, lines: list[str], i: int) -> int | float:
    """The epoch of a line of metrics; a last line that was cut while it was written counts as too late."""
    try:
        return int(json.loads(lines[i])["epoch"])
    except (ValueError, KeyError, TypeError) as error:
        if i < len(lines) - 1:
            raise InputError(f"{out / METRICS}: line {i + 1}: is damaged: delete it to go on without it") from error
        return float("inf")


def _keep(
    out: Path,
    experiment: Experiment,
    seed: int,
    progress: Progress,
    check: Validation,
    events: Events,
    content: str | None,
) -> None:
    facts = {"seed": seed, "epoch": check.epoch, "elapsed_s": check.elapsed_s}
    if check.best:
        # No time in it: the same experiment and seed give the same file.
        best = {"seed": seed, "epoch": check.epoch, "held_out": check.held_out}
        save_tree(out / BEST, progress.best.policy, experiment, "policy", best, content)
    # The last file decides how far the training is: killed before it is there, all that was written is written again.
    write_validation(out, check, events)
    save_tree(out / LAST, progress, experiment, "training", facts, content)
