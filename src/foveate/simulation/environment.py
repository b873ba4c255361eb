"""The step of the simulation as pure `reset` and `step`, for learners and programs that decide outside of it.

All functions but two are of one environment, to be `vmap`ed; `step_and_reset` steps a batch and replaces every episode
that has ended by a new one (`renew`), so that a program of any length runs at full speed.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foveate.errors import InputError
from foveate.geometry.linalg import log_det_spd
from foveate.models.problem import Problem
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import Episode, Observation, Protocol, State, per_target
from foveate.simulation.step import act, instants, observe, predict, start
from foveate.types import Action, Count, Key, Scalar

CHUNK = 64
"""Episodes drawn at once where some of a batch have ended: the cost of a step follows how many have."""


class Environment(eqx.Module):
    """An environment: the problem, the distribution of episodes, and the protocol that information grows by.

    Without `noise` an episode is the noise-free one of the paper's training; with it, targets are pushed and measured
    as in the real world. Raises ValueError for a protocol that asks for truth where there is none.
    """

    problem: Problem
    scenes: SceneSettings = eqx.field(static=True)
    protocol: Protocol = eqx.field(static=True)
    noise: bool = eqx.field(static=True)

    def __check_init__(self) -> None:
        if not self.noise and (not self.protocol.levels or self.protocol.at_truth):
            raise InputError("noise = False: expected True with a protocol that asks where targets really are")


class EnvironmentState(eqx.Module):
    """An environment between two steps: its episode, and its beliefs predicted one step ahead at the pose T_k.

    `score` is the mean log det of the information per target present, now [nat]; `key` makes the next episode.
    """

    episode: Episode
    predicted: State
    score: Scalar
    key: Key


class Transition(eqx.Module):
    """Result of a step: the growth of the score [nat], whether the episode has ended, the observation after it.

    The rewards of an episode sum to its last score less its first. `state` and `visible`, the beliefs after the update
    and which targets were really measured, are for pictures.
    """

    reward: Float[Array, "*b"]
    done: Bool[Array, "*b"]
    score: Float[Array, "*b"]
    observation: Observation
    state: State
    visible: Bool[Array, "*b n"]


def begin(environment: Environment, episode: Episode, key: Key) -> EnvironmentState:
    """The state before the first step of an episode."""
    state = start(environment.problem, episode, environment.protocol)
    return _state(environment, episode, state, _score(state, state.present), key)


def reset(environment: Environment, key: Key, targets: Count | None = None) -> EnvironmentState:
    """A fresh episode of the training distribution; with `targets` > 0 one with that many."""
    episode_key, next_key = jax.random.split(key)
    scenes, noise = environment.scenes, environment.noise
    episode = training_episode(environment.problem, scenes, episode_key, noise, targets=targets)
    return begin(environment, episode, next_key)


def observation(current: EnvironmentState) -> Observation:
    """The observation of a policy; after the last step its numbers have no meaning."""
    return observe(current.predicted, _known_input(current.episode, current.predicted), current.episode.horizon)


def step(environment: Environment, current: EnvironmentState, action: Action) -> tuple[EnvironmentState, Transition]:
    """One step of `rollout`: move, measure, update, and predict what comes next; done when step == horizon."""
    episode, predicted = current.episode, current.predicted
    instant = jax.tree.map(lambda part: part[predicted.step], instants(episode))
    done = act(environment.problem, environment.protocol, predicted, instant, action)
    state = done.state
    # A target that was born at this step could not be measured yet.
    score = _score(state, state.present & predicted.present)
    after = _state(environment, episode, state, score, current.key)
    over = state.step >= episode.horizon
    return after, Transition(score - current.score, over, score, observation(after), state, done.measured)


def step_and_reset(
    environment: Environment, states: EnvironmentState, actions: Float[Array, "b m"]
) -> tuple[EnvironmentState, Transition]:
    """One step of a batch: where an episode has ended the next one has begun, and the transition shows the end.

    Every environment draws its episodes from its own key, so that none depends on the others.
    """
    states, transition = jax.vmap(step, (None, 0, 0))(environment, states, actions)
    return renew(environment, states, transition.done), transition


def renew(
    environment: Environment,
    states: EnvironmentState,
    over: Bool[Array, " b"],
    targets: Int[Array, " b"] | None = None,
) -> EnvironmentState:
    """Begin the next episode where one of a batch has ended, each from its own key; `targets` as in `reset`."""
    count = len(over)

    def some(carry):
        states, over = carry
        rows = jnp.nonzero(over, size=min(CHUNK, count), fill_value=count)[0]
        asked = None if targets is None else targets.at[rows].get(mode="clip")
        fresh = jax.vmap(reset, (None, 0, 0))(environment, states.key.at[rows].get(mode="clip"), asked)
        # Rows beyond the batch fill up the chunk, and are dropped.
        states = jax.tree.map(lambda old, new: old.at[rows].set(new, mode="drop"), states, fresh)
        return states, over.at[rows].set(False, mode="drop")

    return jax.lax.while_loop(lambda carry: jnp.any(carry[1]), some, (states, over))[0]


def _state(environment: Environment, episode: Episode, state: State, score: Scalar, key: Key) -> EnvironmentState:
    predicted = predict(environment.problem, state, _known_input(episode, state))
    return EnvironmentState(episode, predicted, score, key)


def _known_input(episode: Episode, state: State) -> Float[Array, "n m_y"]:
    return episode.inputs[jnp.minimum(state.step, len(episode.inputs) - 1)]


def _score(state: State, present: Bool[Array, " n"]) -> Scalar:
    return per_target(jnp.mean(log_det_spd(state.information), axis=0), present)
