"""What a robot keeps its distance from, as it believes: targets, and team-mates where it has heard them last."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.geometry.linalg import inverse_spd, multiply
from foveate.models.bodies import Bodies
from foveate.models.problem import Problem
from foveate.simulation.records import Observation

LEAST_M2 = 1e-12
"""Least variance of a position [m^2]."""

MATE_STEPS = 3
"""A mate not heard of for more steps may be anywhere."""


def blocking(observation: Observation) -> Bool[Array, " n"]:
    """The entries that a robot keeps its distance from, if it keeps any."""
    return observation.present if observation.blocking is None else observation.blocking


def bodies_of(problem: Problem, observation: Observation) -> Bodies | None:
    """The bodies of an observation; None where the agent keeps no distance."""
    if problem.keep_off_m is None:
        return None
    return _with_mates(problem, observation, observation.mean)


def bodies_along(problem: Problem, observation: Observation, state: Float[Array, "K n n_y"]) -> Bodies | None:
    """The bodies along the targets' states, while the others of a team stay where they are; None as in `bodies_of`."""
    if problem.keep_off_m is None:
        return None
    return jax.vmap(lambda mean: _with_mates(problem, observation, mean))(state)


def _with_mates(problem: Problem, observation: Observation, mean: Float[Array, "n n_y"]) -> Bodies:
    positions_world, team = problem.motion.position(mean), observation.team
    present = blocking(observation)
    # Padding may hold anything.
    information = jnp.where(present[:, None, None], observation.information, problem.prior_information)
    covariance = multiply(multiply(problem.motion.Z, inverse_spd(information)), problem.motion.Z.T)
    # In single precision the inverse of a sharp belief may have a negative diagonal.
    variance = jnp.maximum(jnp.trace(covariance, axis1=-2, axis2=-1) / positions_world.shape[-1], LEAST_M2)
    std_m = jnp.sqrt(variance)
    if team is None:
        return Bodies(positions_world, present, std_m)
    mates_world = jax.vmap(problem.agent.space.position)(team.pose)
    is_there = (jnp.arange(len(team.age)) != team.number) & (team.age <= MATE_STEPS)
    return Bodies(
        jnp.concatenate([positions_world, mates_world]),
        jnp.concatenate([present, is_there]),
        jnp.concatenate([std_m, jnp.zeros(len(team.age), std_m.dtype)]),
    )
