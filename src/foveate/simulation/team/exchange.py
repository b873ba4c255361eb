"""What the robots of a team know and what is on its way between them, and what they make of it after a step."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.models.problem import Problem
from foveate.simulation import step
from foveate.simulation.draft import Draft
from foveate.simulation.records import State
from foveate.simulation.scans import shown
from foveate.simulation.team import scan_window, window
from foveate.simulation.team.radio import Roster, links, merged, own_news
from foveate.simulation.team.records import TeamDraws
from foveate.simulation.team.scan_window import ScanStep, ScanWindow
from foveate.simulation.team.tracks import central_after, of_first, with_tracks_of
from foveate.simulation.team.window import Beliefs, Message, Window
from foveate.types import Count


class Fusion(NamedTuple):
    """Fusion of what a lossy radio brings: the functions of a window of measurements, or of one of scans."""

    shifted: Callable[..., Any]
    received: Callable[..., Any]
    filtered: Callable[..., Any]
    begun_later: Callable[..., Any]


OF_MEASUREMENTS = Fusion(window.shifted, window.received, window.filtered, window.begun_later)
OF_SCANS = Fusion(scan_window.shifted, scan_window.received, scan_window.filtered, scan_window.begun_later)


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
    window: Window | ScanWindow | None = None
    mail: Mail | None = None


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
        return replace(with_beliefs(state, shared), roster=merged(state.roster, state.roster, heard)), heard
    state, course = _relayed(problem, state, measured, heard, number)
    return with_beliefs(state, jax.tree.map(lambda x: x[-1], course)), heard


def exchange_scans(
    problem: Problem,
    state: TeamState,
    predicted: State,
    known_input: Float[Array, "n m_y"],
    draws: TeamDraws,
    drafts: Draft,
    claims: Float[Array, "M n"],
) -> tuple[TeamState, Bool[Array, "M M"]]:
    """As `exchange`, where detections have no ids: after the `drafts` of the robots' own steps, and their claims."""
    assert problem.team is not None, "of a team's problems"
    assert isinstance(state.central, State), "of detections without ids"
    assert drafts.scan is not None, "of detections without ids"
    radio, robots, number = problem.team.radio, drafts.state, predicted.step[0]
    is_shared = radio.kind == "perfect"
    # Where all have the same population, it has been predicted already.
    before = of_first(predicted) if is_shared else step.predict(problem, state.central, known_input)
    central = central_after(problem, before, drafts)
    heard = links(radio, problem.agent.space, robots.pose, draws.radio)
    # Elsewhere a slot is another track's for each robot.
    roster = own_news(state.roster, number + 1, robots.pose, claims if is_shared else jnp.zeros_like(claims))
    if is_shared:
        robots, roster = with_tracks_of(robots, central), merged(roster, roster, heard)
    state = replace(state, robots=robots, central=central, roster=roster)
    if radio.kind != "lossy":
        return state, heard
    state, course = _relayed(problem, state, ScanStep(robots.pose, drafts.scan), heard, number)
    own = jax.tree.map(lambda x: x[-1], course)
    return replace(state, robots=jax.vmap(lambda one, its: shown(problem, one, its))(robots, own)), heard


def _relayed(
    problem: Problem, state: TeamState, measured: Any, heard: Bool[Array, "M M"], number: Count
) -> tuple[TeamState, Any]:
    """The state with what is on its way after a step, and the beliefs of every robot after each step of its window."""
    assert problem.team is not None, "of a team's problems"
    assert state.window is not None, "`start` makes one for a lossy radio"
    delay = problem.team.radio.delay
    fusion = OF_MEASUREMENTS if problem.detections is None else OF_SCANS
    own = fusion.shifted(state.window, measured)
    arriving, waiting = Mail(Message(own.knows, own.base), state.roster, heard), None
    if delay:
        arriving, waiting = (jax.tree.map(part, state.mail) for part in (lambda x: x[0], lambda x: x[1:]))
    known = fusion.received(problem, own, arriving.message, arriving.heard, delay)
    roster = merged(state.roster, arriving.roster, arriving.heard)
    course = fusion.filtered(problem, known, number)
    following = fusion.begun_later(problem, known, course, number)
    if waiting is not None:
        # Its base is that of the window in which it will arrive.
        base = jax.tree.map(lambda x: x[delay - 1], course)
        sent = Mail(Message(known.knows, base), roster, heard)
        waiting = jax.tree.map(lambda old, new: jnp.concatenate([old, new[None]]), waiting, sent)
    return replace(state, roster=roster, window=following, mail=waiting), course


def with_beliefs(state: TeamState, beliefs: Beliefs) -> TeamState:
    """The state in which the robots have these beliefs."""

    def take(robot: State, mean: Array, information: Array) -> State:
        return replace(robot, mean=mean, information=information)

    return replace(state, robots=jax.vmap(take)(state.robots, *beliefs))
