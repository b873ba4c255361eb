"""Environments side by side as compiled programs, numpy arrays in and out: the base of every kind of VecEnv."""

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

FeaturesFunction = Callable[[Observation, Scalar], PyTree]
"""Turns an observation, and the share of the episode's steps that is left, into arrays."""


class Steps(NamedTuple):
    """Result of one step of b environments: features `observed` after it, reward, end, `score`, steps of the episode.

    Where an episode has ended and the next one has begun, `final` holds the last features of the old episode, and
    `observed` and `next_score` are those of the new one; elsewhere `final` is `observed` and `next_score` is `score`.
    """

    observed: Any
    final: Any
    reward: Float[Any, " b"]
    done: Bool[Any, " b"]
    score: Float[Any, " b"]
    next_score: Float[Any, " b"]
    length: Int[Any, " b"]


class CompiledEnvironments:
    """Programs that step `count` environments and begin their episodes, each from its own key; compiled on first use.

    `states` and `observed` hold the shapes and dtypes of the environments' states and of their features.
    """

    def __init__(self, environment: Environment, features: FeaturesFunction, count: int) -> None:
        def observe(states: EnvironmentState) -> PyTree:
            left = 1.0 - states.predicted.step / states.episode.horizon
            return jax.vmap(features)(jax.vmap(observation, (None, 0))(environment, states), left)

        def advance(states, actions):
            after, made = jax.vmap(step, (None, 0, 0))(environment, states, actions)
            return after, made, (observe(after), made.reward, made.done, made.score, after.predicted.step)

        def begin(states, ended, keys, targets):
            states = eqx.tree_at(lambda s: s.key, states, jnp.where(ended, keys, states.key))
            states = renew(environment, states, ended, targets)
            return states, (observe(states), states.score)

        self.advance, self.begin = eqx.filter_jit(advance, donate="all"), eqx.filter_jit(begin, donate="all")
        self.environment, self.count, self.axes = environment, count, len(environment.problem.agent.axes)
        keys = jax.eval_shape(lambda: jax.random.split(jax.random.key(0), count))
        self.states = jax.eval_shape(lambda keys: jax.vmap(reset, (None, 0))(environment, keys), keys)
        self.observed: PyTree[jax.ShapeDtypeStruct] = jax.eval_shape(observe, self.states)


class Batch:
    """Environments side by side in their current states. All returned numbers are float32 copies.

    With `autoreset` the next episode begins in the step that ends one, else only by `renew`. `transition` holds the
    last transition and `states` all environments, as JAX arrays.
    """

    def __init__(self, programs: CompiledEnvironments, autoreset: bool = True) -> None:
        self.programs, self.count, self.axes, self.autoreset = programs, programs.count, programs.axes, autoreset
        self.states: EnvironmentState | None = None
        self.transition: Transition | None = None

    def renew(
        self,
        keys: Key[jax.Array, " b"],
        ended: Bool[np.ndarray, " b"] | None = None,
        targets: Int[np.ndarray, " b"] | None = None,
    ) -> tuple[Any, np.ndarray]:
        """Begin episodes from their keys where one has `ended` (None: in all); return all features and scores.

        Where `targets` is > 0 an episode has that number of targets.
        """
        ended = np.ones(self.count, bool) if ended is None else ended
        targets = np.zeros(self.count, np.int32) if targets is None else targets
        # Before the first episodes all is overwritten. A second program for that case would have to be compiled, too.
        states = jax.tree.map(_blank, self.programs.states) if self.states is None else self.states
        keys = jnp.where(ended, keys, keys)  # a copy, since the program consumes its arguments
        self.states, numbers = self.programs.begin(states, jnp.asarray(ended), keys, targets)
        return _host(numbers)

    def step(self, actions: np.ndarray) -> Steps:
        """Step all environments; actions (b, m) in [-1, 1], beyond that they are clipped."""
        self.states, self.transition, numbers = self.programs.advance(self.states, np.asarray(actions, np.float32))
        final, reward, done, score, length = _host(numbers)
        observed, next_score = final, score
        if self.autoreset and done.any():
            observed, next_score = self.renew(self.states.key, done)
        return Steps(observed, final, reward, done, score, next_score, length)

    def packed(self) -> list[np.ndarray] | None:
        """Current states as arrays that can be pickled; None before the first episodes."""
        return None if self.states is None else [np.asarray(_plain(x)) for x in jax.tree.leaves(self.states)]

    def unpack(self, states: list[np.ndarray] | None) -> None:
        """Continue from packed states."""
        if states is not None:
            shapes, structure = jax.tree.flatten(self.programs.states)
            leaves = [
                jax.random.wrap_key_data(jnp.asarray(x)) if _is_key(shape) else jnp.asarray(x)
                for x, shape in zip(states, shapes, strict=True)
            ]
            self.states = jax.tree.unflatten(structure, leaves)


def _is_key(x: jax.Array | jax.ShapeDtypeStruct) -> bool:
    return jnp.issubdtype(x.dtype, jax.dtypes.prng_key)


def _plain(x: jax.Array) -> jax.Array:
    return jax.random.key_data(x) if _is_key(x) else x


def _blank(shape: jax.ShapeDtypeStruct) -> jax.Array:
    if _is_key(shape):
        return jax.random.split(jax.random.key(0), shape.shape)
    return jnp.zeros(shape.shape, shape.dtype)


def _host(tree: Any) -> Any:
    """Copy to numpy, real numbers as float32."""
    return jax.tree.map(lambda x: np.array(x, np.float32 if jnp.issubdtype(x.dtype, jnp.floating) else None), tree)
