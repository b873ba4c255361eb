"""One step of a team: the stages of a single robot for each of them, and then the exchange of what they know.

Every robot predicts, observes and decides by itself, then moves, senses and updates its own beliefs by the stages of
`simulation.step`. The exchange gives each the evidence that it hears.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.models.problem import Problem
from foveate.models.robot import Robot
from foveate.simulation import step
from foveate.simulation.draft import Draft
from foveate.simulation.records import Episode, Instant, Observation, Protocol, ScanNoise, State, Truth, observe
from foveate.simulation.team import scan_window, window
from foveate.simulation.team.evidence import evidence, fresh
from foveate.simulation.team.exchange import Mail, TeamState, exchange, exchange_scans, with_beliefs
from foveate.simulation.team.mate_scans import scans_of_all
from foveate.simulation.team.radio import first_roster, own_news, views
from foveate.simulation.team.records import TeamDraws, TeamView
from foveate.simulation.team.tracks import of_first, with_tracks_of
from foveate.simulation.team.window import Beliefs, Message
from foveate.types import Action, Count


def start(problem: Problem, episode: Episode, protocol: Protocol) -> TeamState:
    """The state before the first step."""
    assert problem.team is not None, "of a team's problems"
    poses, radio = first_poses(episode), problem.team.radio
    robots = jax.vmap(lambda pose: step.start(problem, replace(episode, pose=pose, team=None), protocol))(poses)
    roster = first_roster(poses, episode.mean.shape[0])
    first = of_first(robots)
    central = first if problem.detections is not None else Beliefs(first.mean, first.information)
    if radio.kind != "lossy":
        return TeamState(robots, central, roster)
    if robots.population is not None:
        base, begun = robots.population, scan_window.first_window(problem, robots.population, poses)
    else:
        base = Beliefs(robots.mean, robots.information)
        has_fresh = episode.arrivals is not None or protocol.gate is not None
        begun = window.first_window(problem, base, max(1, len(protocol.levels)), has_fresh)
    mail = None
    if radio.delay:
        silence = jnp.zeros((len(poses), len(poses)), bool)
        one = Mail(Message(begun.knows, base), roster, silence)
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
    one = step.predict(problem, of_first(robots), known_input)
    if problem.detections is not None:
        return with_tracks_of(robots, one)
    beliefs = (jnp.broadcast_to(x, (len(robots.pose), *x.shape)) for x in (one.mean, one.information))
    return with_beliefs(state, Beliefs(*beliefs)).robots


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
        after, heard = exchange_scans(problem, state, predicted, instant.known_input, draws, drafts, claims)
        return after, drafts, heard
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
