"""Rigid motions: the groups SO(3), SE(3) and SE(2), their exponentials, logarithms and actions.

Twists are [v; w], translation first, in the body frame. A spatial pose is the 4 x 4 transform T, body to
world; a planar pose is the vector [x, y, yaw], whose yaw counts turns and is never wrapped by a composition.
Every function takes leading batch axes, which broadcast, and keeps the dtype. Metres and radians.

Numerics. The removable singularities of the exponential are functions of the *squared* angle: a Taylor series
below 1 rad, the closed form above, each behind a `where` that keeps the other's argument harmless. Switching
that late, the closed forms cancel nowhere, so one switch serves float32 and float64, first and second
derivatives. Products of small matrices are written as multiply-and-sum: a float32 `@` may run in reduced
precision on an accelerator, and XLA fuses the sum with what surrounds it.
"""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.series import SERIES_TERMS, sinc, stumpff


def _apply(matrix: Float[Array, "*#b i j"], vector: Float[Array, "*#b j"]) -> Float[Array, "... i"]:
    return jnp.sum(matrix * vector[..., None, :], axis=-1)


def _product(first: Float[Array, "*#b i j"], second: Float[Array, "*#b j k"]) -> Float[Array, "... i k"]:
    return jnp.sum(first[..., :, :, None] * second[..., None, :, :], axis=-2)


def _apply_transposed(matrix: Float[Array, "*#b i j"], vector: Float[Array, "*#b i"]) -> Float[Array, "... j"]:
    return jnp.sum(matrix * vector[..., :, None], axis=-2)


# --- SE(2) ----------------------------------------------------------------------------------------


def _rotate(angle: Float[Array, "*#b"], vector: Float[Array, "*#b 2"]) -> Float[Array, "... 2"]:
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x, y = vector[..., 0], vector[..., 1]
    return jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def _planar(position: Float[Array, "*b 2"], yaw: Float[Array, "*b"]) -> Float[Array, "*b 3"]:
    return jnp.concatenate([position, yaw[..., None]], axis=-1)


