"""The one simulation: training, evaluation, planning and replay run `simulate`, and the environment runs its step.

Step k: predict p_{k+1}, P_{k+1}; decide u_k on them at T_k; move to T_{k+1}; the truth moves to y_{k+1}; measure;
update to mu_{k+1}, Y_{k+1}.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from foveate.errors import InputError
from foveate.geometry.linalg import log_det_spd
from foveate.models.problem import Problem
from foveate.models.robot import Robot
from foveate.simulation import step
from foveate.simulation.records import Backpropagation, Episode, Observation, Policy, Protocol, State, Trace, observe
from foveate.simulation.scans import dropped, expected
from foveate.simulation.team.rollout import rollout as team_rollout
from foveate.types import Action, Key

FULL_BACKPROPAGATION = Backpropagation()
"""A gradient through all steps, with all states stored."""

Decide = Callable[[Observation, Any, Key], tuple[Action, Any, Any]]
"""(observation, memory, key) -> (action, memory for the next step, notes): a policy, with notes for the record."""


class Outcome(NamedTuple):
    """Result of one step, to be recorded in part: `state` is that after it, `notes` are the decision's own.

    `action` is that which was done: the decision's, or what a distance to obstacles has left of it.
    """

    observation: Observation
    action: Action
    notes: Any
    state: State
    measured: Bool[Array, " n"]
    weight: Float[Array, "levels n"]


def simulate(
    problem: Problem,
    decide: Decide,
    episode: Episode,
    protocol: Protocol,
    key: Key,
    record: Callable[[Outcome], PyTree],
    *,
    memory: Any = (),
    state: State | None = None,
    back: Backpropagation = FULL_BACKPROPAGATION,
) -> PyTree:
    """Run all steps of an episode, the one scan over steps; return the records, each array with a leading axis of K.

    `decide` gets `key` folded with the number of the step, and at the first step `memory`. The simulation begins with
    `state`, by default the start of the episode. A gradient goes through all steps unless `back` says otherwise.
    """
    problem = problem.of_map(episode.map_number)
    robot = Robot.of(problem)

    def advance(carry, instant):
        if back.window is not None:
            carry = _detached(carry, carry[0].step % back.window == 0)
        state, memory = carry
        predicted = step.predict(problem, state, instant.known_input)
        observation = observe(predicted, instant.known_input, episode.horizon, robot)
        action, memory, notes = decide(observation, memory, jax.random.fold_in(key, state.step))
        draft = step.act(problem, protocol, predicted, instant, action)
        outcome = Outcome(observation, draft.action, notes, draft.state, draft.measured, draft.weight)
        return (draft.state, memory), record(outcome)

    first = (step.start(problem, episode, protocol) if state is None else state, memory)
    if back.segment is None:
        return jax.lax.scan(advance, first, step.instants(episode))[1]
    return _rematerialised_scan(advance, first, step.instants(episode), back.segment)


def decider(policy: Policy) -> Decide:
    """A policy as `simulate` takes it, without notes."""
    return lambda observation, memory, key: (*policy(observation, memory, key), ())


def _detached(carry: PyTree, condition: Bool[Array, ""]) -> PyTree:
    """The same values, without a derivative where the condition holds: truncated backpropagation through time."""

    def detach(x):
        return jnp.where(condition, jax.lax.stop_gradient(x), x) if eqx.is_inexact_array(x) else x

    return jax.tree.map(detach, carry)


def _rematerialised_scan(step, first, steps, length: int):
    """The records of `lax.scan`, by segments of `length` steps that the backward pass runs again."""
    count = len(jax.tree.leaves(steps)[0])
    # The last segment is filled up by repeating the last step; the records of that are dropped.
    rows = jnp.minimum(jnp.arange(-(-count // length) * length), count - 1).reshape(-1, length)
    segment = jax.checkpoint(lambda carry, steps: jax.lax.scan(step, carry, steps), prevent_cse=False)
    kept = jax.lax.scan(segment, first, jax.tree.map(lambda x: x[rows], steps))[1]
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[:count], kept)


def _play(
    problem: Problem,
    policy: Policy,
    episode: Episode,
    protocol: Protocol,
    key: Key,
    record,
    back: Backpropagation = FULL_BACKPROPAGATION,
) -> PyTree:
    """Simulate an episode of a single robot with a policy. Raises InputError for a team's."""
    if episode.team is not None:
        raise InputError("scenario.team: expected none: only policies that are rolled out have a team")
    problem = problem.of_map(episode.map_number)
    predicted = step.predict(problem, step.start(problem, episode, protocol), episode.inputs[0])
    memory = policy.start(observe(predicted, episode.inputs[0], episode.horizon, Robot.of(problem)))
    return simulate(problem, decider(policy), episode, protocol, key, record, memory=memory, back=back)


def rollout(problem: Problem, policy: Policy, episode: Episode, protocol: Protocol, key: Key) -> Trace:
    """Run one episode and record everything.

    Args:
        problem: Models of agent, sensor and targets.
        policy: Policy that decides at every step.
        episode: One episode, without a batch axis.
        protocol: Source of information.
        key: Random key of the policy.
    """
    if episode.team is not None:
        return team_rollout(problem, policy, episode, protocol, key)

    def columns(state: State):
        belief = {"mean": state.mean, "information": state.information[-1], "present": state.present}
        return {"pose": state.pose, **belief, **expected(problem, state)}

    def record(outcome: Outcome):
        state = outcome.state
        return columns(state), outcome.action, outcome.measured, (state.rejections, state.contacts, dropped(state))

    states, action, visible, counts = _play(problem, policy, episode, protocol, key, record)
    first = columns(step.start(problem, episode, protocol))
    states = jax.tree.map(lambda before, after: jnp.concatenate([before[None], after]), first, states)
    log_det = log_det_spd(states["information"][1:])
    rejections, contacts, no_room = counts
    counted = {"rejections": rejections, "contacts": contacts, "dropped": no_room}
    return Trace(**states, action=action, log_det=log_det, visible=visible, **counted)


def log_dets(
    problem: Problem,
    policy: Policy,
    episode: Episode,
    protocol: Protocol,
    key: Key,
    back: Backpropagation = FULL_BACKPROPAGATION,
) -> Float[Array, "K n"]:
    """log det Y_k of every target after every step, the mean over the levels: the objective of training."""

    def record(outcome: Outcome):
        return jnp.mean(log_det_spd(outcome.state.information), axis=0)

    return _play(problem, policy, episode, protocol, key, record, back)


def weights(
    problem: Problem,
    policy: Policy,
    episode: Episode,
    protocol: Protocol,
    key: Key,
    back: Backpropagation = FULL_BACKPROPAGATION,
) -> Float[Array, "K n"]:
    """Weight 1 - Phi of every target after every step, the mean over the levels."""
    return _play(problem, policy, episode, protocol, key, lambda outcome: jnp.mean(outcome.weight, axis=0), back)
