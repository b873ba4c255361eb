"""Episodes of a team: one scan over its steps."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from foveate.errors import InputError
from foveate.geometry.linalg import log_det_spd
from foveate.models.detections.expectation import confirmed
from foveate.models.problem import Problem
from foveate.simulation.draft import Draft
from foveate.simulation.records import Episode, Observation, Policy, Protocol, State, Trace
from foveate.simulation.scans import dropped, expected
from foveate.simulation.step import instants
from foveate.simulation.team import step
from foveate.simulation.team.records import TeamDraws, TeamTrace
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
) -> tuple[TeamState, Any, PyTree]:
    """Run all steps of a team's episode; return the last state and memory, and records with a leading axis of K.

    Every robot decides by the same `decide`, with a key of its own and its own `memory`, of which each array has a
    leading axis of M. The simulation begins with `state`, by default the start of the episode.
    """
    problem = problem.of_map(episode.map_number)
    team = episode.team
    assert problem.team is not None, "of a team's problems"
    assert team is not None, "of a team's episodes"
    robots = jnp.arange(problem.team.agents)
    per_step = (instants(episode), (team.measurement_noise, team.radio, team.scans))

    def advance(carry, inputs):
        state, memory = carry
        instant, (noise, radio, scans) = inputs
        predicted = step.predict(problem, state, instant.known_input)
        seen = step.observations(problem, state, predicted, instant.known_input, episode.horizon)
        own = jax.random.fold_in(key, predicted.step[0])
        keys = jax.vmap(lambda number: jax.random.fold_in(own, number))(robots)
        action, claims, memory, notes = jax.vmap(decide)(seen, memory, keys)
        draws = TeamDraws(team.poses, noise, radio, scans)
        after, drafts, heard = step.act(problem, protocol, state, predicted, instant, draws, (action, claims))
        return (after, memory), record(TeamOutcome(seen, action, notes, after, drafts, heard))

    first = step.start(problem, episode, protocol) if state is None else state
    (last, memory), records = jax.lax.scan(advance, (first, memory), per_step)
    return last, memory, records


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
        state, robots = outcome.state, outcome.state.robots
        counts = (
            robots.contacts,
            robots.rejections,
            without_room(problem, state),
        )
        own = {"action": outcome.action, "visible": outcome.drafts.measured, "heard": outcome.heard}
        return robots.pose, _central(problem, state), own | _members(problem, robots, truth), counts

    _, _, found = simulate(problem, decider(policy), episode, protocol, key, record, memory=memory)
    pose, central, own, (contacts, rejections, no_room) = found
    first = step.start(problem.of_map(episode.map_number), episode, protocol)
    poses, central = jax.tree.map(
        lambda before, after: jnp.concatenate([before[None], after]),
        (first.robots.pose, _central(problem, first)),
        (pose, central),
    )
    return Trace(
        pose=poses[:, 0],
        action=own["action"][:, 0],
        log_det=log_det_spd(central["information"][1:]),
        visible=jnp.any(own["visible"], axis=1),
        contacts=None if contacts is None else jnp.sum(contacts, axis=1),
        dropped=no_room,
        team=TeamTrace(pose=poses, rejections=rejections, **own),
        **central,
    )


def _central(problem: Problem, state: TeamState) -> dict[str, Array]:
    """Fields of a trace at an instant that are of the filter that hears every measurement."""
    central = state.central
    beliefs = {"mean": central.mean, "information": central.information[-1]}
    if isinstance(central, State):
        return {**beliefs, "present": central.present, **expected(problem, central)}
    return {**beliefs, "present": state.robots.present[0]}


def without_room(problem: Problem, state: TeamState) -> Array | None:
    """Number of detections and tracks so far for which any filter of the team had no room; None with ids."""
    central, own = state.central, state.robots.population
    if not isinstance(central, State) or own is None or problem.team is None:
        return None
    count = dropped(central)
    # Where every message arrives at once the robots' filters are the central one.
    return count if count is None or problem.team.radio.kind == "perfect" else count + jnp.sum(own.overflow)


def _members(problem: Problem, robots: State, truth: Float[Array, "instants targets n_y"]) -> dict[str, Array | None]:
    """Fields of a team's trace after a step that are of the robots' own beliefs."""
    information, population = robots.information[:, -1], robots.population
    log_det = log_det_spd(information)
    if population is not None and problem.detections is not None:
        reported = jax.vmap(confirmed, (None, None, 0))(problem, problem.detections, population.tracks)
        tracks = {"mean": robots.mean, "information": information, "confirmed": reported}
        tracks["expected_number"] = jax.vmap(lambda own: own.expected_number)(population)
        return {"log_det": log_det, "nees": None, **tracks}
    error = robots.mean - truth[robots.step[0]]
    weighed = jnp.einsum("mnij,mnj->mni", information, error, precision="highest")
    return {"log_det": log_det, "nees": jnp.sum(error * weighed, axis=-1)}
