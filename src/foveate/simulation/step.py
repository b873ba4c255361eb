"""One step of the simulation as a tuple of named pure stages, fixed once for an episode by `stages`.

Step k: predict p_{k+1}, P_{k+1}; observe; decide u_k at T_k; then the stages: move to T_{k+1}, sense y_{k+1}, gate
(association), weigh, correct and update to mu_{k+1}, Y_{k+1}. What a scenario does not have (truth, a gate, missed
detections, births and deaths) has no stage, and costs nothing.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.geometry.linalg import cholesky_spd, multiply
from foveate.models import belief, gate
from foveate.models.belief import Belief
from foveate.models.missed_detection import given_missed_detection
from foveate.models.problem import Problem, first_information
from foveate.models.sensor import detection_weight
from foveate.simulation.records import Arrival, Episode, Instant, Observation, Protocol, Reality, State
from foveate.types import Action, Count, Pose


class Sensed(NamedTuple):
    """Measurements z = H y + eta of every target, also of those outside of the view.

    `position_body` is where each target really is, `in_view` whether that is inside of the field of view.
    """

    position_body: Float[Array, "n d"]
    in_view: Bool[Array, " n"]
    measurement: Float[Array, "n n_z"]


class Restart(NamedTuple):
    """Beliefs that begin again at their measurement: which, and the new ones (of all, used where `where` holds)."""

    where: Bool[Array, " n"]
    belief: Belief


class Draft(NamedTuple):
    """A step under way: what its stages have found so far.

    `state` begins as the predicted one and ends as that after the update. `covariance` is V as the filter believes it,
    at the predicted means; `measured` says whose measurement is taken; `weight` how much of a measurement's
    information each level counts.
    """

    predicted: State
    action: Action
    instant: Instant
    state: State
    covariance: Float[Array, "n n_z n_z"]
    measured: Bool[Array, " n"]
    weight: Float[Array, "levels n"]
    sensed: Sensed | None = None
    restart: Restart | None = None


Stage = Callable[[Problem, Protocol, Draft], Draft]
"""Part of a step, given the problem of that step alone (`Problem.at`)."""


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
        rejections=None if protocol.gate is None else jnp.zeros(present.shape, int),
    )


def predict(problem: Problem, state: State, known_input: Float[Array, "n m_y"]) -> State:
    """Every belief one step ahead; the pose is still T_k."""
    problem = problem.at(state.step)
    ahead = jax.vmap(jax.vmap(belief.predict_information, (0, None)), (0, None))
    return replace(
        state,
        mean=problem.motion.advance(state.mean, known_input),
        information=ahead(state.information, problem.motion),
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


def stages(problem: Problem, protocol: Protocol, instant: Instant) -> tuple[Stage, ...]:
    """The stages after a decision, as problem, protocol and the kind of episode ask for them."""
    has_truth, has_births = instant.reality is not None, instant.arrival is not None
    has_gate = has_truth and protocol.gate is not None
    # Negative information is of the real field of view: a soft view has already counted a part of a measurement there.
    uses_missed_detections = has_truth and problem.sensor.uses_missed_detections and not protocol.levels
    return (
        move,
        *((sense,) if has_truth else ()),
        *((gate_measurements,) if has_gate else ()),
        *((correct_means,) if has_truth else ()),
        weigh_softly if protocol.levels else weigh_measured,
        update_information,
        *((restart_beliefs,) if has_gate else ()),
        *((use_missed_detections,) if uses_missed_detections else ()),
        *((replace_targets,) if has_births else ()),
    )


def act(problem: Problem, protocol: Protocol, predicted: State, instant: Instant, action: Action) -> Draft:
    """Run the stages on a predicted state and an action; the draft's `state` is that after the step.

    `stages` depends on structure alone, so that a compiled program holds one fixed tuple.
    """
    now, n = problem.at(predicted.step), len(predicted.present)
    draft = Draft(
        predicted=predicted,
        action=action,
        instant=instant,
        state=replace(predicted, step=predicted.step + 1),
        covariance=jnp.broadcast_to(now.sensor.V, (n, *now.sensor.V.shape)),
        measured=jnp.zeros(n, bool),
        weight=jnp.zeros((1, n)),
    )
    for stage in stages(problem, protocol, instant):
        draft = stage(now, protocol, draft)
    return draft


def move(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """T_{k+1} = T_k exp(tau hat(u)), and V at the predicted positions as they are seen from there."""
    pose = problem.agent.move(draft.predicted.pose, draft.action, problem.tau)
    position_body = _position_body(problem, pose, draft.predicted.mean)
    covariance = _covariance(problem, pose, position_body)
    return draft._replace(state=replace(draft.state, pose=pose), covariance=covariance)


def sense(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Measure every target where it really is; only those in view, and present before and after, count."""
    reality, arrival, pose = draft.instant.reality, draft.instant.arrival, draft.state.pose
    assert reality is not None, "`stages` asks for this where there is truth"
    position_body = _position_body(problem, pose, reality.state)
    in_view = problem.sensor.view.contains(position_body) & draft.predicted.present
    if arrival is not None:
        in_view = in_view & arrival.present
    root = cholesky_spd(_covariance(problem, pose, position_body))
    noise = multiply(root, reality.noise[..., None])
    measurement = reality.state @ problem.sensor.H.T + noise[..., 0]
    return draft._replace(sensed=Sensed(position_body, in_view, measurement), measured=in_view)


