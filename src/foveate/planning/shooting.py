"""Iterative Covariance Regulation (Koga, Asgharivaskasi, Atanasov, IROS 2021): gradient ascent on a control sequence.

The publication fixes the idea: the soft field of view, the gradient through the whole sequence, one start. The
control limits, step size, iterations and window here are ours: raw actions pass through tanh, and Adam takes the
steps. Beyond the publication: many starts, most of them tours of the targets, and a view that hardens on the way.
"""

from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.models.problem import Problem
from foveate.models.sensor import PAPER_SOFTNESS, Softness
from foveate.planning.information import Future, score
from foveate.planning.tours import straight_ahead, tours
from foveate.types import Key, Scalar

CHECK_EVERY = 10
"""Steps of ascent between two looks at the score by which the best is kept."""


@dataclass(frozen=True, kw_only=True)
class PlanSettings:
    """How a plan is made: Adam from `starts` sequences, its gradient's norm bounded, with cosine decay.

    The level (offset, kappa [m]) of the soft view moves linearly from `first` to `last` over the first `annealed`
    share of the iterations. The best is kept by its score at the level `keep`, or in the real view (None).
    """

    starts: int = 64
    iterations: int = 300
    learning_rate: float = 0.05
    gradient_bound: float = 5.0
    first: tuple[float, float] = (3.0, 0.6)
    last: tuple[float, float] = (0.3, 0.25)
    annealed: float = 0.7
    keep: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name, least in (("starts", 1), ("iterations", 0), ("annealed", 0)):
            if getattr(self, name) < least:
                raise InputError(f"{name} = {getattr(self, name)}: expected >= {least}")
        for name in ("learning_rate", "gradient_bound"):
            if getattr(self, name) <= 0:
                raise InputError(f"{name} = {getattr(self, name)}: expected > 0")
        for name in ("first", "last", "keep"):
            if (level := getattr(self, name)) is not None and level[1] <= 0:
                raise InputError(f"{name} = {level}: expected (offset, kappa) with kappa > 0")


PAPER = (PAPER_SOFTNESS.offset, PAPER_SOFTNESS.kappa)


PUBLISHED = PlanSettings(starts=1, iterations=100, learning_rate=0.1, first=PAPER, last=PAPER, keep=PAPER)
"""One start and one level of the view, as in the publication; step size and iterations are ours."""


OMNISCIENT = {
    "surrogate": PlanSettings(first=(4.0, 0.8), last=PAPER, keep=PAPER),
    "true": PlanSettings(),
}
"""The best that was found for each protocol's score, with all inputs known."""


ONLINE = {
    "surrogate": PlanSettings(starts=1, iterations=30, learning_rate=0.1, last=PAPER, keep=PAPER),
    "true": PlanSettings(
        starts=1, iterations=30, learning_rate=0.03, first=(1.0, 0.4), last=(0.0, 0.25), keep=(0.0, 0.25)
    ),
}
"""For a plan at every step: few steps from the last plan; where a target really will be is not known, so that the
soft view says better than the real one what is worth keeping."""


REFINING = {
    "surrogate": PlanSettings(starts=8, iterations=15, learning_rate=0.06, last=PAPER, keep=PAPER),
    "true": PlanSettings(
        starts=8, iterations=15, learning_rate=0.06, first=(1.0, 0.4), last=(0.0, 0.15), keep=(0.0, 0.15)
    ),
}
"""For a policy that is improved at every step: from what it would do, from the last plan, and from a few tours."""


def refining(protocol: str, steps: int) -> PlanSettings:
    """Online plans that take so many steps from what a policy would do, the last plan, and tours."""
    return replace(REFINING[protocol], iterations=steps)


class Plan(eqx.Module):
    """Raw actions, before tanh, and what they are worth [nat per target]."""

    raw: Float[Array, "K m"]
    score: Scalar

    @property
    def action(self) -> Float[Array, "K m"]:
        """The normalised actions, within [-1, 1]."""
        return jnp.tanh(self.raw)


def ascend(problem: Problem, future: Future, raw: Float[Array, "K m"], settings: PlanSettings) -> Plan:
    """The best sequence on the way up from one start; a gradient that is not finite ends its ascent."""
    rate = optax.cosine_decay_schedule(settings.learning_rate, max(1, settings.iterations))
    steps = optax.chain(optax.clip_by_global_norm(settings.gradient_bound), optax.adam(rate))
    keep = None if settings.keep is None else Softness(*settings.keep)

    def worth(raw, level):
        return score(problem, future, jnp.tanh(raw), level)

    def step(i, carry):
        raw, state = carry
        updates, state = steps.update(-jax.grad(worth)(raw, level_at(settings, i)), state)
        return raw + updates, state

    def block(i, carry):
        raw, state, best = carry
        stop = jnp.minimum((i + 1) * CHECK_EVERY, settings.iterations)
        raw, state = jax.lax.fori_loop(i * CHECK_EVERY, stop, step, (raw, state))
        return raw, state, better(best, Plan(raw, worth(raw, keep)))

    blocks = -(-settings.iterations // CHECK_EVERY)
    return jax.lax.fori_loop(0, blocks, block, (raw, steps.init(raw), Plan(raw, worth(raw, keep))))[2]


def better(a: Plan, b: Plan) -> Plan:
    """The plan that is worth more; the first of equals, and of what is not finite."""
    return jax.tree.map(lambda x, y: jnp.where(b.score > a.score, y, x), a, b)


def level_at(settings: PlanSettings, iteration: Array) -> Softness:
    """The level of the soft view at an iteration."""
    done = jnp.asarray(iteration, float) / max(1.0, settings.annealed * settings.iterations)
    way: Any = jnp.clip(done, 0.0, 1.0)
    offset, kappa = (a + (b - a) * way for a, b in zip(settings.first, settings.last, strict=True))
    return Softness(offset, kappa)


def plan(
    problem: Problem,
    future: Future,
    settings: PlanSettings,
    key: Key,
    given: Float[Array, "g K m"] | None = None,
) -> Plan:
    """The best plan from all starts: those that are `given`, else one straight ahead, and then tours."""
    steps = len(future.state)
    first = straight_ahead(problem, steps)[None] if given is None else given[: settings.starts]
    rest = tours(problem, future, settings.starts - len(first), key)
    plans = jax.vmap(lambda raw: ascend(problem, future, raw, settings))(jnp.concatenate([first, rest]))
    best = jnp.argmax(jnp.where(jnp.isnan(plans.score), -jnp.inf, plans.score))
    return jax.tree.map(lambda x: x[best], plans)
