"""What all learners with epochs share: their state, what one epoch reports, and the compiled loop of epochs."""

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
    """Everything that one epoch hands on to the next."""

    policy: Policy
    optimizer: optax.OptState
    epoch: Count
    critic: Any = None
    """What only learning needs beside the policy: nothing here, a network of its own for who learns by trying."""


class Report(eqx.Module):
    """One epoch in numbers: the objective, the gradient's norm before its bound, and all finite?"""

    objective: Scalar
    gradient_norm: Scalar
    finite: Bool[Array, ""]


Advance = Callable[[Learner, Key], tuple[Learner, Report]]
"""One epoch of a learner."""


def epochs(advance: Advance, count: Count, learner: Learner, key: Key) -> tuple[Learner, Report]:
    """`count` epochs in one compiled loop: the mean of what is ascended, the largest norm, and whether all were finite.

    An epoch that is not finite changes nothing: the learner stays as it was before it.
    """
    arrays, static = eqx.partition(learner, eqx.is_array)

    def step(_, carry):
        arrays, total = carry
        after, now = advance(eqx.combine(arrays, static), key)
        kept = jax.tree.map(lambda new, old: jnp.where(now.finite, new, old), eqx.filter(after, eqx.is_array), arrays)
        sums = Report(
            total.objective + now.objective,
            jnp.maximum(total.gradient_norm, now.gradient_norm),
            total.finite & now.finite,
        )
        return kept, sums

    nothing = Report(jnp.zeros(()), jnp.zeros(()), jnp.array(True))
    arrays, total = jax.lax.fori_loop(0, count, step, (arrays, nothing))
    return eqx.combine(arrays, static), Report(total.objective / count, total.gradient_norm, total.finite)
