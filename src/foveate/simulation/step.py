"""One step of the simulation."""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foveate.geometry.linalg import cholesky_spd, multiply
from foveate.models import belief, gate
from foveate.models.belief import Belief
from foveate.models.missed_detection import given_missed_detection
from foveate.models.problem import Problem, first_information
from foveate.models.sensor import detection_weight
from foveate.simulation.records import Arrival, Episode, Instant, Observation, Protocol, Reality, State
from foveate.types import Action, Count, Pose


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
    return State(
        step=state.step,
        pose=state.pose,
        mean=problem.motion.advance(state.mean, known_input),
        information=ahead(state.information, problem.motion),
        present=state.present,
        rejections=state.rejections,
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

    mean, rejections = predicted.mean, predicted.rejections
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
            assert rejections is not None, "`start` counts them where there is a gate"
            visible, restarts, rejections, anew = _gated(
                problem, protocol.gate, predicted, rejections, inside, measurement, covariance
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
    if sensor.uses_missed_detections and not protocol.levels and instant.reality is not None:
        is_inside = partial(_in_view, problem, pose)
        left = jax.vmap(lambda m, Y: given_missed_detection(Belief(m, Y), motion.Z, is_inside))(mean, information[0])
        mean = jnp.where(inside[:, None], mean, left.mean)
        information = jnp.where(inside[:, None, None], information, left.information)

    present = predicted.present
    if (arrival := instant.arrival) is not None:
        begins = arrival.present & ~predicted.present
        mean = jnp.where(begins[:, None], arrival.mean, mean)
        information = jnp.where(begins[:, None, None], problem.prior_information, information)
        present = arrival.present
        rejections = None if rejections is None else jnp.where(begins, 0, rejections)
    return State(predicted.step + 1, pose, mean, information, present, rejections), visible, weight


def _gated(
    problem: Problem,
    limit: float,
    predicted: State,
    rejections: Int[Array, " n"],
    inside: Bool[Array, " n"],
    measurement: Float[Array, "n n_z"],
    covariance: Float[Array, "n n_z n_z"],
) -> tuple[Bool[Array, " n"], Bool[Array, " n"], Int[Array, " n"], Belief]:
    """Whose measurement is taken, whose belief begins anew with it, the rejections in a row, and these new beliefs."""
    H, first = problem.sensor.H, problem.prior_information

    def look(mean, information, z, V):
        return gate.squared_distance(Belief(mean, information), z, H, V), gate.one_point(first, z, H, V)

    distance, anew = jax.vmap(look)(predicted.mean, predicted.information[-1], measurement, covariance)
    rejected = inside & ~(distance <= limit)
    restarts = rejected & (rejections + 1 >= gate.RESTART_AFTER)
    taken = (inside & ~rejected) | restarts
    return taken, restarts, jnp.where(taken, 0, jnp.where(rejected, rejections + 1, rejections)), anew


def _in_view(problem: Problem, pose: Pose, positions_world: Float[Array, "points d"]) -> Bool[Array, " points"]:
    return problem.sensor.view.contains(problem.agent.space.to_body(pose, positions_world))
