"""Decide how a training continues after a validation: keep a better policy, roll back from a collapse, or stop."""

from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import optax

from foveate.experiment.learners import ActorCriticSettings, TrainingSettings
from foveate.learning.learner import Learner

SATURATED_SHARE = 0.9
"""Share of commands with every axis at a limit above which a policy is saturated: tanh has no gradient there, so
training cannot recover by itself."""


COLLAPSED_SCORE = 1.0
"""A held-out score this far [nat per target] below the best counts towards a collapse."""


COLLAPSED_SEEN = 0.5
"""The same where the objective is time in view: below this share of the best."""


COLLAPSED_VALIDATIONS = 10
"""Consecutive validations far below the best that make a collapse: a few may be noise, or a detour."""


MAX_ROLLBACKS = 3
"""Collapses after which a training rolls back to its best; the next one ends it."""


class Progress(eqx.Module):
    """State of a training, enough to resume it exactly; saved at every validation.

    `best` is the learner of the best validation so far, `below` the number of consecutive validations far below it.
    """

    learner: Learner
    best: Learner
    best_score: jax.Array
    best_epoch: jax.Array
    below: jax.Array
    rollbacks: jax.Array

    @classmethod
    def of(cls, learner: Learner) -> "Progress":
        """The state before the first epoch."""
        zero = jnp.zeros((), int)
        return cls(
            learner=learner, best=learner, best_score=jnp.array(-jnp.inf), best_epoch=zero, below=zero, rollbacks=zero
        )


@dataclass(frozen=True, kw_only=True)
class Decision:
    """What follows a validation. A `stop_reason` ends the training; None continues it from `progress`."""

    progress: Progress
    is_best: bool = False
    event: str = ""
    stop_reason: str | None = None


def decide(
    progress: Progress,
    learner: Learner,
    score: float,
    at_limit: float,
    finite: bool,
    training: TrainingSettings | ActorCriticSettings,
) -> Decision:
    """Choose what follows the validation of `learner`.

    Args:
        progress: State at the previous validation.
        learner: Learner after the epochs since then.
        score: Its held-out score [nat per target, or share of time in view].
        at_limit: Share of its held-out commands with every axis at a limit.
        finite: Whether all gradients and the score were finite.
        training: Settings of the learner.
    """
    if not finite:
        return _stop_not_finite(progress, learner)
    saturated = at_limit > SATURATED_SHARE
    has_best = bool(jnp.isfinite(progress.best_score))
    # A saturated policy never replaces a best one, however well it scores: no training leads on from it. But the first
    # finite validation is kept whatever it is, so that every run has a policy.
    if score > float(progress.best_score) and not (saturated and has_best):
        return _keep_best(progress, learner, score)
    below = int(progress.below) + 1 if _is_far_below(score, float(progress.best_score), training.objective) else 0
    if not saturated and below < COLLAPSED_VALIDATIONS:
        return Decision(progress=replace(progress, learner=learner, below=jnp.array(below)))
    why = f"{at_limit:.0%} of commands at a limit" if saturated else f"held-out score {score:.2f} for {below} checks"
    if int(progress.rollbacks) == MAX_ROLLBACKS:
        return _give_up(progress, learner, why)
    return _roll_back(progress, learner, why, training)


def _is_far_below(score: float, best: float, objective: str) -> bool:
    return score < (COLLAPSED_SEEN * best if objective == "seen" else best - COLLAPSED_SCORE)


def _stop_not_finite(progress: Progress, learner: Learner) -> Decision:
    return Decision(
        progress=replace(progress, learner=progress.best),
        event="not finite",
        stop_reason=f"epoch {int(learner.epoch)}: a gradient or score was not finite; the best is kept",
    )


def _keep_best(progress: Progress, learner: Learner, score: float) -> Decision:
    return Decision(
        progress=Progress(
            learner=learner,
            best=learner,
            best_score=jnp.array(score),
            best_epoch=learner.epoch,
            below=jnp.zeros((), int),
            rollbacks=progress.rollbacks,
        ),
        is_best=True,
    )


def _give_up(progress: Progress, learner: Learner, why: str) -> Decision:
    return Decision(
        progress=progress,
        event="collapse",
        stop_reason=f"epoch {int(learner.epoch)}: collapsed ({why}) again after {MAX_ROLLBACKS} rollbacks to the best",
    )


def _roll_back(
    progress: Progress, learner: Learner, why: str, training: TrainingSettings | ActorCriticSettings
) -> Decision:
    # The epoch and the optimizer's step count keep counting: training from the best then meets other scenes than those
    # that led to the collapse, and a falling learning rate stays low.
    updates = (learner.epoch * training.updates).astype(jnp.int32)
    optimizer = optax.tree.set(progress.best.optimizer, count=updates)
    restored = replace(progress.best, optimizer=optimizer, epoch=learner.epoch)
    return Decision(
        progress=replace(progress, learner=restored, below=jnp.zeros((), int), rollbacks=progress.rollbacks + 1),
        event=f"collapse ({why}): back to epoch {int(progress.best_epoch)}",
    )
