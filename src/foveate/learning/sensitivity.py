"""Proposition 1 of the paper, in its notation: the policy gradient by the forward recursion of Omega and Lambda.

Training differentiates the same objective in reverse mode, at a cost that does not grow with the number of parameters;
here every parameter carries its own derivative of the pose and of every information matrix through the episode. The two
agree to rounding (tests/learning/test_sensitivity.py).

    Lambda_k^(i) = dT_k / dtheta^(i)         (4 x 4)
    Omega_k^(j,i) = dY_k^(j) / dtheta^(i)    (n_y x n_y)

Where the printed form differs, and why:

* The paper's equation for Lambda has only dpi/dtheta. The control is u_k = pi_theta(s_k), and s_k = [log(T_k)^v,
  p_{k+1}, vech(P_{k+1})] itself moves with theta, so the derivative is the total one,
  du/dtheta = dpi/dtheta + dpi/dT Lambda_k + dpi/dP (dP_{k+1}/dtheta). `total=False` gives the printed, partial one.
* The paper's first term of Omega needs A^-1. With P' = (A Y^-1 A^T + W)^-1 it is G Omega G^T, G = P' A Y^-1, which
  is the same where A is invertible, and correct where it is not.
* It writes p for the position zeta(p) = Z p, and omits the hat in exp(tau pi(s)).
* V may turn with the agent and grow with range here, so that H^T V^-1 H has a derivative too; the paper's has none.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.geometry import lie
from foveate.geometry.linalg import inverse_spd, log_det_spd
from foveate.models.belief import predict_information
from foveate.models.problem import Problem, first_information
from foveate.models.robot import Robot
from foveate.models.sensor import PAPER_SOFTNESS, Sensor, Softness, detection_weight
from foveate.simulation.records import Episode, Observation, Policy
from foveate.types import Point, Pose, Scalar, Twist


class Sensitivity(NamedTuple):
    """Pose and beliefs after step k, and their derivatives by each of the n_p parameters."""

    T: Float[Array, "4 4"]
    mean: Float[Array, "n n_y"]
    Y: Float[Array, "n n_y n_y"]
    Lambda: Float[Array, "n_p 4 4"]
    Omega: Float[Array, "n_p n n_y n_y"]


def policy_gradient(
    problem: Problem, policy: Policy, episode: Episode, softness: Softness = PAPER_SOFTNESS, total: bool = True
) -> tuple[Scalar, Policy]:
    """sum_j log det Y_K^(j) of a noise-free episode in space [nat], and its gradient by the policy's parameters.

    The gradient has the structure of the policy's floating-point arrays. Memory grows as n_p n n_y^2. Raises InputError
    for a planar problem, one with obstacles or whose agent keeps borders or off targets, an episode with truth or
    arrivals, and a policy with memory.
    """
    if problem.agent.space.dimension != 3:
        raise InputError(
            "Proposition 1 is stated for SE(3): embed a planar problem (foveate.simulation.planar_in_space)"
        )
    if problem.bounds_agent or problem.keep_off_m is not None or problem.obstacles is not None:
        raise InputError(
            "Proposition 1 assumes free motion and sight: expected neither a region that stops the agent, keep_off_m "
            "nor obstacles"
        )
    if episode.truth is not None or episode.arrivals is not None:
        raise InputError("Proposition 1 assumes a noise-free episode: expected neither truth nor arrivals")
    parameters, rest = eqx.partition(policy, eqx.is_inexact_array)
    theta, restore = ravel_pytree(parameters)

    def decide(theta: Array, observation: Observation) -> Array:
        policy = eqx.combine(restore(theta), rest)
        memory = policy.start(observation)
        if jax.tree.leaves(memory):
            raise InputError("Proposition 1 is stated for u = pi(s): expected a policy without memory")
        return problem.agent.twist(policy(observation, memory, jax.random.key(0))[0])

    def step(before: Sensitivity, k: Array) -> tuple[Sensitivity, None]:
        after = _step(problem.at(k), decide, theta, episode, softness, before, k, total)
        return jax.tree.map(lambda new, old: jnp.where(k < episode.horizon, new, old), after, before), None

    Y = first_information(problem, episode.mean.shape[0])
    zeros = (jnp.zeros((theta.size, *shape), Y.dtype) for shape in ((4, 4), Y.shape))  # Lambda_0 = 0, Omega_0 = 0
    first = Sensitivity(episode.pose, episode.mean, Y, *zeros)
    last, _ = jax.lax.scan(step, first, jnp.arange(episode.inputs.shape[0]))
    # Equation (23): dr/dtheta^(i) = sum_j tr((Y_K^(j))^-1 Omega_K^(j,i)); padding has no part in it.
    real = episode.present.astype(Y.dtype)
    score = jnp.sum(real * log_det_spd(last.Y))
    gradient = jnp.einsum("j,jab,ijba->i", real, inverse_spd(last.Y), last.Omega)
    return score, restore(gradient)


def _step(
    problem: Problem,
    decide: Callable[[Array, Observation], Twist],
    theta: Float[Array, " n_p"],
    episode: Episode,
    softness: Softness,
    before: Sensitivity,
    k: Array,
    total: bool,
) -> Sensitivity:
    """One step of the recursion, in the paper's order; `i` runs over parameters, `j` over targets."""
    motion, tau, known_input = problem.motion, problem.tau, episode.inputs[k]

    # p_{k+1} = A p_k + B xi_k does not depend on theta. P_{k+1} does: dP = G Omega G^T, G = P_{k+1} A Y_k^-1.
    mean = motion.advance(before.mean, known_input)
    P = jax.vmap(predict_information, (0, None))(before.Y, motion)
    G = P @ motion.A @ inverse_spd(before.Y)
    dP = jnp.einsum("jab,ijbc,jdc->ijad", G, before.Omega, G)

    # u_k = pi_theta(s_k), and how it moves with theta, T_k and P_{k+1}.
    def control(theta: Array, T: Pose, P: Array) -> Twist:
        fields = (k, episode.horizon - k, T, mean, P, episode.present, known_input, Robot.of(problem))
        return decide(theta, Observation(*fields))

    u = control(theta, before.T, P)
    by_theta, by_T, by_P = jax.jacrev(control, argnums=(0, 1, 2))(theta, before.T, P)
    du = by_theta.T
    if total:
        du = du + jnp.einsum("uab,iab->iu", by_T, before.Lambda) + jnp.einsum("ujab,ijab->iu", by_P, dP)

    # Equation (27): Lambda' = Lambda exp(tau u^) + T sum_m du^(m)/dtheta^(i) dexp(tau u^)/du^(m).
    exp = lie.exp_se3(tau * u)
    by_u = jax.jacfwd(lambda u: lie.exp_se3(tau * u))(u)
    T = before.T @ exp
    Lambda = before.Lambda @ exp + jnp.einsum("ab,bcu,iu->iac", before.T, by_u, du)

    # Equation (26): the weight and, where V turns or grows with range, what a measurement is worth, both
    # through q = Q T^-1 zeta_, dq = -Q T^-1 dT T^-1 zeta_.
    zeta = motion.position(mean)
    T_inverse = lie.inverse_se3(T)
    q = lie.body_point_se3(T, zeta)
    q_homogeneous = jnp.concatenate([q, jnp.ones_like(q[:, :1])], axis=1)
    dq = -jnp.einsum("ab,ibc,jc->ija", T_inverse[:3], Lambda, q_homogeneous)
    distance, normal = jax.vmap(jax.value_and_grad(problem.sensor.view.signed_distance))(q)
    d_weight = -_density(distance, softness) * jnp.einsum("ja,ija->ij", normal, dq)
    weight = detection_weight(distance, softness)
    gain, d_gain = _gains(problem.sensor, T[:3, :3], q, Lambda[:, :3, :3], dq)
    Y = P + weight[:, None, None] * gain
    Omega = dP + d_weight[..., None, None] * gain + weight[:, None, None] * d_gain
    return Sensitivity(T, mean, Y, Lambda, Omega)


