"""State, report and compiled loop of epochs that every JAX learner shares."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool

from foveate.simulation.records import Policy
from foveate.types import Count, Key, Scalar


class Learner(eqx.Module):
    """All that one epoch passes on to the next."""

    policy: Policy
    optimizer: optax.OptState
    epoch: Count
    critic: Any = None
    """Value network; None unless the learner is actor-critic."""


class EpochReport(eqx.Module):
    """One epoch in numbers: the objective, the gradient's norm before clipping, and whether all were finite."""

    objective: Scalar
    gradient_norm: Scalar
    finite: Bool[Array, ""]


Epoch = Callable[[Learner, Key], tuple[Learner, EpochReport]]
"""One epoch of a learner."""


def run_epochs(epoch: Epoch, count: Count, learner: Learner, key: Key) -> tuple[Learner, EpochReport]:
    """Run `count` epochs in one compiled loop; report mean objective, largest norm, and whether all were finite.

    An epoch that is not finite changes nothing: the learner stays as it was before it.
    """
    arrays, static = eqx.partition(learner, eqx.is_array)

    def step(_, carry):
        arrays, total = carry
        after, report = epoch(eqx.combine(arrays, static), key)
        kept = jax.tree.map(
            lambda new, old: jnp.where(report.finite, new, old), eqx.filter(after, eqx.is_array), arrays
        )
        total = EpochReport(
            objective=total.objective + report.objective,
            gradient_norm=jnp.maximum(total.gradient_norm, report.gradient_norm),
            finite=total.finite & report.finite,
        )
        return kept, total

    zero = EpochReport(objective=jnp.zeros(()), gradient_norm=jnp.zeros(()), finite=jnp.array(True))
    arrays, total = jax.lax.fori_loop(0, count, step, (arrays, zero))
    mean = EpochReport(objective=total.objective / count, gradient_norm=total.gradient_norm, finite=total.finite)
    return eqx.combine(arrays, static), mean
