"""The step of the simulation as pure `reset` and `step`, for learners and programs that decide outside of it.

All functions take one environment, to be `vmap`ed, but `renew`, which replaces the ended episodes of a batch by new
ones, so that a program of any length runs at full speed.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foveate.errors import InputError
from foveate.geometry.linalg import log_det_spd
from foveate.models.problem import Problem
from foveate.models.robot import Robot
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import Episode, Observation, Protocol, State, observe, per_target
from foveate.simulation.step import act, instants, predict, start
from foveate.types import Action, Count, Key, Scalar

RESETS_PER_CHUNK = 64
"""Episodes drawn at once where some of a batch have ended: the cost of a step follows their number."""


class Environment(eqx.Module):
    """An environment as pure functions of keys, states and actions, to be jitted, vmapped and differentiated.

        state, seen = environment.reset(key)
        state, made = environment.step(state, action)

    It holds the problem, the distribution of episodes, and the protocol. With `noise` episodes have a truth: process
    noise and noisy measurements. Without it they are the noise-free ones of the paper's training, and a protocol that
    needs the truth raises InputError.
    """

    problem: Problem
    scenes: SceneSettings = eqx.field(static=True)
    protocol: Protocol = eqx.field(static=True)
    noise: bool = eqx.field(static=True)

    def __check_init__(self) -> None:
        if not self.noise and (not self.protocol.levels or self.protocol.at_truth):
            raise InputError("noise = False: expected True with a protocol that asks where targets really are")
        if self.problem.team is not None:
            agents = self.problem.team.agents
            raise InputError(f"scenario.team.agents = {agents}: expected 1: this environment has a single robot")

    # By identity: arrays have no hash, by which `jax.jit(environment.step)` knows a function.
    __hash__ = object.__hash__
    __eq__ = object.__eq__

    def reset(self, key: Key, targets: Count | None = None) -> tuple["EnvironmentState", Observation]:
        """Begin a new episode of the training distribution: its state, and the observation of a policy.

        Args:
            key: Random key of the episode, and of those after it.
            targets: Number of targets; None or 0: random.
        """
        state = reset(self, key, targets)
        return state, observation(self, state)

    def step(self, state: "EnvironmentState", action: Action) -> tuple["EnvironmentState", "Transition"]:
        """Move, measure, update, and predict; the transition is `done` when the episode has reached its horizon.

        Args:
            state: State before the step.
            action: A number in [-1, 1] for each commanded axis; beyond, it is clipped.
        """
        return step(self, state, action)


class EnvironmentState(eqx.Module):
    """An environment between two steps: its episode, and its beliefs predicted one step ahead at the pose T_k.

    `score` is the current mean log det of the information per target present [nat]; `key` makes the next episode.
    """

    episode: Episode
    predicted: State
    score: Scalar
    key: Key


class Transition(eqx.Module):
    """Result of a step: the growth of the score [nat], whether the episode has ended, the observation after it.

    The rewards of an episode sum to its last score less its first. `state` (beliefs after the update) and `visible`
    (targets actually measured) are for pictures.
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
    """A new episode of the training distribution, with `targets` targets if that is > 0."""
    episode_key, next_key = jax.random.split(key)
    episode = training_episode(environment.problem, environment.scenes, episode_key, environment.noise, targets=targets)
    return begin(environment, episode, next_key)


def observation(environment: Environment, current: EnvironmentState) -> Observation:
    """The observation of a policy; after the last step its numbers have no meaning."""
    episode, predicted = current.episode, current.predicted
    problem = environment.problem.of_map(episode.map_number)
    return observe(predicted, _known_input(episode, predicted), episode.horizon, Robot.of(problem))


def step(environment: Environment, current: EnvironmentState, action: Action) -> tuple[EnvironmentState, Transition]:
    """One step of `rollout`: move, measure, update, and predict the next beliefs; done when step == horizon."""
    episode, predicted = current.episode, current.predicted
    instant = jax.tree.map(lambda part: part[predicted.step], instants(episode))
    draft = act(environment.problem.of_map(episode.map_number), environment.protocol, predicted, instant, action)
    state = draft.state
    # A target that was born at this step could not be measured yet.
    score = _score(state, state.present & predicted.present)
    after = _state(environment, episode, state, score, current.key)
    done = state.step >= episode.horizon
    return after, Transition(score - current.score, done, score, observation(environment, after), state, draft.measured)


def renew(
    environment: Environment,
    states: EnvironmentState,
    ended: Bool[Array, " b"],
    targets: Int[Array, " b"] | None = None,
) -> EnvironmentState:
    """Begin the next episode where one of a batch has ended, each from its own key; `targets` as in `reset`."""
    count = len(ended)

    def renew_chunk(carry):
        states, ended = carry
        rows = jnp.nonzero(ended, size=min(RESETS_PER_CHUNK, count), fill_value=count)[0]
        chunk_targets = None if targets is None else targets.at[rows].get(mode="clip")
        fresh = jax.vmap(reset, (None, 0, 0))(environment, states.key.at[rows].get(mode="clip"), chunk_targets)
        # Rows beyond the batch fill up the chunk, and are dropped.
        states = jax.tree.map(lambda old, new: old.at[rows].set(new, mode="drop"), states, fresh)
        return states, ended.at[rows].set(False, mode="drop")

    return jax.lax.while_loop(lambda carry: jnp.any(carry[1]), renew_chunk, (states, ended))[0]


def _state(environment: Environment, episode: Episode, state: State, score: Scalar, key: Key) -> EnvironmentState:
    predicted = predict(environment.problem, state, _known_input(episode, state))
    return EnvironmentState(episode, predicted, score, key)


def _known_input(episode: Episode, state: State) -> Float[Array, "n m_y"]:
    return episode.inputs[jnp.minimum(state.step, len(episode.inputs) - 1)]


def _score(state: State, present: Bool[Array, " n"]) -> Scalar:
    return per_target(jnp.mean(log_det_spd(state.information), axis=0), present)
