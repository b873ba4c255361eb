"""The one simulation that everybody uses: training, evaluation, planning and replay run `simulate`, the environment its
step.

One step k: predict p_{k+1}, P_{k+1}; decide u_k on them at T_k; move to T_{k+1}; the truth moves to y_{k+1};
measure; update to mu_{k+1}, Y_{k+1}.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PyTree

from foveate.geometry.linalg import log_det_spd
from foveate.models.problem import Problem
from foveate.simulation.records import (
    FULL_BACKPROPAGATION,
    Backpropagation,
    Episode,
    Observation,
    Policy,
    Protocol,
    State,
    Trace,
)
from foveate.simulation.step import act, instants, observe, predict, start
from foveate.types import Action, Key

Decide = Callable[[Observation, Any, Key], tuple[Action, Any, Any]]
"""(observation, memory, key) -> (action, memory for the next step, notes): a policy, with notes for the record."""


class Outcome(NamedTuple):
    """What a record may keep of one step: `state` is that after it, `notes` are the decision's own."""

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
    backpropagation: Backpropagation = FULL_BACKPROPAGATION,
) -> PyTree:
    """Run all steps of an episode: the one scan over steps.

    Args:
        problem: Agent, sensor and motion.
        decide: What is done at each step; its key is `key` folded with the number of the step.
        episode: Inputs, and truth and arrivals where it has them, of K steps.
        protocol: Where information comes from.
        key: Random numbers of the decisions.
        record: What to keep of every step.
        memory: The memory before the first decision.
        state: Where to begin; by default the start of the episode.
        backpropagation: How a gradient goes back through the steps.

    Returns:
        What `record` kept, each array with a leading axis of K.
    """

    def step(carry, instant):
        if backpropagation.window is not None:
            carry = _detached(carry, carry[0].step % backpropagation.window == 0)
        state, memory = carry
        predicted = predict(problem, state, instant.known_input)
        observation = observe(predicted, instant.known_input, episode.horizon)
        action, memory, notes = decide(observation, memory, jax.random.fold_in(key, state.step))
        done = act(problem, protocol, predicted, instant, action)
        outcome = Outcome(observation, action, notes, done.state, done.measured, done.weight)
        return (done.state, memory), record(outcome)

    first = (start(problem, episode, protocol) if state is None else state, memory)
    if backpropagation.segment is None:
        return jax.lax.scan(step, first, instants(episode))[1]
    return _rematerialised_scan(step, first, instants(episode), backpropagation.segment)


def following(policy: Policy) -> Decide:
    """A policy as `simulate` takes it, without notes."""
    return lambda observation, memory, key: (*policy(observation, memory, key), ())


def first_memory(problem: Problem, policy: Policy, episode: Episode, protocol: Protocol) -> Any:
    """The memory of a policy before its first decision of an episode."""
    known_input = episode.inputs[0]
    predicted = predict(problem, start(problem, episode, protocol), known_input)
    return policy.start(observe(predicted, known_input, episode.horizon))


def _detached(carry: PyTree, here: Bool[Array, ""]) -> PyTree:
    """The same values, without a derivative where `here` holds: truncated backpropagation through time."""

    def detach(x):
        return jnp.where(here, jax.lax.stop_gradient(x), x) if eqx.is_inexact_array(x) else x

    return jax.tree.map(detach, carry)


def _rematerialised_scan(step, first, steps, length: int):
    """What `lax.scan` keeps of every step, by segments of `length` steps that are run again on the way back."""
    count = len(jax.tree.leaves(steps)[0])
    # The last segment is filled up by repeating the last step; what comes of that is dropped.
    rows = jnp.minimum(jnp.arange(-(-count // length) * length), count - 1).reshape(-1, length)
    segment = jax.checkpoint(lambda carry, steps: jax.lax.scan(step, carry, steps), prevent_cse=False)
    kept = jax.lax.scan(segment, first, jax.tree.map(lambda x: x[rows], steps))[1]
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[:count], kept)


def _play(problem: Problem, policy: Policy, episode: Episode, protocol: Protocol, key: Key, record, **how) -> PyTree:
    memory = first_memory(problem, policy, episode, protocol)
    return simulate(problem, following(policy), episode, protocol, key, record, memory=memory, **how)


def rollout(problem: Problem, policy: Policy, episode: Episode, protocol: Protocol, key: Key) -> Trace:
    """One episode, with everything that happened."""

    def record(done: Outcome):
        state = done.state
        states = (state.pose, state.mean, state.information[-1], state.present)
        return states, done.action, done.measured, state.rejections

    states, action, visible, rejections = _play(problem, policy, episode, protocol, key, record)
    first = start(problem, episode, protocol)
    initial = (first.pose, first.mean, first.information[-1], first.present)
    pose, mean, information, present = (
        jnp.concatenate([before[None], after]) for before, after in zip(initial, states, strict=True)
    )
    return Trace(
        pose=pose,
        action=action,
        mean=mean,
        information=information,
        log_det=log_det_spd(information[1:]),
        visible=visible,
        present=present,
        rejections=rejections,
    )


def log_dets(
    problem: Problem,
    policy: Policy,
    episode: Episode,
    protocol: Protocol,
    key: Key,
    backpropagation: Backpropagation = FULL_BACKPROPAGATION,
) -> Float[Array, "K n"]:
    """log det Y_k of every target after every step, the mean over the levels: what training differentiates."""

    def record(done: Outcome):
        return jnp.mean(log_det_spd(done.state.information), axis=0)

    return _play(problem, policy, episode, protocol, key, record, backpropagation=backpropagation)


def weights(
    problem: Problem,
    policy: Policy,
    episode: Episode,
    protocol: Protocol,
    key: Key,
    backpropagation: Backpropagation = FULL_BACKPROPAGATION,
) -> Float[Array, "K n"]:
    """How far every target is in view after every step, 1 - Phi in the mean over the levels."""

    def record(done: Outcome):
        return jnp.mean(done.weight, axis=0)

    return _play(problem, policy, episode, protocol, key, record, backpropagation=backpropagation)
