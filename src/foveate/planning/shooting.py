"""Plan by Iterative Covariance Regulation (Koga, Asgharivaskasi, Atanasov, IROS 2021): ascent on a control sequence.

The soft field of view and the gradient through the whole sequence are those of the publication. Control limits (by
tanh of raw actions), step size (by Adam), iterations and window are ours. Beyond the publication: many starts, most of
them tours of the targets, and a view that hardens during the ascent.
"""

from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from foveate.io.settings import Settings
from foveate.io.validate import positive, require
from foveate.models.problem import Problem
from foveate.models.sensor import PAPER_SOFTNESS, Softness
from foveate.planning.tours import straight_ahead, tours
from foveate.simulation.information import Future, score
from foveate.types import Key, Scalar

CHECK_EVERY = 10
"""Steps of ascent between two evaluations of the score that selects the best sequence."""


@dataclass(frozen=True, kw_only=True)
class PlanSettings(Settings):
    """Settings of a planner: Adam from `starts` sequences, with clipped gradient and cosine decay.

    The level (offset, kappa [m]) of the soft view moves linearly from `first` to `last` over the first `annealed`
    share of the iterations. The score at the level `keep`, or in the real view (None), selects the best.
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
        super().__post_init__()
        for name, least in (("starts", 1), ("iterations", 0), ("annealed", 0)):
            require(getattr(self, name) >= least, name, getattr(self, name), f"expected >= {least}")
        positive(self, "learning_rate", "gradient_bound")
        for name in ("first", "last", "keep"):
            level = getattr(self, name)
            require(level is None or level[1] > 0, name, level, "expected (offset, kappa) with kappa > 0")


PAPER = (PAPER_SOFTNESS.offset, PAPER_SOFTNESS.kappa)

PUBLISHED = PlanSettings(starts=1, iterations=100, learning_rate=0.1, first=PAPER, last=PAPER, keep=PAPER)
"""One start and one level of the view, as in the publication; step size and iterations are ours."""

OMNISCIENT = {"surrogate": PlanSettings(first=(4.0, 0.8), last=PAPER, keep=PAPER), "true": PlanSettings()}
"""The best known settings for each protocol's score where all inputs are known."""

_ONLINE = PlanSettings(starts=1, iterations=30, learning_rate=0.1, last=PAPER, keep=PAPER)
ONLINE = {
    "surrogate": _ONLINE,
    "true": replace(_ONLINE, learning_rate=0.03, first=(1.0, 0.4), last=(0.0, 0.25), keep=(0.0, 0.25)),
}
"""For a plan at every step: few iterations from the last plan. The targets' future is uncertain, and so the soft view
scores a plan better than the real one, whose edge the errors cross."""


def refining(protocol: str, steps: int) -> PlanSettings:
    """Settings to refine a policy in `steps` iterations: from its actions, from the last plan, and from a few tours."""
    settings = PlanSettings(starts=8, iterations=steps, learning_rate=0.06, last=PAPER, keep=PAPER)
    if protocol == "surrogate":
        return settings
    return replace(settings, first=(1.0, 0.4), last=(0.0, 0.15), keep=(0.0, 0.15))


class Plan(eqx.Module):
    """Raw actions, before tanh, and their score [nat per target]."""

    raw: Float[Array, "K m"]
    score: Scalar

    @property
    def action(self) -> Float[Array, "K m"]:
        """The normalised actions, within [-1, 1]."""
        return jnp.tanh(self.raw)


def ascend(problem: Problem, future: Future, raw: Float[Array, "K m"], settings: PlanSettings) -> Plan:
    """Ascend from one start and return the best sequence on the way; a gradient that is not finite ends the ascent."""
    rate = optax.cosine_decay_schedule(settings.learning_rate, max(1, settings.iterations))
    optimizer = optax.chain(optax.clip_by_global_norm(settings.gradient_bound), optax.adam(rate))
    keep = None if settings.keep is None else Softness(*settings.keep)

    def value(raw, level):
        return score(problem, future, jnp.tanh(raw), level)

    def step(i, carry):
        raw, state = carry
        updates, state = optimizer.update(-jax.grad(value)(raw, level_at(settings, i)), state)
        return raw + updates, state

    def block(i, carry):
        raw, state, best = carry
        stop = jnp.minimum((i + 1) * CHECK_EVERY, settings.iterations)
        raw, state = jax.lax.fori_loop(i * CHECK_EVERY, stop, step, (raw, state))
        return raw, state, better(best, Plan(raw, value(raw, keep)))

    # The selecting score costs another forward pass and changes little in a step: only every CHECK_EVERY. The start
    # competes too, since ascent on the soft score may lower the selecting one.
    blocks = -(-settings.iterations // CHECK_EVERY)
    return jax.lax.fori_loop(0, blocks, block, (raw, optimizer.init(raw), Plan(raw, value(raw, keep))))[2]


def better(a: Plan, b: Plan) -> Plan:
    """The plan with the higher score; `a` where they are equal or the score of `b` is NaN."""
    return jax.tree.map(lambda x, y: jnp.where(b.score > a.score, y, x), a, b)


def level_at(settings: PlanSettings, iteration: Array) -> Softness:
    """The level of the soft view at an iteration."""
    done = jnp.asarray(iteration, float) / max(1.0, settings.annealed * settings.iterations)
    progress: Any = jnp.clip(done, 0.0, 1.0)
    offset, kappa = (a + (b - a) * progress for a, b in zip(settings.first, settings.last, strict=True))
    return Softness(offset, kappa)


def plan(
    problem: Problem, future: Future, settings: PlanSettings, key: Key, starts: Float[Array, "s K m"] | None = None
) -> Plan:
    """Best plan from all starts: these `starts` (None: one straight ahead), and tours for the rest."""
    first = straight_ahead(problem, len(future.state))[None] if starts is None else starts[: settings.starts]
    rest = tours(problem, future, settings.starts - len(first), key)
    plans = jax.vmap(lambda raw: ascend(problem, future, raw, settings))(jnp.concatenate([first, rest]))
    # argmax takes a NaN for the largest.
    best = jnp.argmax(jnp.where(jnp.isnan(plans.score), -jnp.inf, plans.score))
    return jax.tree.map(lambda x: x[best], plans)
