"""Decide how a training continues after a validation: keep the best policy, roll back from a collapse, or stop."""

import math
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import optax

from foveate.experiment.learners import ActorCriticSettings, TrainingSettings
from foveate.learning.learner import Learner

SATURATED_SHARE = 0.9
"""Share of commands with every axis at a limit above which a policy gradient is saturated: tanh has no gradient there,
so training cannot recover by itself."""

COLLAPSED_SCORE = 1.0
"""A held-out score this far [nat per target] below the best counts towards a collapse."""

COLLAPSED_SEEN = 0.5
"""The same where the objective is time in view: below this share of the best; or GOSPA, of which the best has this."""

COLLAPSED_VALIDATIONS = 10
"""Consecutive validations far below the best that make a collapse: a few may be noise, or a detour."""

MAX_ROLLBACKS = 3
"""Collapses after which a training rolls back to its best; the next one ends it."""


class Progress(eqx.Module):
    """State of a training at a validation, enough to resume it exactly.

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
        """The state before the first iteration."""
        zero = jnp.zeros((), int)
        return cls(learner, learner, jnp.array(-jnp.inf), best_epoch=zero, below=zero, rollbacks=zero)

    @property
    def is_validated(self) -> bool:
        """Whether a policy has been validated and kept; before the first iteration that may be the untrained one."""
        return bool(jnp.isfinite(self.best_score))


@dataclass(frozen=True, kw_only=True)
class Decision:
    """Decision after a validation. A `stop_reason` ends the training; None continues it from `progress`."""

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
    gradient_norm: float = math.nan,
) -> Decision:
    """Decide after the validation of `learner`; `progress` is the state at the previous one.

    `score` [nat per target, or share of time in view] and `at_limit`, the share of commands with every axis at a limit,
    are those of held-out scenes. `finite` says that the score and all gradients are. Where `gradient_norm`, the largest
    since the previous validation, is 0, training ends: it would go on for ever without learning anything.
    """
    decision = _decide(progress, learner, score, at_limit, finite, training)
    if gradient_norm != 0.0 or decision.stop_reason is not None:
        return decision
    reason = f"iteration {int(learner.epoch)}: all gradients are 0, {at_limit:.0%} of commands at a limit"
    hint = "no target comes near the view: is tau_s too long, or the view too small? The best is kept"
    return replace(decision, stop_reason=f"{reason}; {hint}")


def _decide(
    progress: Progress,
    learner: Learner,
    score: float,
    at_limit: float,
    finite: bool,
    training: TrainingSettings | ActorCriticSettings,
) -> Decision:
    if not finite:
        reason = f"iteration {int(learner.epoch)}: a gradient or score was not finite; the best is kept"
        if progress.best_score.dtype == jnp.float32:
            reason += "; try JAX_ENABLE_X64=1, which computes in float64"
        return Decision(progress=replace(progress, learner=progress.best), event="not finite", stop_reason=reason)
    best = float(progress.best_score)
    # The actor-critic samples beyond the limits, and a camera that only turns is at them for good reason.
    saturated = at_limit > SATURATED_SHARE and isinstance(training, TrainingSettings)
    # A saturated policy never replaces a best one, however well it scores: training cannot continue from it. But the
    # first finite validation is kept in any case, so that every run has a policy.
    if score > best and not (saturated and math.isfinite(best)):
        kept = replace(Progress.of(learner), best_score=jnp.array(score), best_epoch=learner.epoch)
        return Decision(progress=replace(kept, rollbacks=progress.rollbacks), is_best=True)
    limits = {"seen": COLLAPSED_SEEN * best, "gospa": best / COLLAPSED_SEEN}
    is_below = score < limits.get(training.objective, best - COLLAPSED_SCORE)
    below = int(progress.below) + 1 if is_below else 0
    if not saturated and below < COLLAPSED_VALIDATIONS:
        return Decision(progress=replace(progress, learner=learner, below=jnp.array(below)))
    why = (
        f"{at_limit:.0%} of commands at a limit" if saturated else f"held-out score {score:.2f} for {below} validations"
    )
    if int(progress.rollbacks) == MAX_ROLLBACKS:
        reason = f"iteration {int(learner.epoch)}: collapsed ({why}) again after {MAX_ROLLBACKS} rollbacks to the best"
        return Decision(progress=progress, event="collapse", stop_reason=reason)
    return _roll_back(progress, learner, why, training)


def _roll_back(
    progress: Progress, learner: Learner, why: str, training: TrainingSettings | ActorCriticSettings
) -> Decision:
    # The iteration and the optimizer's step count continue: training from the best then meets other scenes than those
    # that led to the collapse, and a falling learning rate stays low.
    updates = (learner.epoch * training.updates).astype(jnp.int32)
    optimizer = optax.tree.set(progress.best.optimizer, count=updates)
    restored = replace(progress.best, optimizer=optimizer, epoch=learner.epoch)
    return Decision(
        progress=replace(progress, learner=restored, below=jnp.zeros((), int), rollbacks=progress.rollbacks + 1),
        event=f"collapse ({why}): back to iteration {int(progress.best_epoch)}",
    )
