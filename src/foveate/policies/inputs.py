"""Features of learned policies: pose and predicted beliefs as arrays, in the frame of the agent or of the world."""

from typing import Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.geometry.linalg import multiply, vech
from foveate.geometry.sight import fan
from foveate.geometry.space import Space
from foveate.io.validate import require
from foveate.models.problem import Problem
from foveate.simulation.records import Observation
from foveate.types import Scalar

Frame = Literal["body", "world"]
Scale = Literal["plain", "asinh"]


def policy_inputs(
    observation: Observation, space: Space, frame: Frame, length_m: float = 1.0, scale: Scale = "plain"
) -> tuple[Float[Array, " n_u"], Float[Array, "n features"]]:
    """Features s = [log(T)^v, {p, vech(P)}] (paper, section 2) of the agent and of each target.

    The world frame is that of the paper's text. In the body frame the pose is zero, and means and information matrices
    are in the agent's frame, so that decisions do not depend on the world's origin; a state is read as vectors of d
    numbers, the first of them the position. Means are in units of `length_m` [m]. With the scale "asinh" the entries of
    an information matrix, which grow a thousandfold when a target is seen, enter as their inverse hyperbolic sine,
    which is linear near zero and logarithmic beyond.
    """
    mean, information = observation.mean, observation.information
    if frame == "world":
        pose = space.log(observation.pose)
    else:
        d, (n, size) = space.dimension, mean.shape
        turn = space.rotation(observation.pose)
        pose = jnp.zeros(space.twist_size, mean.dtype)
        rest_body = multiply(mean[:, d:].reshape(-1, d), turn).reshape(n, size - d)
        mean = jnp.concatenate([space.to_body(observation.pose, mean[:, :d]), rest_body], axis=-1)
        # diag(R, R, ..)^T P diag(R, R, ..): one product rotates every d numbers of all rows, another those of columns.
        rows_body = multiply(information.reshape(-1, d), turn).reshape(n, size, size)
        information = multiply(jnp.swapaxes(rows_body, -1, -2).reshape(-1, d), turn).reshape(n, size, size)
    packed = vech(information)
    return pose, jnp.concatenate([mean / length_m, jnp.arcsinh(packed) if scale == "asinh" else packed], axis=-1)


def require_position_first(problem: Problem, name: str, value: str) -> None:
    """Raise InputError about the setting "name = value" unless a target's state begins with its position."""
    shape = f"({problem.agent.space.dimension} x {problem.motion.state_size})"
    right = f"expected targets whose state begins with the position, Z = [I 0] {shape}"
    require(problem.motion.begins_with_position, name, value, right)


class Features(NamedTuple):
    """An observation as arrays for learners outside JAX; padding is zeros."""

    agent: Float[Array, " n_u"]
    targets: Float[Array, "n features"]
    mask: Float[Array, " n"]
    """1 where a target is present."""
    left: Float[Array, " 1"]
    """Share of the episode's steps that is left."""

    @property
    def row(self) -> Float[Array, " size"]:
        """All features in one row."""
        return jnp.concatenate([self.agent, self.targets.ravel(), self.mask, self.left])


def masked_features(
    observation: Observation, left: Scalar, space: Space, frame: Frame, length_m: float = 1.0, scale: Scale = "plain"
) -> Features:
    """Return `policy_inputs` with padding as zeros, the mask of present targets, and the share of steps `left`."""
    agent, targets = policy_inputs(observation, space, frame, length_m, scale)
    targets = jnp.where(observation.present[:, None], targets, 0.0)
    return Features(agent, targets, observation.present.astype(agent.dtype), left[None].astype(agent.dtype))


class RangedFeatures(NamedTuple):
    """`Features` of a robot among obstacles, with free ranges along rays and the targets that no obstacle hides."""

    agent: Float[Array, " n_u"]
    targets: Float[Array, "n features"]
    mask: Float[Array, " n"]
    left: Float[Array, " 1"]
    ranges: Float[Array, " rays"]
    """Free range along each ray as a share of the longest; the first ray is straight ahead, the others turn left."""
    clear: Float[Array, " n"]
    """1 where the line to the mean of a belief is free."""


def with_ranges(features: Features, observation: Observation, rays: int, most_m: float) -> RangedFeatures:
    """Add to features what obstacles leave: ranges up to `most_m` [m] (see `geometry.sight.fan`), and lines of sight.

    Raises InputError for an observation without obstacles.
    """
    robot = observation.robot
    obstacles = None if robot is None else robot.problem.obstacles
    if robot is None or obstacles is None:
        raise InputError(f"rays = {rays}: expected 0, or a scenario with obstacles")
    space = robot.problem.agent.space
    directions = jnp.asarray(fan(rays, space.dimension), observation.mean.dtype)
    ranges = obstacles.ranges(space, observation.pose, directions, most_m) / most_m
    positions_world = robot.problem.motion.position(observation.mean)
    clear = obstacles.sees(space.position(observation.pose), positions_world, observation.present)
    return RangedFeatures(*features, ranges, clear.astype(ranges.dtype))
