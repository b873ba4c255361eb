"""The one simulation that everybody uses: training, evaluation, planning, replay and the environment.

One step k: predict p_{k+1}, P_{k+1}; decide u_k on them at T_k; move to T_{k+1}; the truth moves to y_{k+1};
measure; update to mu_{k+1}, Y_{k+1}.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foveate.linalg import cholesky_spd, log_det_spd, multiply
from foveate.models import belief, gate
from foveate.models.absence import given_unseen
from foveate.models.belief import Belief
from foveate.models.sensor import PAPER_SOFTNESS, Softness, detection_weight
from foveate.problem import Episode, Observation, Policy, Problem, Trace, first_information
from foveate.types import Action, Count, Key, Pose


class Protocol(NamedTuple):
    """Where information comes from.

    With `levels`, it grows by the soft weight of each level: one information matrix a level, of which the policy sees
    the last. The weight is taken at the predicted mean (the paper), or, `at_truth`, where the target really is, for
    training on episodes with truth. Without levels it grows only with real measurements: the Kalman filter; if the
    sensor's `uses_absence` says so, it learns from looking in vain, too. With a `gate` it refuses measurements whose
    squared distance to their prediction is above that (see `models.gate`).
    """

    levels: tuple[Softness, ...]
    at_truth: bool = False
    gate: float | None = None


SURROGATE = Protocol(levels=(PAPER_SOFTNESS,))
TRUE = Protocol(levels=())
PROTOCOLS = {"surrogate": SURROGATE, "true": TRUE}


class Back(NamedTuple):
    """How a gradient goes back through the steps of an episode.

    With `segment`, only the states at the beginnings of so many steps at a time are remembered, and a segment is run
    again when its turn comes: a third more work, far less memory, and the same gradient. With `window`, it goes no
    further back than to the last step whose number is a multiple of it.
    """

    segment: int | None = None
    window: int | None = None


WHOLE = Back()


class State(eqx.Module):
    """Pose and beliefs after step k; `information` has one matrix for each of the protocol's levels (at least one).

    `refusals` counts each target's measurements that were refused in a row; None without a gate.
    """

    step: Count
    pose: Pose
    mean: Float[Array, "n n_y"]
    information: Float[Array, "levels n n_y n_y"]
    present: Bool[Array, " n"]
    refusals: Int[Array, " n"] | None = None


class Reality(eqx.Module):
    """Where the targets really are after a step, and the standard normals of its measurements."""

    state: Float[Array, "n n_y"]
    noise: Float[Array, "n n_z"]


class Arrival(eqx.Module):
    """Who is there after a step, and the first mean of a belief that begins there."""

    present: Bool[Array, " n"]
    mean: Float[Array, "n n_y"]


class Instant(eqx.Module):
    """The part of an episode that belongs to one step; None where the episode has no such part."""

    known_input: Float[Array, "n m_y"]
    reality: Reality | None
    arrival: Arrival | None


def instants(episode: Episode) -> Instant:
    """An episode cut into its steps: every array gets a leading axis of K."""
    truth, arrivals = episode.truth, episode.arrivals
    reality = None if truth is None else (truth.state[1:], truth.measurement_noise)
    arrival = None if arrivals is None else (arrivals.present[1:], arrivals.mean[1:])

    def cut(known_input, reality, arrival):
        return Instant(known_input, reality and Reality(*reality), arrival and Arrival(*arrival))

    return jax.vmap(cut)(episode.inputs, reality, arrival)


def start(problem: Problem, episode: Episode, protocol: Protocol) -> State:
    """The state before the first step."""
    present = episode.present if episode.arrivals is None else episode.arrivals.present[0]
    information = first_information(problem, episode.mean.shape[0])
    levels = max(1, len(protocol.levels))
    return State(
        step=jnp.zeros((), int),
        pose=episode.pose,
        mean=episode.mean,
        information=jnp.broadcast_to(information, (levels, *information.shape)),
        present=present,
        refusals=None if protocol.gate is None else jnp.zeros(present.shape, int),
    )


def predict(problem: Problem, state: State, known_input: Float[Array, "n m_y"]) -> State:
    """Every belief one step ahead; the pose is still T_k."""
    problem = problem.at(state.step)
    ahead = jax.vmap(jax.vmap(belief.predict_information, (0, None)), (0, None))
    return State(
        step=state.step,
        pose=state.pose,
        mean=problem.motion.advance(state.mean, known_input),
        information=ahead(state.information, problem.motion),
        present=state.present,
        refusals=state.refusals,
    )


def observe(predicted: State, known_input: Float[Array, "n m_y"], horizon: Count) -> Observation:
    """What a policy sees of a predicted state in an episode of `horizon` steps."""
    return Observation(
        step=predicted.step,
        left=horizon - predicted.step,
        pose=predicted.pose,
        mean=predicted.mean,
        information=predicted.information[-1],
        present=predicted.present,
        known_input=known_input,
    )


def act(
    problem: Problem, protocol: Protocol, predicted: State, instant: Instant, action: Action
) -> tuple[State, Bool[Array, " n"], Float[Array, "levels n"]]:
    """Move, measure and update; also which targets were really measured, and the weight each level gives them."""
    problem = problem.at(predicted.step)
    sensor, motion, space = problem.sensor, problem.motion, problem.agent.space
    pose = problem.agent.move(predicted.pose, action, problem.tau)
    rotation = space.rotation(pose)
    point_body = space.to_body(pose, motion.position(predicted.mean))
    covariance = jax.vmap(sensor.covariance, (None, 0))(rotation, point_body)
    gain = jax.vmap(sensor.information)(covariance)

    mean, refusals = predicted.mean, predicted.refusals
    inside = visible = jnp.zeros(predicted.present.shape, bool)
    restarts, anew = None, None
    weighed_point_body = point_body
    if (reality := instant.reality) is not None:
        true_point_body = space.to_body(pose, motion.position(reality.state))
        inside = sensor.view.contains(true_point_body) & predicted.present
        weighed_point_body = true_point_body if protocol.at_truth else point_body
        if instant.arrival is not None:
            inside = inside & instant.arrival.present
        true_covariance = jax.vmap(sensor.covariance, (None, 0))(rotation, true_point_body)
        noise = multiply(cholesky_spd(true_covariance), reality.noise[..., None])
        measurement = reality.state @ sensor.H.T + noise[..., 0]
        corrected = jax.vmap(lambda p, P, z, V: belief.correct_mean(Belief(p, P), z, sensor.H, V))(
            predicted.mean, predicted.information[-1], measurement, covariance
        )
        visible = inside
        if protocol.gate is not None:
            assert refusals is not None, "`start` counts them where there is a gate"
            visible, restarts, refusals, anew = _gated(
                problem, protocol.gate, predicted, refusals, inside, measurement, covariance
            )
        mean = jnp.where(visible[:, None], corrected, mean)

    if protocol.levels:
        distance = sensor.view.signed_distance(weighed_point_body)
        weight = jnp.stack([detection_weight(distance, level) for level in protocol.levels])
    else:
        weight = visible.astype(mean.dtype)[None]
    update = jax.vmap(jax.vmap(belief.update_information), (0, None, 0))
    information = update(predicted.information, gain, weight)
    if restarts is not None and anew is not None:
        mean = jnp.where(restarts[:, None], anew.mean, mean)
        information = jnp.where(restarts[:, None, None], anew.information, information)
    if sensor.uses_absence and not protocol.levels and instant.reality is not None:
        is_inside = partial(_in_view, problem, pose)
        left = jax.vmap(lambda m, Y: given_unseen(Belief(m, Y), motion.Z, is_inside))(mean, information[0])
        mean = jnp.where(inside[:, None], mean, left.mean)
        information = jnp.where(inside[:, None, None], information, left.information)

    present = predicted.present
    if (arrival := instant.arrival) is not None:
        begins = arrival.present & ~predicted.present
        mean = jnp.where(begins[:, None], arrival.mean, mean)
        information = jnp.where(begins[:, None, None], problem.prior_information, information)
        present = arrival.present
        refusals = None if refusals is None else jnp.where(begins, 0, refusals)
    return State(predicted.step + 1, pose, mean, information, present, refusals), visible, weight


def _gated(
    problem: Problem,
    limit: float,
    predicted: State,
    refusals: Int[Array, " n"],
    inside: Bool[Array, " n"],
    measurement: Float[Array, "n n_z"],
    covariance: Float[Array, "n n_z n_z"],
) -> tuple[Bool[Array, " n"], Bool[Array, " n"], Int[Array, " n"], Belief]:
    """Whose measurement is taken, whose belief begins anew with it, the refusals in a row, and these new beliefs."""
    H, first = problem.sensor.H, problem.prior_information

    def look(mean, information, z, V):
        return gate.squared_distance(Belief(mean, information), z, H, V), gate.one_point(first, z, H, V)

    distance, anew = jax.vmap(look)(predicted.mean, predicted.information[-1], measurement, covariance)
    refused = inside & ~(distance <= limit)
    restarts = refused & (refusals + 1 >= gate.RESTART_AFTER)
    taken = (inside & ~refused) | restarts
    return taken, restarts, jnp.where(taken, 0, refusals + refused), anew


def _in_view(problem: Problem, pose: Pose, positions_world: Float[Array, "points d"]) -> Bool[Array, " points"]:
    return problem.sensor.view.contains(problem.agent.space.to_body(pose, positions_world))


def _scan(problem: Problem, policy: Policy, episode: Episode, protocol: Protocol, key: Key, record, back: Back = WHOLE):
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
        return state.pose, action, state.mean, state.information[-1], visible, state.present, state.refusals

    first, kept = _scan(problem, policy, episode, protocol, key, record)
    pose, action, mean, information, visible, present, refusals = kept

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
        refusals=refusals,
    )


def log_dets(
    problem: Problem, policy: Policy, episode: Episode, protocol: Protocol, key: Key, back: Back = WHOLE
) -> Float[Array, "K n"]:
    """log det Y_k of every target after every step, the mean over the levels: what training differentiates."""

    def record(state, action, visible, weight):
        del action, visible, weight
        return jnp.mean(log_det_spd(state.information), axis=0)

    return _scan(problem, policy, episode, protocol, key, record, back)[1]


def weights(
    problem: Problem, policy: Policy, episode: Episode, protocol: Protocol, key: Key, back: Back = WHOLE
) -> Float[Array, "K n"]:
    """How far every target is in view after every step, 1 - Phi in the mean over the levels."""

    def record(state, action, visible, weight):
        del state, action, visible
        return jnp.mean(weight, axis=0)

    return _scan(problem, policy, episode, protocol, key, record, back)[1]