def hat_se2(twist: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """The matrix [[0, -w, v_x], [w, 0, v_y], [0, 0, 0]] of a planar twist [v_x, v_y, w]."""
    v_x, v_y, w = twist[..., 0], twist[..., 1], twist[..., 2]
    zero = jnp.zeros_like(w)
    return _matrix([[zero, -w, v_x], [w, zero, v_y], [zero, zero, zero]])


def vee_se2(matrix: Float[Array, "*b 3 3"]) -> Float[Array, "*b 3"]:
    """The inverse of `hat_se2`."""
    return jnp.stack([matrix[..., 0, 2], matrix[..., 1, 2], matrix[..., 1, 0]], axis=-1)


def matrix_se2(pose: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """The homogeneous transform [[R(yaw), position], [0, 1]] of a planar pose."""
    cos, sin = jnp.cos(pose[..., 2]), jnp.sin(pose[..., 2])
    zero, one = jnp.zeros_like(cos), jnp.ones_like(cos)
    return _matrix([[cos, -sin, pose[..., 0]], [sin, cos, pose[..., 1]], [zero, zero, one]])


def move_se2(pose: Float[Array, "*#b 3"], twist: Float[Array, "*#b 3"]) -> Float[Array, "... 3"]:
    """T exp(hat(twist)): the pose after a constant twist for unit time.

    An arc of w radians is its chord, sinc(w/2) times as long, seen at half the angle:
    position' = position + sinc(w/2) R(yaw + w/2) v. This has no 1 - cos w to cancel, and needs R only once.
    """
    half_turn = 0.5 * twist[..., 2]
    chord = _rotate(pose[..., 2] + half_turn, sinc(half_turn)[..., None] * twist[..., :2])
    return _planar(pose[..., :2] + chord, pose[..., 2] + twist[..., 2])


def exp_se2(twist: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """exp(hat(twist)) as a pose: [sinc(w/2) R(w/2) v, w]."""
    half_turn = 0.5 * twist[..., 2]
    return _planar(_rotate(half_turn, sinc(half_turn)[..., None] * twist[..., :2]), twist[..., 2])


def log_se2(pose: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """log(T)^v, the twist of least turn that leads to a pose: w in (-pi, pi] is the wrapped yaw."""
    yaw = pose[..., 2]
    w = yaw - 2.0 * math.pi * jnp.ceil((yaw - math.pi) / (2.0 * math.pi))
    return _planar(_rotate(-0.5 * w, pose[..., :2] / sinc(0.5 * w)[..., None]), w)


def compose_se2(first: Float[Array, "*#b 3"], second: Float[Array, "*#b 3"]) -> Float[Array, "... 3"]:
    """T_1 T_2; the yaws add, unwrapped."""
    position = first[..., :2] + _rotate(first[..., 2], second[..., :2])
    return _planar(position, first[..., 2] + second[..., 2])


def inverse_se2(pose: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """T^-1 = [-R(yaw)^T position, -yaw]."""
    return _planar(_rotate(-pose[..., 2], -pose[..., :2]), -pose[..., 2])


def act_se2(pose: Float[Array, "*#b 3"], point_body: Float[Array, "*#b 2"]) -> Float[Array, "... 2"]:
    """The world position R(yaw) q + position of a body-frame point q."""
    return pose[..., :2] + _rotate(pose[..., 2], point_body)


def body_point_se2(pose: Float[Array, "*#b 3"], point_world: Float[Array, "*#b 2"]) -> Float[Array, "... 2"]:
    """The body-frame point q = Q T^-1 [zeta; 1] = R(yaw)^T (zeta - position) of a world position zeta."""
    return _rotate(-pose[..., 2], point_world - pose[..., :2])


# --- SO(3) ----------------------------------------------------------------------------------------


def _matrix(rows: list[list[Float[Array, "*b"]]]) -> Float[Array, "*b i j"]:
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def _axis_series(
    w: Float[Array, "*b 3"], linear: Float[Array, "*b"] | float, quadratic: Float[Array, "*b"]
) -> Float[Array, "*b 3 3"]:
    """I + linear w^ + quadratic (w^)^2, with (w^)^2 = w w^T - |w|^2 I."""
    eye = jnp.eye(3, dtype=w.dtype)
    outer = w[..., :, None] * w[..., None, :]
    square = outer - jnp.sum(w * w, axis=-1)[..., None, None] * eye
    linear_term = hat_so3(jnp.asarray(linear, w.dtype)[..., None] * w)
    return eye + linear_term + quadratic[..., None, None] * square


def hat_so3(w: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """The skew matrix w^ with w^ x = w cross x."""
    x, y, z = w[..., 0], w[..., 1], w[..., 2]
    zero = jnp.zeros_like(x)
    return _matrix([[zero, -z, y], [z, zero, -x], [-y, x, zero]])


def vee_so3(skew: Float[Array, "*b 3 3"]) -> Float[Array, "*b 3"]:
    """The inverse of `hat_so3`."""
    return jnp.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)


def exp_so3(w: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Rodrigues: exp(w^) = I + sin(a)/a w^ + (1 - cos a)/a^2 (w^)^2, a = |w|."""
    c_1, c_2, _, _ = stumpff(jnp.sum(w * w, axis=-1))
    return _axis_series(w, c_1, c_2)


def left_jacobian_so3(w: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """J = I + (1 - cos a)/a^2 w^ + (a - sin a)/a^3 (w^)^2, a = |w|.

    exp((w + dw)^) = exp((J dw)^) exp(w^) to first order in dw.
    """
    _, c_2, c_3, _ = stumpff(jnp.sum(w * w, axis=-1))
    return _axis_series(w, c_2, c_3)


def inverse_left_jacobian_so3(w: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """J^-1 = I - w^/2 + (1 - (a/2) cot(a/2))/a^2 (w^)^2 for |w| < 2 pi.

    The last coefficient is (c_3 - 2 c_4) / (2 c_2) in Stumpff functions, which does not cancel at a = 0.
    """
    _, c_2, c_3, c_4 = stumpff(jnp.sum(w * w, axis=-1))
    return _axis_series(w, -0.5, (c_3 - 2.0 * c_4) / (2.0 * c_2))


def quaternion_so3(rotation: Float[Array, "*b 3 3"]) -> Float[Array, "*b 4"]:
    """The unit quaternion [q_w, q_x, q_y, q_z], q_w >= 0, of a rotation matrix (Shepperd 1978).

    4 q q^T is linear in R; its row with the largest diagonal is q, scaled by 4 q_i with |q_i| >= 1/2.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (tuple(rotation[..., i, j] for j in range(3)) for i in range(3))
    outer = _matrix(
        [
            [1.0 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, 1.0 + xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, 1.0 - xx + yy - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, 1.0 - xx - yy + zz],
        ]
    )
    largest = jnp.argmax(jnp.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    row = jnp.take_along_axis(outer, largest[..., None, None], axis=-2)[..., 0, :]
    row = jnp.where(row[..., :1] < 0.0, -row, row)
    return row / jnp.sqrt(jnp.sum(row * row, axis=-1, keepdims=True))


def rotation_quaternion(quaternion: Float[Array, "*b 4"]) -> Float[Array, "*b 3 3"]:
    """R = I + 2 q_w n^ + 2 (n^)^2 of a quaternion [q_w; n], here of any length but zero."""
    scale = 2.0 / jnp.sum(quaternion * quaternion, axis=-1)
    return _axis_series(quaternion[..., 1:], scale * quaternion[..., 0], scale)


def log_so3(rotation: Float[Array, "*b 3 3"]) -> Float[Array, "*b 3"]:
    """The rotation vector w, |w| <= pi, with exp(w^) = R; at exactly pi one of the two that are right.

    w = 2 atan2(|n|, q_w) n / |n| with R's unit quaternion [q_w; n], smooth near the identity and near pi.
    """
    quaternion = quaternion_so3(rotation)
    q_w, n = quaternion[..., 0], quaternion[..., 1:]
    square = jnp.sum(n * n, axis=-1)
    small = square < 0.01  # below 0.2 rad the closed form would lose digits of its second derivative
    ratio = jnp.where(small, square, 0.0) / jnp.where(small, q_w * q_w, 1.0)
    series = jnp.zeros_like(ratio)
    for j in reversed(range(SERIES_TERMS)):  # atan(t)/t; t^2 < 0.0102, so t^18/19 < 1e-19 is left out
        series = 1.0 / (2 * j + 1) - ratio * series
    length = jnp.sqrt(jnp.where(small, 1.0, square))
    scale = jnp.where(small, series / jnp.where(small, q_w, 1.0), jnp.arctan2(length, q_w) / length)
    return 2.0 * scale[..., None] * n


def inverse_so3(rotation: Float[Array, "*b 3 3"]) -> Float[Array, "*b 3 3"]:
    """R^-1 = R^T."""
    return jnp.swapaxes(rotation, -1, -2)


def compose_so3(first: Float[Array, "*#b 3 3"], second: Float[Array, "*#b 3 3"]) -> Float[Array, "... 3 3"]:
    """R_1 R_2."""
    return _product(first, second)


def act_so3(rotation: Float[Array, "*#b 3 3"], point_body: Float[Array, "*#b 3"]) -> Float[Array, "... 3"]:
    """The rotated point R q."""
    return _apply(rotation, point_body)


# --- SE(3) ----------------------------------------------------------------------------------------


def _transform(rotation: Float[Array, "*b 3 3"], position: Float[Array, "*b 3"]) -> Float[Array, "*b 4 4"]:
    top = jnp.concatenate([rotation, position[..., None]], axis=-1)
    bottom = jnp.broadcast_to(jnp.array([0.0, 0.0, 0.0, 1.0], top.dtype), (*top.shape[:-2], 1, 4))
    return jnp.concatenate([top, bottom], axis=-2)


def hat_se3(twist: Float[Array, "*b 6"]) -> Float[Array, "*b 4 4"]:
    """The matrix [[w^, v], [0, 0]] of a twist [v; w]."""
    top = jnp.concatenate([hat_so3(twist[..., 3:]), twist[..., :3, None]], axis=-1)
    return jnp.concatenate([top, jnp.zeros_like(top[..., :1, :])], axis=-2)


def vee_se3(matrix: Float[Array, "*b 4 4"]) -> Float[Array, "*b 6"]:
    """The inverse of `hat_se3`."""
    return jnp.concatenate([matrix[..., :3, 3], vee_so3(matrix[..., :3, :3])], axis=-1)


def exp_se3(twist: Float[Array, "*b 6"]) -> Float[Array, "*b 4 4"]:
    """exp(hat(twist)) = [[exp(w^), J(w) v], [0, 1]], J the left Jacobian of SO(3)."""
    v, w = twist[..., :3], twist[..., 3:]
    return _transform(exp_so3(w), _apply(left_jacobian_so3(w), v))


def log_se3(transform: Float[Array, "*b 4 4"]) -> Float[Array, "*b 6"]:
    """log(T)^v = [J(w)^-1 position; w] with w = log(R)^v, |w| <= pi."""
    w = log_so3(transform[..., :3, :3])
    return jnp.concatenate([_apply(inverse_left_jacobian_so3(w), transform[..., :3, 3]), w], axis=-1)


def inverse_se3(transform: Float[Array, "*b 4 4"]) -> Float[Array, "*b 4 4"]:
    """T^-1 = [[R^T, -R^T position], [0, 1]]."""
    rotation = transform[..., :3, :3]
    return _transform(inverse_so3(rotation), -_apply_transposed(rotation, transform[..., :3, 3]))


def compose_se3(first: Float[Array, "*#b 4 4"], second: Float[Array, "*#b 4 4"]) -> Float[Array, "... 4 4"]:
    """T_1 T_2."""
    return _product(first, second)


def act_se3(transform: Float[Array, "*#b 4 4"], point_body: Float[Array, "*#b 3"]) -> Float[Array, "... 3"]:
    """The world position R q + position of a body-frame point q."""
    return transform[..., :3, 3] + _apply(transform[..., :3, :3], point_body)


def body_point_se3(transform: Float[Array, "*#b 4 4"], point_world: Float[Array, "*#b 3"]) -> Float[Array, "... 3"]:
    """The body-frame point q = Q T^-1 [zeta; 1] = R^T (zeta - position) of a world position zeta."""
    return _apply_transposed(transform[..., :3, :3], point_world - transform[..., :3, 3])
