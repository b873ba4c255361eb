"""State, report, score and compiled loop of epochs, shared by the learners."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float

from foveate.names import Objective
from foveate.simulation.records import Episode, Policy, Trace, per_target
from foveate.types import Count, Key, Scalar


class Learner(eqx.Module):
    """State of a learner between epochs."""

    policy: Policy
    optimizer: optax.OptState
    epoch: Count
    critic: Any = None
    """Value network; None unless the learner is actor-critic."""
    ongoing: Any = None
    """Episodes in progress; None unless long ones are played by windows."""


class EpochReport(eqx.Module):
    """Objective of an epoch, norm of its gradient before clipping, and True if all numbers were finite."""

    objective: Scalar
    gradient_norm: Scalar
    finite: Bool[Array, ""]


Epoch = Callable[[Learner, Key], tuple[Learner, EpochReport]]


def run_epochs(epoch: Epoch, count: Count, learner: Learner, key: Key) -> tuple[Learner, EpochReport]:
    """Run `count` epochs in one compiled loop; report mean objective, largest norm, and True if all were finite.

    An epoch with a number that is not finite leaves the learner unchanged.
    """
    arrays, static = eqx.partition(learner, eqx.is_array)

    def step(_, carry):
        arrays, total = carry
        after, report = epoch(eqx.combine(arrays, static), key)
        new = eqx.filter(after, eqx.is_array)
        kept = jax.tree.map(lambda new, old: jnp.where(report.finite, new, old), new, arrays)
        norm = jnp.maximum(total.gradient_norm, report.gradient_norm)
        return kept, EpochReport(total.objective + report.objective, norm, total.finite & report.finite)

    zero = EpochReport(jnp.zeros(()), jnp.zeros(()), jnp.array(True))
    arrays, total = jax.lax.fori_loop(0, count, step, (arrays, zero))
    return eqx.combine(arrays, static), replace(total, objective=total.objective / count.astype(total.objective.dtype))


def step_scores(values: Float[Array, "K n"], episode: Episode) -> Float[Array, " K"]:
    """Mean of the targets' values after every step."""
    arrivals = episode.arrivals
    # A target that appears in this step is not measured yet.
    present = episode.present if arrivals is None else arrivals.present[1:] & arrivals.present[:-1]
    return per_target(values, jnp.broadcast_to(present, values.shape))


def episode_score(values: Float[Array, "K n"], episode: Episode, terminal: bool) -> Scalar:
    """Mean of the targets' values after the last step (`terminal`), or over all steps."""
    score = step_scores(values, episode)
    if terminal:
        return score[episode.horizon - 1]
    return jnp.mean(score, where=jnp.arange(len(score)) < episode.horizon)


def objective_score(trace: Trace, episode: Episode, objective: Objective) -> Scalar:
    """Score of an episode by a training's objective: a mean log det [nat per target], or the share of time in view.

    By "gospa" it is minus the mean over the steps that the filter expects [m].
    """
    if trace.expected_gospa is not None:
        gospa = trace.expected_gospa[1:]
        return -jnp.mean(gospa, where=jnp.arange(len(gospa)) < episode.horizon)
    values = trace.visible.astype(trace.log_det.dtype) if objective == "seen" else trace.log_det
    return episode_score(values, episode, objective == "terminal")