def gate_measurements(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Reject measurements too far from their prediction; after some in a row, the belief begins again at the last."""
    sensed, rejections, H = draft.sensed, draft.state.rejections, problem.sensor.H
    assert sensed is not None, "`stages` asks for this where there is truth"
    assert protocol.gate is not None, "`stages` asks for this where there is a gate"
    assert rejections is not None, "`start` counts them where there is a gate"

    def look(mean, information, z, V):
        prediction = Belief(mean, information)
        return gate.squared_distance(prediction, z, H, V), gate.one_point(problem.prior_information, z, H, V)

    distance, fresh = jax.vmap(look)(
        draft.predicted.mean, draft.predicted.information[-1], sensed.measurement, draft.covariance
    )
    # Written so that a distance that is not a number is rejected, too.
    rejected = sensed.in_view & ~(distance <= protocol.gate)
    restarts = rejected & (rejections + 1 >= gate.RESTART_AFTER)
    measured = (sensed.in_view & ~rejected) | restarts
    state = replace(draft.state, rejections=jnp.where(measured, 0, jnp.where(rejected, rejections + 1, rejections)))
    return draft._replace(state=state, measured=measured, restart=Restart(restarts, fresh))


def correct_means(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """mu = p + K (z - H p) where a measurement is taken, with the gain of the predicted information."""
    assert draft.sensed is not None, "`stages` asks for this where there is truth"
    corrected = jax.vmap(lambda p, P, z, V: belief.correct_mean(Belief(p, P), z, problem.sensor.H, V))(
        draft.predicted.mean, draft.predicted.information[-1], draft.sensed.measurement, draft.covariance
    )
    mean = jnp.where(draft.measured[:, None], corrected, draft.state.mean)
    return draft._replace(state=replace(draft.state, mean=mean))


def weigh_softly(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """1 - Phi(d) of every level: the surrogate, at the predicted mean, or, `at_truth`, where the target really is."""
    if protocol.at_truth and draft.sensed is not None:
        position_body = draft.sensed.position_body
    else:
        position_body = _position_body(problem, draft.state.pose, draft.predicted.mean)
    distance = problem.sensor.view.signed_distance(position_body)
    return draft._replace(weight=jnp.stack([detection_weight(distance, level) for level in protocol.levels]))


def weigh_measured(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """1 where a measurement is taken, 0 elsewhere: the Kalman filter."""
    return draft._replace(weight=draft.measured.astype(draft.predicted.mean.dtype)[None])


def update_information(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Y = P + weight H^T V^-1 H, for every level."""
    gain = jax.vmap(problem.sensor.information)(draft.covariance)
    update = jax.vmap(jax.vmap(belief.update_information), (0, None, 0))
    information = update(draft.predicted.information, gain, draft.weight)
    return draft._replace(state=replace(draft.state, information=information))


def restart_beliefs(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Take the one-point belief where `gate_measurements` lets one begin again."""
    assert draft.restart is not None, "`gate_measurements` comes first"
    where, fresh = draft.restart
    mean = jnp.where(where[:, None], fresh.mean, draft.state.mean)
    information = jnp.where(where[:, None, None], fresh.information, draft.state.information)
    return draft._replace(state=replace(draft.state, mean=mean, information=information))


def use_missed_detections(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Condition the belief of a target that was not in view on its being outside of the view."""
    assert draft.sensed is not None, "`stages` asks for this where there is truth"
    state, in_view = draft.state, draft.sensed.in_view
    contains = partial(_view_contains, problem, state.pose)
    outside = jax.vmap(lambda m, Y: given_missed_detection(Belief(m, Y), problem.motion.Z, contains))(
        state.mean, state.information[0]
    )
    mean = jnp.where(in_view[:, None], state.mean, outside.mean)
    information = jnp.where(in_view[:, None, None], state.information, outside.information)
    return draft._replace(state=replace(state, mean=mean, information=information))


def replace_targets(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Begin the belief of a target that has just come; nothing could be measured of it yet."""
    state, arrival = draft.state, draft.instant.arrival
    assert arrival is not None, "`stages` asks for this where targets come and go"
    begins = arrival.present & ~draft.predicted.present
    rejections = state.rejections
    state = replace(
        state,
        mean=jnp.where(begins[:, None], arrival.mean, state.mean),
        information=jnp.where(begins[:, None, None], problem.prior_information, state.information),
        present=arrival.present,
        rejections=None if rejections is None else jnp.where(begins, 0, rejections),
    )
    return draft._replace(state=state)


def _position_body(problem: Problem, pose: Pose, state: Float[Array, "n n_y"]) -> Float[Array, "n d"]:
    """q = Q T^-1 [zeta(y); 1]."""
    return problem.agent.space.to_body(pose, problem.motion.position(state))


def _covariance(problem: Problem, pose: Pose, position_body: Float[Array, "n d"]) -> Float[Array, "n n_z n_z"]:
    rotation = problem.agent.space.rotation(pose)
    return jax.vmap(problem.sensor.covariance, (None, 0))(rotation, position_body)


def _view_contains(problem: Problem, pose: Pose, positions_world: Float[Array, "points d"]) -> Bool[Array, " points"]:
    return problem.sensor.view.contains(problem.agent.space.to_body(pose, positions_world))
