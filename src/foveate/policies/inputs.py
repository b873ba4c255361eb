"""What a learned policy is told: pose and predicted beliefs as numbers, in the agent's frame or in the world's."""

from typing import Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.space import Space
from foveate.linalg import multiply, vech
from foveate.problem import Observation
from foveate.types import Scalar

Frame = Literal["body", "world"]
Scale = Literal["plain", "asinh"]


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


class Told(NamedTuple):
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


def told(
    observation: Observation, left: Scalar, space: Space, frame: Frame, length_m: float = 1.0, scale: Scale = "plain"
) -> Told:
    """`policy_inputs`, who is present, and the share of steps that is `left`."""
    agent, targets = policy_inputs(observation, space, frame, length_m, scale)
    present = observation.present
    return Told(
        agent=agent,
        targets=jnp.where(present[:, None], targets, 0.0),
        mask=present.astype(agent.dtype),
        left=left[None].astype(agent.dtype),
    )
