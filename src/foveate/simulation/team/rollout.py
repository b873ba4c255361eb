"""Episodes of a team: one scan over its steps."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from foveate.errors import InputError
from foveate.geometry.linalg import log_det_spd
from foveate.models.problem import Problem
from foveate.simulation.draft import Draft
from foveate.simulation.records import Episode, Observation, Policy, Protocol, Trace
from foveate.simulation.step import instants
from foveate.simulation.team import step
from foveate.simulation.team.records import TeamTrace
from foveate.simulation.team.step import TeamState
from foveate.types import Action, Key

TeamDecide = Callable[[Observation, Any, Key], tuple[Action, Array, Any, Any]]
"""(observation, memory, key) -> (action, claims, memory, notes) of one robot."""


class TeamOutcome(NamedTuple):
    """Result of one step, to be recorded in part; what robots have made has a leading axis of M."""

    observation: Observation
    action: Float[Array, "M m"]
    notes: Any
    state: TeamState
    drafts: Draft
    heard: Bool[Array, "M M"]


def simulate(
    problem: Problem,
    decide: TeamDecide,
    episode: Episode,
    protocol: Protocol,
    key: Key,
    record: Callable[[TeamOutcome], PyTree],
    *,
    memory: Any = (),
    state: TeamState | None = None,
) -> tuple[TeamState, PyTree]:
    """Run all steps of a team's episode; return the last state, and records with a leading axis of K.

    Every robot decides by the same `decide`, with a key of its own and its own `memory`, of which each array has a
    leading axis of M. The simulation begins with `state`, by default the start of the episode.
    """
    problem = problem.of_map(episode.map_number)
    team = episode.team
    assert problem.team is not None, "of a team's problems"
    assert team is not None, "of a team's episodes"
    robots = jnp.arange(problem.team.agents)
    per_step = (instants(episode), team.measurement_noise, team.radio)

    def advance(carry, inputs):
        state, memory = carry
        instant, noise, radio = inputs
        predicted = step.predict(problem, state, instant.known_input)
        seen = step.observations(problem, state, predicted, instant.known_input, episode.horizon)
        own = jax.random.fold_in(key, predicted.step[0])
        keys = jax.vmap(lambda number: jax.random.fold_in(own, number))(robots)
        action, claims, memory, notes = jax.vmap(decide)(seen, memory, keys)
        draws = replace(team, measurement_noise=noise, radio=radio)
        after, drafts, heard = step.act(problem, protocol, state, predicted, instant, draws, (action, claims))
        return (after, memory), record(TeamOutcome(seen, action, notes, after, drafts, heard))

    first = step.start(problem, episode, protocol) if state is None else state
    (last, _), records = jax.lax.scan(advance, (first, memory), per_step)
    return last, records


def decider(policy: Policy) -> TeamDecide:
    """A policy as `simulate` takes it, without notes."""

    def decide(observation: Observation, memory: Any, key: Key) -> tuple[Action, Array, Any, Any]:
        action, after = policy(observation, memory, key)
        return action, policy.claims(observation, after), after, ()

    return decide


def first_observations(problem: Problem, episode: Episode, protocol: Protocol) -> Observation:
    """What every robot observes before its first decision, with a leading axis of M."""
    problem = problem.of_map(episode.map_number)
    state, known_input = step.start(problem, episode, protocol), episode.inputs[0]
    predicted = step.predict(problem, state, known_input)
    return step.observations(problem, state, predicted, known_input, episode.horizon)


def rollout(problem: Problem, policy: Policy, episode: Episode, protocol: Protocol, key: Key) -> Trace:
    """Run one episode of a team, every robot by the same policy, and record everything.

    Raises InputError without truth, from which the robots' beliefs are measured.
    """
    if episode.truth is None:
        raise InputError("noise = False: expected True for a team")
    truth, team = episode.truth.state, episode.team
    assert team is not None, "of a team's episodes"
    memory = jax.vmap(policy.start)(first_observations(problem, episode, protocol))

    def record(outcome: TeamOutcome):
        robots, central = outcome.state.robots, outcome.state.central
        error = robots.mean - truth[robots.step[0]]
        weighed = jnp.einsum("mnij,mnj->mni", robots.information[:, -1], error, precision="highest")
        own = (outcome.action, log_det_spd(robots.information[:, -1]), jnp.sum(error * weighed, axis=-1))
        counts = robots.present[0], robots.contacts, robots.rejections
        return robots.pose, central, own, outcome.drafts.measured, counts, outcome.heard

    _, found = simulate(problem, decider(policy), episode, protocol, key, record, memory=memory)
    pose, central, (action, log_det, nees), visible, (present, contacts, rejections), heard = found
    own = {"action": action, "log_det": log_det, "nees": nees, "visible": visible, "heard": heard}
    first = step.start(problem.of_map(episode.map_number), episode, protocol)
    poses = jnp.concatenate([first.robots.pose[None], pose])
    mean, information = (
        jnp.concatenate([before[None], after]) for before, after in zip(first.central, central, strict=True)
    )
    return Trace(
        pose=poses[:, 0],
        action=action[:, 0],
        mean=mean,
        information=information[:, -1],
        log_det=log_det_spd(information[1:, -1]),
        visible=jnp.any(visible, axis=1),
        present=jnp.concatenate([first.robots.present[:1], present]),
        contacts=None if contacts is None else jnp.sum(contacts, axis=1),
        team=TeamTrace(pose=poses, rejections=rejections, **own),
    )
