"""The stages of a step that differ where the sensor measures in coordinates of its own (`models.polar`)."""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.linalg import inverse_spd, log_det_spd, multiply, symmetrise
from foveate.models import polar_filter
from foveate.models.belief import Belief
from foveate.models.problem import Problem
from foveate.simulation.draft import Draft, Sensed, noise_covariance, positions_body
from foveate.simulation.records import Protocol
from foveate.types import Pose


def expect_polar(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """V, and the information of a measurement, at the predicted positions as seen from T_{k+1}."""
    pose = draft.state.pose
    position_body, rotation = positions_body(problem, pose, draft.predicted.mean), problem.agent.space.rotation(pose)
    gain = jax.vmap(problem.sensor.gain, (None, 0))(rotation, position_body)
    return draft._replace(covariance=noise_covariance(problem, pose, position_body), gain=gain)


def compare_polar(problem: Problem, draft: Draft, sensed: Sensed) -> tuple[Float[Array, " n"], Belief]:
    """Squared distances of measurements to their predictions, and the beliefs that begin with each."""
    sensor, pose, polar = problem.sensor, draft.state.pose, problem.sensor.polar
    assert polar is not None, "a stage of sensors with their own coordinates"
    frame = _frame(problem, pose)

    def compare(mean, information, z):
        covariance = inverse_spd(information)
        distance = polar_filter.squared_distance(jnp, inverse_spd, polar, mean, covariance, z, sensor.V, frame)
        return distance, first_belief(problem, pose, z)

    return jax.vmap(compare)(draft.predicted.mean, draft.predicted.information[-1], sensed.measurement)


def first_belief(problem: Problem, pose: Pose, measurement: Float[Array, " n_z"]) -> Belief:
    """Belief from one measurement: a position within the view, and of the rest of the state the first belief's."""
    R, t, Z = _frame(problem, pose)
    middle, spread = problem.sensor.one_point(measurement)
    back = jnp.linalg.pinv(Z)
    rest = jnp.eye(Z.shape[1], dtype=Z.dtype) - multiply(back, Z)
    turned = multiply(back, R)
    covariance = multiply(multiply(turned, spread), turned.T)
    covariance += multiply(multiply(rest, inverse_spd(problem.prior_information)), rest.T)
    return Belief(turned @ middle + back @ t, inverse_spd(symmetrise(covariance)))


def correct_polar(problem: Problem, protocol: Protocol, draft: Draft) -> Draft:
    """Correct the means; the Kalman filter (not a soft view) takes the information of where they were linearised.

    A measurement that a belief cannot use (`models.polar_filter`) counts as none.
    """
    sensor, polar, sensed = problem.sensor, problem.sensor.polar, draft.sensed
    assert polar is not None, "a stage of sensors with their own coordinates"
    assert sensed is not None, "a stage of episodes with truth"
    frame = _frame(problem, draft.state.pose)

    def correct(mean, information, z):
        covariance = inverse_spd(information)
        after = polar_filter.update(jnp, inverse_spd, polar, mean, covariance, z, sensor.V, frame)
        gain = multiply(multiply(after.H.T, inverse_spd(after.V)), after.H)
        # Point-blank the information across the ray may be so large that rounding leaves no definite sum.
        return after.mean, gain, after.is_taken & jnp.isfinite(log_det_spd(information + gain))

    corrected, gain, is_taken = jax.vmap(correct)(
        draft.predicted.mean, draft.predicted.information[-1], sensed.measurement
    )
    restarts = False if draft.restart is None else draft.restart[0]
    measured = draft.measured & (is_taken | restarts)
    mean = jnp.where(measured[:, None], corrected, draft.state.mean)
    draft = draft._replace(state=replace(draft.state, mean=mean), measured=measured)
    # What was not taken may hold anything, and is weighed by 0.
    taken = measured[:, None, None] & jnp.all(jnp.isfinite(gain), axis=(1, 2), keepdims=True)
    return draft if protocol.levels else draft._replace(gain=jnp.where(taken, gain, 0.0))


def _frame(problem: Problem, pose: Pose) -> tuple[Float[Array, "d d"], Float[Array, " d"], Float[Array, "d n_y"]]:
    space = problem.agent.space
    return space.rotation(pose), space.position(pose), problem.sensor.H
