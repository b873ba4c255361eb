"""One step of a team: the stages of a single robot for each of them, and then the exchange of what they know.

Every robot predicts, observes and decides by itself, then moves, senses and updates its own beliefs by the stages of
`simulation.step`. The exchange gives each the evidence that it hears.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.models.problem import Problem
from foveate.models.robot import Robot
from foveate.simulation import step
from foveate.simulation.draft import Draft
from foveate.simulation.records import Episode, Instant, Observation, Protocol, ScanNoise, State, Truth, observe
from foveate.simulation.team import window
from foveate.simulation.team.evidence import evidence, fresh
from foveate.simulation.team.mate_scans import scans_of_all
from foveate.simulation.team.radio import Roster, first_roster, links, merged, own_news, views
from foveate.simulation.team.records import TeamDraws, TeamView
from foveate.simulation.team.tracks import central_after, with_tracks_of
from foveate.simulation.team.window import Beliefs, Message, Window
from foveate.types import Action, Count


class Mail(NamedTuple):
    """A message of every robot, and whom it will reach."""

    message: Message
    roster: Roster
    heard: Bool[Array, "M M"]


class TeamState(eqx.Module):
    """Robots after a step, each as a single one's state with a leading axis of M, and what is on its way.

    `central` are the beliefs of a filter that hears every measurement at once; without ids its state. `window` and
    `mail`, the messages of the last steps that have not arrived, are None for a radio that is perfect or silent.
    """

    robots: State
    central: Beliefs | State
    roster: Roster
    window: Window | None = None
    mail: Mail | None = None


def start(problem: Problem, episode: Episode, protocol: Protocol) -> TeamState:
    """The state before the first step."""
    assert problem.team is not None, "of a team's problems"
    poses, radio = first_poses(episode), problem.team.radio
    robots = jax.vmap(lambda pose: step.start(problem, replace(episode, pose=pose, team=None), protocol))(poses)
    roster = first_roster(poses, episode.mean.shape[0])
    first = _of_first(robots)
    central = first if problem.detections is not None else Beliefs(first.mean, first.information)
    if radio.kind != "lossy":
        return TeamState(robots, central, roster)
    beliefs = Beliefs(robots.mean, robots.information)
    has_fresh = episode.arrivals is not None or protocol.gate is not None
    begun, mail = window.first_window(problem, beliefs, max(1, len(protocol.levels)), has_fresh), None
    if radio.delay:
        silence = jnp.zeros((len(poses), len(poses)), bool)
        one = Mail(Message(begun.knows, beliefs), roster, silence)
        mail = jax.tree.map(lambda x: jnp.broadcast_to(x, (radio.delay, *x.shape)), one)
    return TeamState(robots, central, roster, begun, mail)


def first_poses(episode: Episode) -> Float[Array, "M ..."]:
    """The poses with which all robots start."""
    assert episode.team is not None, "of a team's episodes"
    return jnp.concatenate([episode.pose[None], episode.team.poses])


def predict(problem: Problem, state: TeamState, known_input: Float[Array, "n m_y"]) -> State:
    """Every robot's beliefs, predicted one step ahead: once for all where every message arrives at once."""
    assert problem.team is not None, "of a team's problems"
    robots = state.robots
    if problem.team.radio.kind != "perfect":
        return jax.vmap(step.predict, (None, 0, None))(problem, robots, known_input)
    one = step.predict(problem, _of_first(robots), known_input)
    if problem.detections is not None:
        return with_tracks_of(robots, one)
    beliefs = (jnp.broadcast_to(x, (len(robots.pose), *x.shape)) for x in (one.mean, one.information))
    return _with_beliefs(state, Beliefs(*beliefs)).robots


def observations(
    problem: Problem, state: TeamState, predicted: State, known_input: Float[Array, "n m_y"], horizon: Count
) -> Observation:
    """What every robot observes, with a leading axis of M."""

    def of_robot(own: State, view: TeamView) -> Observation:
        return observe(own, known_input, horizon, Robot.of(problem.of_robot(view.number)), view)

    return jax.vmap(of_robot)(predicted, views(state.roster, predicted.step[0]))


def act(
    problem: Problem,
    protocol: Protocol,
    state: TeamState,
    predicted: State,
    instant: Instant,
    draws: TeamDraws,
    decided: tuple[Float[Array, "M m"], Float[Array, "M n"]],
) -> tuple[TeamState, Draft, Bool[Array, "M M"]]:
    """The state after one step of all robots, the drafts of their own steps, and who has heard whom.

    `decided` are their actions and claims.
    """
    action, claims = decided
    drafts = _drafts(problem, protocol, predicted, instant, draws, action)
    number = predicted.step[0]
    if problem.detections is not None:
        return _share_scans(problem, state, predicted, instant, draws, drafts, claims)
    reference = predicted.mean[0]
    told = jax.vmap(lambda draft: evidence(problem, draft, reference))(drafts)
    begun = jax.vmap(fresh)(drafts) if drafts.restart is not None or instant.arrivals is not None else None
    measured = window.Step(told, reference, instant.known_input, begun)
    assert isinstance(state.central, Beliefs), "of detections with ids"
    one = jax.tree.map(lambda x: x[None], state.central)
    everything = jnp.ones((1, len(action)), bool)
    central = jax.tree.map(lambda x: x[0], window.updated(problem, one, measured, everything, number))
    after = replace(
        state,
        robots=drafts.state,
        central=central,
        roster=own_news(state.roster, number + 1, drafts.state.pose, claims),
    )
    after, heard = exchange(problem, after, measured, draws, number)
    return after, drafts, heard


