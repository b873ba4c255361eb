"""The one simulation that everybody uses: training, evaluation, planning, replay and the environment.

One step k: predict p_{k+1}, P_{k+1}; decide u_k on them at T_k; move to T_{k+1}; the truth moves to y_{k+1};
measure; update to mu_{k+1}, Y_{k+1}.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.geometry.linalg import log_det_spd
from foveate.models.problem import Problem
from foveate.simulation.records import FULL_BACKPROPAGATION, Backpropagation, Episode, Policy, Protocol, Trace
from foveate.simulation.step import act, instants, observe, predict, start
from foveate.types import Key


def _scan(
    problem: Problem,
    policy: Policy,
    episode: Episode,
    protocol: Protocol,
    key: Key,
    record,
    back: Backpropagation = FULL_BACKPROPAGATION,
):
    """Run all steps; `record(state, action, visible, weight)` says what to keep of each."""

    def step(carry, instant):
        state, memory = carry if back.window is None else _forgotten(carry, carry[0].step % back.window == 0)
        predicted = predict(problem, state, instant.known_input)
        observation = observe(predicted, instant.known_input, episode.horizon)
        action, memory = policy(observation, memory, jax.random.fold_in(key, state.step))
        state, visible, weight = act(problem, protocol, predicted, instant, action)
        return (state, memory), record(state, action, visible, weight)

    steps = instants(episode)
    first = start(problem, episode, protocol)
    first_input = jax.tree.map(lambda x: x[0], steps.known_input)
    memory = policy.start(observe(predict(problem, first, first_input), first_input, episode.horizon))
    if back.segment is None:
        return first, jax.lax.scan(step, (first, memory), steps)[1]
    return first, _in_segments(step, (first, memory), steps, back.segment)


def _forgotten(carry, now: Bool[Array, ""]):
    """The same, but without a derivative where `now` holds."""

    def one(x):
        return jnp.where(now, jax.lax.stop_gradient(x), x) if eqx.is_inexact_array(x) else x

    return jax.tree.map(one, carry)


def _in_segments(step, first, steps, length: int):
    """What `lax.scan` keeps of every step, by segments that are run again on the way back."""
    count = len(jax.tree.leaves(steps)[0])
    # The last step over and over fills up the last segment; what comes of that is dropped.
    rows = jnp.minimum(jnp.arange(-(-count // length) * length), count - 1).reshape(-1, length)
    segment = jax.checkpoint(lambda carry, steps: jax.lax.scan(step, carry, steps), prevent_cse=False)
    kept = jax.lax.scan(segment, first, jax.tree.map(lambda x: x[rows], steps))[1]
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[:count], kept)


def rollout(problem: Problem, policy: Policy, episode: Episode, protocol: Protocol, key: Key) -> Trace:
    """One episode, with everything that happened."""

    def record(state, action, visible, weight):
        del weight
        return state.pose, action, state.mean, state.information[-1], visible, state.present, state.rejections

    first, kept = _scan(problem, policy, episode, protocol, key, record)
    pose, action, mean, information, visible, present, rejections = kept

    def with_first(initial, later):
        return jnp.concatenate([initial[None], later])

    return Trace(
        pose=with_first(first.pose, pose),
        action=action,
        mean=with_first(first.mean, mean),
        information=with_first(first.information[-1], information),
        log_det=log_det_spd(information),
        visible=visible,
        present=with_first(first.present, present),
        rejections=rejections,
    )


def log_dets(
    problem: Problem,
    policy: Policy,
    episode: Episode,
    protocol: Protocol,
    key: Key,
    back: Backpropagation = FULL_BACKPROPAGATION,
) -> Float[Array, "K n"]:
    """log det Y_k of every target after every step, the mean over the levels: what training differentiates."""

    def record(state, action, visible, weight):
        del action, visible, weight
        return jnp.mean(log_det_spd(state.information), axis=0)

    return _scan(problem, policy, episode, protocol, key, record, back)[1]


def weights(
    problem: Problem,
    policy: Policy,
    episode: Episode,
    protocol: Protocol,
    key: Key,
    back: Backpropagation = FULL_BACKPROPAGATION,
) -> Float[Array, "K n"]:
    """How far every target is in view after every step, 1 - Phi in the mean over the levels."""

    def record(state, action, visible, weight):
        del state, action, visible
        return jnp.mean(weight, axis=0)

    return _scan(problem, policy, episode, protocol, key, record, back)[1]
