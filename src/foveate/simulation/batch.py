"""Environments side by side as compiled programs, numpy arrays in and out: what every kind of VecEnv stands on."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Key, PyTree

from foveate.simulation.environment import Environment, EnvironmentState, Transition, observation, renew, reset, step
from foveate.simulation.records import Observation
from foveate.types import Scalar

Look = Callable[[Observation, Scalar], PyTree]
"""Turns an observation, and the share of the episode's steps that is left, into arrays."""


class Steps(NamedTuple):
    """What one step brought to b environments: `seen` after it, and `score`; `length` is how many steps there were.

    Where an episode is over and the next one has begun, `end` is what was seen at its end, and `seen` and the score
    `now` are those of the next one; `end` is `seen` where nothing began.
    """

    seen: Any
    end: Any
    reward: Float[Any, " b"]
    done: Bool[Any, " b"]
    score: Float[Any, " b"]
    now: Float[Any, " b"]
    length: Int[Any, " b"]


class Programs:
    """What steps `count` environments and begins their episodes, each from its own key; compiled on first use."""

    def __init__(self, environment: Environment, look: Look, count: int) -> None:
        def seen(moments: EnvironmentState) -> PyTree:
            left = 1.0 - moments.predicted.step / moments.episode.horizon
            return jax.vmap(look)(jax.vmap(observation)(moments), left)

        def advance(moments, actions):
            after, made = jax.vmap(step, (None, 0, 0))(environment, moments, actions)
            return after, made, (seen(after), made.reward, made.done, made.score, after.predicted.step)

        def again(moments, over, keys, targets):
            moments = eqx.tree_at(lambda m: m.key, moments, jnp.where(over, keys, moments.key))
            moments = renew(environment, moments, over, targets)
            return moments, (seen(moments), moments.score)

        def blank(keys):
            return jax.vmap(reset, (None, 0))(environment, keys)

        self.advance, self.again = eqx.filter_jit(advance, donate="all"), eqx.filter_jit(again, donate="all")
        self.environment, self.count, self.axes = environment, count, len(environment.problem.agent.axes)
        keys = jax.eval_shape(lambda: jax.random.split(jax.random.key(0), count))
        self.moments = jax.eval_shape(blank, keys)
        """Shapes and dtypes of where environments are, and of what is `seen` by them."""
        self.seen: PyTree[jax.ShapeDtypeStruct] = jax.eval_shape(seen, self.moments)


class Batch:
    """Environments side by side, where they are now. Everything seen is float32 and the caller's own.

    With `anew` an episode that is over is followed by the next one in the same step, else by nothing until `renew`.
    `transition` holds the last one, as JAX arrays, and `moments` where all environments are.
    """

    def __init__(self, programs: Programs, anew: bool = True) -> None:
        self.programs, self.count, self.axes, self.anew = programs, programs.count, programs.axes, anew
        self.moments: EnvironmentState | None = None
        self.transition: Transition | None = None

    def renew(
        self,
        keys: Key[jax.Array, " b"],
        over: Bool[np.ndarray, " b"] | None = None,
        targets: Int[np.ndarray, " b"] | None = None,
    ) -> tuple[Any, np.ndarray]:
        """Fresh episodes, from their keys, in those that are `over` (None: in all), with so many `targets` where that
        is > 0: what all see, and their scores.
        """
        over = np.ones(self.count, bool) if over is None else over
        targets = np.zeros(self.count, np.int32) if targets is None else targets
        moments = self.moments
        if moments is None:
            # All is overwritten. One program for this case too: what it costs is compilation.
            moments = jax.tree.map(_nothing, self.programs.moments)
        # A copy, for what is passed is used up.
        keys = jnp.where(over, keys, keys)
        self.moments, numbers = self.programs.again(moments, jnp.asarray(over), keys, targets)
        return _host(numbers)

    def step(self, actions: np.ndarray) -> Steps:
        """One step everywhere; actions (b, m) in [-1, 1], beyond that they are clipped."""
        actions = np.asarray(actions, np.float32)
        self.moments, self.transition, numbers = self.programs.advance(self.moments, actions)
        seen, reward, done, score, length = _host(numbers)
        end, now = seen, score
        if self.anew and done.any():
            seen, now = self.renew(self.moments.key, done)
        return Steps(seen, end, reward, done, score, now, length)


def _nothing(shape: jax.ShapeDtypeStruct) -> jax.Array:
    if jnp.issubdtype(shape.dtype, jax.dtypes.prng_key):
        return jax.random.split(jax.random.key(0), shape.shape)
    return jnp.zeros(shape.shape, shape.dtype)


def _host(tree: Any) -> Any:
    """Numpy arrays of the caller's own, real numbers in float32."""
    return jax.tree.map(lambda x: np.array(x, np.float32 if jnp.issubdtype(x.dtype, jnp.floating) else None), tree)