def _density(distance: Float[Array, " n"], softness: Softness) -> Float[Array, " n"]:
    """Phi'(d) of Phi(d) = [1 + erf(d / (sqrt(2) kappa) - offset)] / 2 [1/m]."""
    x = distance / (jnp.sqrt(2.0) * softness.kappa) - softness.offset
    return jnp.exp(-(x**2)) / (jnp.sqrt(2.0 * jnp.pi) * softness.kappa)


def _gains(
    sensor: Sensor,
    R: Float[Array, "3 3"],
    q: Float[Array, "n 3"],
    dR: Float[Array, "n_p 3 3"],
    dq: Float[Array, "n_p n 3"],
) -> tuple[Float[Array, "n n_y n_y"], Float[Array, "n_p n n_y n_y"]]:
    """H^T V^-1 H of every target and its derivative by every parameter; 0 where V is constant in the world."""

    def gain(R: Array, q: Point) -> Array:
        return sensor.gain(R, q)

    def along(dR: Array, dq: Point, q: Point) -> Array:
        return jax.jvp(gain, (R, q), (dR, dq))[1]

    derivative = jax.vmap(jax.vmap(along, (None, 0, 0)), (0, 0, None))(dR, dq, q)
    return jax.vmap(gain, (None, 0))(R, q), derivative
