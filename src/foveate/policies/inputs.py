"""Features of learned policies: pose and predicted beliefs as arrays, in the frame of the agent or of the world."""

from typing import Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.linalg import multiply, vech
from foveate.geometry.space import Space
from foveate.io.validate import require
from foveate.models.problem import Problem
from foveate.simulation.records import Observation
from foveate.types import Scalar

Frame = Literal["body", "world"]
Scale = Literal["plain", "asinh"]

MIN_RANGE_M = 0.1
"""Below this range the direction of a target fades to zero: at the agent itself it has none, nor a derivative."""

STEPS_LEFT_UNIT = 10.0
"""Unit of the steps left; beyond MAX_STEPS_LEFT of it they make no difference."""

MAX_STEPS_LEFT = 3.0

FINAL_STEPS = 3.0
"""Scale of exp(-left / FINAL_STEPS), the feature that resolves the last steps of an episode."""

TARGETS_UNIT = 5.0
"""Unit of the number of targets: a usual one, so that the feature is near 1."""


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


def pointer_features(observation: Observation, space: Space, length_m: float) -> Float[Array, "n features"]:
    """Features of each target for the pointer network: the paper's in the body frame, and others.

    These are its direction, the logarithm of its range, the steps left on two scales, the number of targets, and its
    known input. Directions and logarithms resolve near and far targets alike, which plain coordinates do not.
    """
    d, n = space.dimension, len(observation.present)
    _, paper = policy_inputs(observation, space, "body", length_m, "asinh")
    position_body = paper[:, :d] * length_m
    distance = jnp.sqrt(jnp.sum(position_body**2, axis=-1, keepdims=True) + MIN_RANGE_M**2)
    # Negative in the padding after the end of an episode, where the exponential would overflow.
    left = jnp.maximum(observation.left, 0).astype(paper.dtype)
    steps = (jnp.minimum(left / STEPS_LEFT_UNIT, MAX_STEPS_LEFT), jnp.exp(-left / FINAL_STEPS))
    common = jnp.stack([*steps, jnp.sum(observation.present).astype(paper.dtype) / TARGETS_UNIT])
    parts = [paper, position_body / distance, jnp.log(distance), jnp.broadcast_to(common, (n, 3))]
    if observation.known_input.shape[-1] == d:  # a displacement in the world: rotated as positions are
        parts.append(multiply(observation.known_input, space.rotation(observation.pose)))
    return jnp.concatenate(parts, axis=-1)


def pointer_feature_count(problem: Problem) -> int:
    """Number of `pointer_features` of a target. Raises InputError where a state does not begin with the position."""
    require_position_first(problem, "kind", "pointer")
    d, n_y = problem.agent.space.dimension, problem.motion.state_size
    known_input = d if problem.motion.input_size == d else 0
    return n_y + n_y * (n_y + 1) // 2 + (d + 1) + known_input + 3


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
