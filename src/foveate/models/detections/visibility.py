"""Probability of detection where a detection is, and in every cell: p_D, the view's border, and what hides a target."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.special import ndtr
from jaxtyping import Array, Float

from foveate.models.detections.records import DetectionModel, Scan
from foveate.models.problem import Problem
from foveate.types import Pose


class Measured(NamedTuple):
    """Positions of detections [m], the covariance of their noise, and its standard deviation along an axis [m]."""

    position_world: Float[Array, "m d"]
    V: Float[Array, "m n_z n_z"]
    std: Float[Array, " m"]


def measured(problem: Problem, pose: Pose, scan: Scan) -> Measured:
    """Where the detections of a scan are, as seen from a pose."""
    states = jnp.matmul(scan.measurement, jnp.linalg.pinv(problem.sensor.H).T, precision="highest")
    V = noise(problem, pose, states)
    std = jnp.sqrt(jnp.mean(jnp.diagonal(V, axis1=-2, axis2=-1), axis=-1))
    return Measured(problem.motion.position(states), V, std)


def noise(problem: Problem, pose: Pose, states: Float[Array, "n n_y"]) -> Float[Array, "n n_z n_z"]:
    """V for targets in these states as seen from a pose."""
    space = problem.agent.space
    points_body = space.to_body(pose, problem.motion.position(states))
    return jax.vmap(problem.sensor.covariance, (None, 0))(space.rotation(pose), points_body)


def chance(
    problem: Problem,
    model: DetectionModel,
    pose: Pose,
    position_world: Float[Array, "*b d"],
    std: Float[Array, "*b"],
) -> Float[Array, "*b"]:
    """Probability of detection of targets at about these positions [m]: p_D, times the probability of being in view.

    A detector whose view is wider than the model's also has false alarms beyond it. A track there is never looked at
    in vain, so that without the second factor a few of them would make a target that stays.
    """
    body = problem.agent.space.to_body(pose, position_world)
    in_view = ndtr(-problem.sensor.view.signed_distance(body) / std)
    return model.probability_at(jnp.sqrt(jnp.sum(body**2, axis=-1))) * in_view


def in_sight(problem: Problem, pose: Pose, found: Measured) -> Float[Array, " m"]:
    """1 where no obstacle hides what was detected: false alarms are drawn behind walls, too, where no look ends them.

    The line of sight ends two standard deviations before the detection, as a target by a wall may be measured in it.
    """
    if problem.obstacles is None:
        return jnp.ones_like(found.std)
    eye = problem.agent.space.position(pose)
    way = found.position_world - eye
    length = jnp.maximum(jnp.linalg.norm(way, axis=-1), 1e-9)
    share = jnp.maximum(1.0 - 2.0 * found.std / length, 0.0)
    ends = eye + share[:, None] * way
    return problem.obstacles.sees(eye, ends, jnp.ones_like(length, bool)).astype(length.dtype)


def cell_detection(problem: Problem, model: DetectionModel, pose: Pose) -> Float[Array, "*cells"]:
    """Probability of detection of a target somewhere in each cell: p_D at its middle times its share in the view.

    The share is that of a strip as wide as the cell which the view's border cuts at its distance from the middle.
    """
    grid, space = model.grid, problem.agent.space
    centres = grid.centres().reshape(-1, len(grid.shape))
    body = space.to_body(pose, centres)
    width = grid.volume ** (1.0 / len(grid.shape))
    share = jnp.clip(0.5 - problem.sensor.view.signed_distance(body) / width, 0.0, 1.0)
    if problem.obstacles is not None:
        share = jnp.where(problem.obstacles.sees(space.position(pose), centres, share > 0), share, 0.0)
    chance = model.probability_at(jnp.sqrt(jnp.sum(body**2, axis=-1)))
    return (share * chance).reshape(grid.shape)
