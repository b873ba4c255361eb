"""The group SE(2): exponential, logarithm and action of planar poses.

A pose is the vector [x, y, yaw]; yaw counts turns, and only `wrapped_se2` ever wraps it. A twist is [v_x, v_y, w]
in the body frame. Every function takes leading batch axes, which broadcast, and keeps the dtype. Metres and radians.
The numerics are those of `lie`.
"""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.series import sinc

WRAPPED = 8.0 * math.pi
"""Yaw beyond half of this is wrapped by all of it [rad]: counted turns would take its digits, one by one."""


def _rotate(angle: Float[Array, "*#b"], vector: Float[Array, "*#b 2"]) -> Float[Array, "... 2"]:
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x, y = vector[..., 0], vector[..., 1]
    return jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def _planar(position: Float[Array, "*b 2"], yaw: Float[Array, "*b"]) -> Float[Array, "*b 3"]:
    return jnp.concatenate([position, yaw[..., None]], axis=-1)


def rotation_se2(pose: Float[Array, "*b 3"]) -> Float[Array, "*b 2 2"]:
    """R(yaw), body to world."""
    cos, sin = jnp.cos(pose[..., 2]), jnp.sin(pose[..., 2])
    return jnp.stack([jnp.stack([cos, -sin], axis=-1), jnp.stack([sin, cos], axis=-1)], axis=-2)


def move_se2(pose: Float[Array, "*#b 3"], twist: Float[Array, "*#b 3"]) -> Float[Array, "... 3"]:
    """T exp(hat(twist)): the pose after a constant twist for unit time.

    An arc of w radians has a chord sinc(w/2) times as long, at half the angle:
    position' = position + sinc(w/2) R(yaw + w/2) v. This has no 1 - cos w to cancel, and needs R only once.
    """
    half_turn = 0.5 * twist[..., 2]
    chord = _rotate(pose[..., 2] + half_turn, sinc(half_turn)[..., None] * twist[..., :2])
    return _planar(pose[..., :2] + chord, pose[..., 2] + twist[..., 2])


def wrapped_se2(pose: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """The same pose, its yaw within two turns either way; one that is so already stays as it is, to the last bit."""
    yaw = pose[..., 2]
    return _planar(pose[..., :2], yaw - WRAPPED * jnp.round(yaw / WRAPPED))


def log_se2(pose: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """log(T)^v, the twist of least turn that leads to a pose: w in (-pi, pi] is the wrapped yaw."""
    yaw = pose[..., 2]
    w = yaw - 2.0 * math.pi * jnp.ceil((yaw - math.pi) / (2.0 * math.pi))
    return _planar(_rotate(-0.5 * w, pose[..., :2] / sinc(0.5 * w)[..., None]), w)


def act_se2(pose: Float[Array, "*#b 3"], point_body: Float[Array, "*#b 2"]) -> Float[Array, "... 2"]:
    """The world position R(yaw) q + position of a body-frame point q."""
    return pose[..., :2] + _rotate(pose[..., 2], point_body)


def body_point_se2(pose: Float[Array, "*#b 3"], point_world: Float[Array, "*#b 2"]) -> Float[Array, "... 2"]:
    """The body-frame point q = Q T^-1 [zeta; 1] = R(yaw)^T (zeta - position) of a world position zeta."""
    return _rotate(-pose[..., 2], point_world - pose[..., :2])
