"""Windows of episodes: how long they are, and the episodes in progress of which they are cut.

Short episodes are played whole, new ones in every iteration. Long ones are played by windows, each from the state that
the policy has reached in the window before.
"""

import math
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, UInt32

from foveate.experiment.learners import ActorCriticSettings
from foveate.learning.worlds import World
from foveate.models.problem import Problem
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.records import Episode, Protocol, State
from foveate.simulation.step import start
from foveate.simulation.team import step as team_step
from foveate.simulation.team.step import TeamState
from foveate.types import Count, Key


class Ongoing(eqx.Module):
    """Episodes in progress: the key that an episode is made of, and the state that the policy has reached in it."""

    key_data: UInt32[Array, "*b words"]
    state: State | TeamState
    ends: Count
    """Step at which the episode ends; for the first ones earlier than their horizon, so that not all end at once."""

    @property
    def key(self) -> Key:
        """The key of one episode."""
        return jax.random.wrap_key_data(self.key_data)


def window_steps(scenes: SceneSettings, settings: ActorCriticSettings) -> int:
    """Steps of a window: those of the longest episode, or an equal part of them of at most `settings.window` steps."""
    longest = scenes.horizon(scenes.targets_max)
    return math.ceil(longest / math.ceil(longest / settings.window))


def plays_whole(scenes: SceneSettings, settings: ActorCriticSettings) -> bool:
    """True if every episode fits into a window."""
    return window_steps(scenes, settings) == scenes.horizon(scenes.targets_max)


def begin_ongoing(world: World, settings: ActorCriticSettings, key: Key) -> Ongoing | None:
    """The first episodes of a training by windows; None where episodes are played whole."""
    scenes = world.scenes
    if plays_whole(scenes, settings):
        return None
    length, count = window_steps(scenes, settings), settings.trajectories(scenes, world.agents)
    keys = jax.random.split(key, count)
    parts = math.ceil(scenes.horizon(scenes.targets_max) / length)

    def begin(key, i):
        problem, episode = world.drawn(key)
        ends = jnp.minimum(episode.horizon, (1 + i % parts) * length)
        return Ongoing(jax.random.key_data(key), first_state(problem, episode, settings.protocol_of(0)), ends)

    return jax.jit(jax.vmap(begin))(keys, jnp.arange(count))


def first_state(problem: Problem, episode: Episode, protocol: Protocol) -> State | TeamState:
    """The state before the first step, of a robot or of a team."""
    return start(problem, episode, protocol) if episode.team is None else team_step.start(problem, episode, protocol)


def step_of(state: State | TeamState) -> Count:
    """Number of steps up to a state."""
    return state.robots.step[0] if isinstance(state, TeamState) else state.step


def cut(episode: Episode, first: Count, steps: int) -> Episode:
    """Steps `first` .. `first` + `steps` - 1 of an episode, which are still counted from its start.

    It has one more input, which the agent knows when it decides the step after them; beyond the end all is as at last.
    """

    def part(x, more: int = 0):
        return jax.lax.dynamic_slice_in_dim(x, first, steps + more)

    def whole(x):
        return jnp.concatenate([x, jnp.repeat(x[-1:], steps, axis=0)])

    episode = replace(
        episode,
        inputs=whole(episode.inputs),
        truth=jax.tree.map(whole, episode.truth),
        arrivals=jax.tree.map(whole, episode.arrivals),
        team=episode.team and episode.team.of_steps(whole),
        scans=jax.tree.map(whole, episode.scans),
    )
    assert episode.truth is not None, "training episodes are noisy"
    truth = replace(
        episode.truth,
        state=part(episode.truth.state, 1),
        measurement_noise=part(episode.truth.measurement_noise),
    )
    arrivals, scans = jax.tree.map(lambda x: part(x, 1), episode.arrivals), episode.scans
    if scans is not None:
        scans = replace(jax.tree.map(part, scans), alive=part(scans.alive, 1))
    rest = {"arrivals": arrivals, "scans": scans, "team": episode.team and episode.team.of_steps(part)}
    return replace(episode, inputs=part(episode.inputs, 1), truth=truth, **rest)


def continued(world: World, protocol: Protocol, one: Ongoing, last: State | TeamState, new_key: Key) -> Ongoing:
    """The episode where it has come to, or a new one after its end."""
    problem, fresh = world.drawn(new_key)
    over = step_of(last) >= one.ends
    after = Ongoing(one.key_data, last, one.ends)
    begun = Ongoing(jax.random.key_data(new_key), first_state(problem, fresh, protocol), fresh.horizon)
    return jax.tree.map(lambda new, old: jnp.where(over, new, old), begun, after)
