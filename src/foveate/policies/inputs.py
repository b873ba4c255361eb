"""What a learned policy is told: pose and predicted beliefs as numbers, in the agent's frame or in the world's."""

from typing import Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.geometry.linalg import multiply, vech
from foveate.geometry.space import Space
from foveate.models.problem import Problem
from foveate.simulation.records import Observation
from foveate.types import Scalar

Frame = Literal["body", "world"]


Scale = Literal["plain", "asinh"]


LEAST_RANGE_M = 0.1
"""Below this the direction of a target fades out: at the agent itself it has none."""


HORIZON_STEPS = 10.0
"""Steps left are told in this unit, and no further ahead than MOST_UNITS of it."""


MOST_UNITS = 3.0


LAST_STEPS = 3.0
"""Over so many steps the end comes into sight, as exp(-left / LAST_STEPS)."""


USUAL_TARGETS = 5.0
"""The number of targets is told in this unit."""


def policy_inputs(
    observation: Observation, space: Space, frame: Frame, length_m: float = 1.0, scale: Scale = "plain"
) -> tuple[Float[Array, " n_u"], Float[Array, "n features"]]:
    """s = [log(T)^v, {p, vech(P)}] (paper, section 2): numbers about the agent, and about each target.

    In the world frame as the paper's text has it. In the body frame the pose is zero, and mean and information
    matrix are turned into the agent's frame: the same decision wherever the world's origin lies. The state is
    read as vectors of d numbers, the first of them the position. Means are in units of `length_m` [m]. With the
    scale "asinh" each number of an information matrix, which grows a thousandfold when a target is seen, enters as
    its inverse hyperbolic sine: as it is near zero, by its logarithm beyond.
    """
    mean, information = observation.mean, observation.information
    if frame == "world":
        return space.log(observation.pose), _features(mean, information, length_m, scale)
    d, (n, size) = space.dimension, mean.shape
    turn = space.rotation(observation.pose)
    position_body = space.to_body(observation.pose, mean[:, :d])
    later_body = multiply(mean[:, d:].reshape(-1, d), turn).reshape(n, size - d)
    mean_body = jnp.concatenate([position_body, later_body], axis=-1)
    # diag(R, R, ..)^T P diag(R, R, ..): every d numbers of a row, then of a column, are turned by one product.
    rows_body = multiply(information.reshape(-1, d), turn).reshape(n, size, size)
    information_body = multiply(jnp.swapaxes(rows_body, -1, -2).reshape(-1, d), turn).reshape(n, size, size)
    pose_body = jnp.zeros(space.twist_size, mean.dtype)
    return pose_body, _features(mean_body, information_body, length_m, scale)


def _features(
    mean: Float[Array, "n n_y"], information: Float[Array, "n n_y n_y"], length_m: float, scale: Scale
) -> Float[Array, "n features"]:
    packed = vech(information)
    return jnp.concatenate([mean / length_m, jnp.arcsinh(packed) if scale == "asinh" else packed], axis=-1)


def rich_inputs(observation: Observation, space: Space, length_m: float) -> Float[Array, "n numbers"]:
    """Numbers about each target: as the paper's network has them in the body frame, then more that follows from them.

    Directions, logarithms of ranges, information matrices as asinh, the steps that are left, how many targets there
    are, and the known input of each: sizes that say less and directions that say more than plain coordinates.
    """
    d, n = space.dimension, len(observation.present)
    _, usual = policy_inputs(observation, space, "body", length_m, "asinh")
    position_body = usual[:, :d] * length_m
    distance = jnp.sqrt(jnp.sum(position_body**2, axis=-1, keepdims=True) + LEAST_RANGE_M**2)
    # Padding goes on after the end of an episode.
    left = jnp.maximum(observation.left, 0).astype(usual.dtype)
    common = jnp.stack(
        [
            jnp.minimum(left / HORIZON_STEPS, MOST_UNITS),
            jnp.exp(-left / LAST_STEPS),
            jnp.sum(observation.present).astype(usual.dtype) / USUAL_TARGETS,
        ]
    )
    parts = [usual, position_body / distance, jnp.log(distance), jnp.broadcast_to(common, (n, 3))]
    if observation.known_input.shape[-1] == d:  # a vector of the world: how far the target is pushed in this step
        parts.append(multiply(observation.known_input, space.rotation(observation.pose)))
    return jnp.concatenate(parts, axis=-1)


def rich_numbers(problem: Problem, kind: str) -> int:
    """How many `rich_inputs` tells of a target. Raises ValueError where a state does not begin with the position."""
    d, n_y = problem.agent.space.dimension, problem.motion.state_size
    if not problem.motion.begins_with_position:
        raise InputError(
            f"kind = {kind!r}: expected targets whose state begins with the position, Z = [I 0] ({d} x {n_y})"
        )
    told = d if problem.motion.input_size == d else 0
    return n_y + n_y * (n_y + 1) // 2 + (d + 1) + told + 3


class Features(NamedTuple):
    """An observation as arrays for learners outside of JAX; padding is zeros."""

    agent: Float[Array, " n_u"]
    targets: Float[Array, "n features"]
    mask: Float[Array, " n"]
    """1 where a target is present."""
    left: Float[Array, " 1"]
    """The share of the episode's steps that is left."""

    @property
    def row(self) -> Float[Array, " size"]:
        """All of it, one after the other."""
        return jnp.concatenate([self.agent, self.targets.ravel(), self.mask, self.left])


def policy_features(
    observation: Observation, left: Scalar, space: Space, frame: Frame, length_m: float = 1.0, scale: Scale = "plain"
) -> Features:
    """`policy_inputs`, who is present, and the share of steps that is `left`."""
    agent, targets = policy_inputs(observation, space, frame, length_m, scale)
    present = observation.present
    return Features(
        agent=agent,
        targets=jnp.where(present[:, None], targets, 0.0),
        mask=present.astype(agent.dtype),
        left=left[None].astype(agent.dtype),
    )