def _share_scans(
    problem: Problem,
    state: TeamState,
    predicted: State,
    instant: Instant,
    draws: TeamDraws,
    drafts: Draft,
    claims: Float[Array, "M n"],
) -> tuple[TeamState, Draft, Bool[Array, "M M"]]:
    """What `act` returns where detections have no ids, after the drafts of the robots' own steps."""
    assert problem.team is not None, "of a team's problems"
    assert isinstance(state.central, State), "of detections without ids"
    radio, robots, number = problem.team.radio, drafts.state, predicted.step[0]
    is_shared = radio.kind == "perfect"
    # Where all have the same population, it has been predicted already.
    before = _of_first(predicted) if is_shared else step.predict(problem, state.central, instant.known_input)
    central = central_after(problem, before, drafts)
    heard = links(radio, problem.agent.space, robots.pose, draws.radio)
    roster = own_news(state.roster, number + 1, robots.pose, claims)
    if is_shared:
        robots, roster = with_tracks_of(robots, central), merged(roster, roster, heard)
    return replace(state, robots=robots, central=central, roster=roster), drafts, heard


def exchange(
    problem: Problem, state: TeamState, measured: window.Step, draws: TeamDraws, number: Count
) -> tuple[TeamState, Bool[Array, "M M"]]:
    """The state after the messages of step `number`, and whom those that are sent in it reach."""
    assert problem.team is not None, "of a team's problems"
    radio, poses = problem.team.radio, state.robots.pose
    heard = links(radio, problem.agent.space, poses, draws.radio)
    if radio.kind == "silent":
        return state, heard
    if radio.kind == "perfect":
        shared = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(poses), *x.shape)), state.central)
        return replace(_with_beliefs(state, shared), roster=merged(state.roster, state.roster, heard)), heard

    assert state.window is not None, "`start` makes one for a lossy radio"
    own = window.shifted(state.window, measured)
    arriving, waiting = Mail(Message(own.knows, own.base), state.roster, heard), None
    if radio.delay:
        arriving, waiting = (jax.tree.map(part, state.mail) for part in (lambda x: x[0], lambda x: x[1:]))
    known = window.received(own, arriving.message, arriving.heard, radio.delay)
    roster = merged(state.roster, arriving.roster, arriving.heard)
    course = window.filtered(problem, known, number)
    state = _with_beliefs(state, jax.tree.map(lambda x: x[-1], course))
    following = replace(known, base=jax.tree.map(lambda x: x[0], course))
    if waiting is not None:
        # Its base is that of the window in which it will arrive.
        base = jax.tree.map(lambda x: x[radio.delay - 1], course)
        sent = Mail(Message(known.knows, base), roster, heard)
        waiting = jax.tree.map(lambda old, new: jnp.concatenate([old, new[None]]), waiting, sent)
    return replace(state, roster=roster, window=following, mail=waiting), heard


def _with_beliefs(state: TeamState, beliefs: Beliefs) -> TeamState:
    def take(robot: State, mean: Array, information: Array) -> State:
        return replace(robot, mean=mean, information=information)

    return replace(state, robots=jax.vmap(take)(state.robots, *beliefs))


def _drafts(
    problem: Problem,
    protocol: Protocol,
    predicted: State,
    instant: Instant,
    draws: TeamDraws,
    action: Float[Array, "M m"],
) -> Draft:
    """The robots' own steps: each by its own limits, view and noise, and kept off the others."""
    truth = instant.truth
    assert truth is not None, "a team's episodes have truth"
    noise = jnp.concatenate([truth.measurement_noise[None], draws.measurement_noise])
    positions, count = jax.vmap(problem.agent.space.position)(predicted.pose), len(action)
    others = jnp.arange(count)[:, None] + jnp.arange(1, count)
    mates = positions[others % count] if problem.keep_off_m is not None else None
    scans = scans_of_all(instant, draws)

    def draft(
        number: Count, robot: State, action: Action, noise: Array, mates: Array | None, scans: ScanNoise | None
    ) -> Draft:
        own = replace(instant, truth=Truth(truth.state, noise), mates_world=mates, scans=scans)
        return step.act(problem.of_robot(number), protocol, robot, own, action)

    return jax.vmap(draft)(jnp.arange(count), predicted, action, noise, mates, scans)


def _of_first(robots: State) -> State:
    return jax.tree.map(lambda x: x[0], robots)
