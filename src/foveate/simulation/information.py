"""Score a sequence of actions by the noise-free information recursion along its path, with a hand-written gradient.

The model is that of `rollout` (agent, view, sensor, belief) without policy, noise and means. The gradient is
proposition 1 of the paper in reverse mode: one pass, one matrix stored per step.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.errors import InputError
from foveate.geometry.linalg import inverse_spd, log_det_spd, multiply, symmetrise
from foveate.models import belief
from foveate.models.bodies import Bodies
from foveate.models.polar_filter import MAX_STD_PER_RANGE
from foveate.models.problem import Problem
from foveate.models.sensor import Softness, detection_weight
from foveate.models.target import LinearGaussian
from foveate.simulation.bodies import bodies_along
from foveate.simulation.records import Observation, per_target
from foveate.types import Count, Pose, Scalar


class Future(eqx.Module):
    """Known or predicted future that a plan is made for.

    `state` holds the targets' states after each step, `information` the P_1 predicted for the first. Only the first
    `horizon` steps count. `map_number` is that of the map among obstacles. `mates` is the information about each target
    that the other robots of a team are expected to add in a step. `bodies` are those in the agent's way along the
    future, where it keeps off any; None: the present targets.
    """

    pose: Pose
    state: Float[Array, "K n n_y"]
    information: Float[Array, "n n_y n_y"]
    present: Bool[Array, " n"]
    horizon: Count
    map_number: Count | None = None
    mates: Float[Array, "n n_y n_y"] | None = None
    bodies: Bodies | None = None

    def in_the_way(self, problem: Problem) -> Bodies | None:
        """The bodies at every step that the agent keeps off; None where it keeps no distance."""
        if problem.keep_off_m is None or self.bodies is not None:
            return self.bodies
        present = jnp.broadcast_to(self.present, self.state.shape[:2])
        return Bodies(problem.motion.position(self.state), present)


def believed_future(
    problem: Problem, observation: Observation, mean_input: Float[Array, "n m_y"], window: int, horizon: Count
) -> Future:
    """Predicted future of targets that move without noise, with `mean_input` at every later step."""

    def advance(state, _):
        return problem.motion.advance(state, mean_input), state

    states = jax.lax.scan(advance, observation.mean, None, window)[1]
    steps = jnp.minimum(horizon, window)
    beliefs = observation.information, observation.present
    bodies = bodies_along(problem, observation, states)
    return Future(observation.pose, states, *beliefs, steps, map_number=observation.map_number, bodies=bodies)


def score(problem: Problem, future: Future, action: Float[Array, "K m"], level: Softness | None) -> Scalar:
    """Mean log det Y over the targets at the horizon [nat], in a soft view, or the real one where `level` is None."""
    return per_target(final_log_det(problem, future, action, level), future.present)


def final_log_det(
    problem: Problem, future: Future, action: Float[Array, "K m"], level: Softness | None
) -> Float[Array, " n"]:
    """log det Y of every target at the horizon [nat]. Raises InputError for a problem with a schedule."""
    added, counts = _added(problem, future, action, level)
    return _log_det_after(future.information, added, counts, problem.motion)


def mean_score(problem: Problem, future: Future, action: Float[Array, "K m"], level: Softness | None) -> Scalar:
    """Mean log det Y over the targets and the steps [nat], as `score` otherwise; without a gradient of its own."""
    added, counts = _added(problem, future, action, level)

    def step(P, added):
        Y = P + added
        after = jax.vmap(lambda information: belief.predict_information(information, problem.motion))(Y)
        return after, per_target(log_det_spd(Y), future.present)

    log_dets = jax.lax.scan(step, future.information, added)[1]
    return jnp.sum(jnp.where(counts, log_dets, 0.0)) / jnp.sum(counts).astype(log_dets.dtype)


def looks(problem: Problem, future: Future, action: Float[Array, "K m"], level: Softness | None) -> Float[Array, " n"]:
    """Looks at each target in a step, the mean over the steps that count, weighted by the soft view."""
    _, weight, _ = _looks(problem, future, action, level)
    counts = _counts(future, action)
    return jnp.where(future.present, jnp.mean(weight, axis=0, where=counts[:, None]), 0.0)


def _added(
    problem: Problem, future: Future, action: Float[Array, "K m"], level: Softness | None
) -> tuple[Float[Array, "K n n_y n_y"], Bool[Array, " K"]]:
    """Information M_k that each step adds to each target, and the steps that count."""
    gain, weight, points_body = _looks(problem, future, action, level)
    added, counts = weight[..., None, None] * gain, _counts(future, action)
    if problem.sensor.polar is not None:
        is_taken = _is_taken(problem, future, gain, weight, points_body)
        added = jnp.where(is_taken[..., None, None], added, 0.0)
    if future.mates is not None:
        added += future.mates
    return jnp.where(counts[:, None, None, None], added, 0.0), counts


def _counts(future: Future, action: Float[Array, "K m"]) -> Bool[Array, " K"]:
    return jnp.arange(len(action)) < future.horizon


def _is_taken(
    problem: Problem,
    future: Future,
    gain: Float[Array, "K n n_y n_y"],
    weight: Float[Array, "K n"],
    points_body: Float[Array, "K n d"],
) -> Bool[Array, "K n"]:
    """Whether the filter of a `polar` sensor would take each measurement, by its rule (`models.polar_filter`).

    Point-blank it does not, where the information of a bearing is all but infinite.
    """
    motion, most = problem.motion, MAX_STD_PER_RANGE**2 * jnp.sum(points_body**2, axis=-1)

    def step(P, x):
        gain, weight, most = x
        P = P if future.mates is None else P + future.mates
        whole = P + gain
        covariance = multiply(multiply(motion.Z, inverse_spd(whole)), motion.Z.T)
        is_precise = jnp.trace(covariance, axis1=-2, axis2=-1) <= most
        # Rounding may leave no definite sum, whose trace may be anything.
        is_taken = is_precise & jnp.isfinite(log_det_spd(whole))
        Y = P + jnp.where(is_taken, weight, 0.0)[:, None, None] * gain
        return jax.vmap(lambda information: belief.predict_information(information, motion))(Y), is_taken

    return jax.lax.scan(step, *jax.lax.stop_gradient((future.information, (gain, weight, most))))[1]


def _looks(
    problem: Problem, future: Future, action: Float[Array, "K m"], level: Softness | None
) -> tuple[Float[Array, "K n n_y n_y"], Float[Array, "K n"], Float[Array, "K n d"]]:
    """Information of a look at each target in each step, its weight, and where the target is in the body frame [m]."""
    if problem.schedule is not None:
        raise InputError("the scenario has a schedule: planners need steps of one kind: leave [schedule] out")
    problem = problem.of_map(future.map_number)
    agent, sensor, obstacles = problem.agent, problem.sensor, problem.obstacles

    def move(pose, step):
        pose = problem.move(pose, *step)
        return pose, pose

    def look(pose, state):
        rotation = agent.space.rotation(pose)
        positions_world = problem.motion.position(state)
        points_body = agent.space.to_body(pose, positions_world)
        gain = jax.vmap(lambda point: sensor.gain(rotation, point))(points_body)
        if level is None:
            return gain, problem.sees(pose, positions_world).astype(gain.dtype), points_body
        weight = detection_weight(sensor.view.signed_distance(points_body), level)
        if obstacles is not None:
            weight = weight * obstacles.weight(agent.space.position(pose), positions_world, level)
        return gain, weight, points_body

    poses = jax.lax.scan(move, future.pose, (action, future.in_the_way(problem)))[1]
    return jax.vmap(look)(poses, future.state)


@jax.custom_vjp
def _log_det_after(
    information: Float[Array, "n n_y n_y"],
    added: Float[Array, "K n n_y n_y"],
    counts: Bool[Array, " K"],
    motion: LinearGaussian,
) -> Float[Array, " n"]:
    """log det Y_K of Y_1 = P_1 + M_1, Y_{k+1} = (A Y_k^-1 A^T + W)^-1 + M_{k+1}; steps that do not count are skipped.

    Differentiable in `added`, the M_k, only. With G_k = P_{k+1} A Y_k^-1, dP_{k+1} = G_k dY_k G_k^T, and so the
    derivative by M_k is L_k, L_K = Y_K^-1, L_k = G_k^T L_{k+1} G_k.
    """
    return _forward(information, added, counts, motion)[0]


def _forward(information, added, counts, motion):
    def step(Y, x):
        added, count = x
        P = jax.vmap(lambda information: belief.predict_information(information, motion))(Y)
        G = multiply(P, multiply(motion.A, inverse_spd(Y)))
        return jnp.where(count, P + added, Y), G

    Y, G = jax.lax.scan(step, information + added[0], (added[1:], counts[1:]))
    return log_det_spd(Y), (Y, G, counts)


def _backward(residuals, cotangent):
    Y, G, counts = residuals

    def step(L, x):
        G, count = x
        # Rounding would make L drift from symmetric over a long horizon.
        earlier = symmetrise(multiply(multiply(jnp.swapaxes(G, -1, -2), L), G))
        return jnp.where(count, earlier, L), L

    first, later = jax.lax.scan(step, cotangent[:, None, None] * inverse_spd(Y), (G, counts[1:]), reverse=True)
    return None, jnp.concatenate([first[None], later]), None, None


_log_det_after.defvjp(_forward, _backward)
