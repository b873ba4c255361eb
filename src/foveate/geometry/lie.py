"""The groups SO(3) and SE(3): exponentials, logarithms and actions. SE(2) is in `lie_planar`.

Twists are [v; w], translation first, in the body frame. A spatial pose is the 4 x 4 transform T, body to world. Every
function takes leading batch axes, which broadcast, and keeps the dtype. Metres and radians.

Numerics. The removable singularities of the exponential are functions of the *squared* angle: a Taylor series
below 1 rad, the closed form above, each behind a `where` that keeps the other's argument harmless. Above 1 rad the
closed forms do not cancel, so one switch serves float32 and float64, first and second derivatives. Products of small
matrices are written as multiply-and-sum: a float32 `@` may run in reduced precision on an accelerator, and XLA fuses
the sum with its surroundings.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.series import SERIES_TERMS, stumpff


def _apply(matrix: Float[Array, "*#b i j"], vector: Float[Array, "*#b j"]) -> Float[Array, "... i"]:
    return jnp.sum(matrix * vector[..., None, :], axis=-1)


def _apply_transposed(matrix: Float[Array, "*#b i j"], vector: Float[Array, "*#b i"]) -> Float[Array, "... j"]:
    return jnp.sum(matrix * vector[..., :, None], axis=-2)


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


def log_so3(rotation: Float[Array, "*b 3 3"]) -> Float[Array, "*b 3"]:
    """The rotation vector w, |w| <= pi, with exp(w^) = R; at exactly pi one of the two solutions.

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


def _transform(rotation: Float[Array, "*b 3 3"], position: Float[Array, "*b 3"]) -> Float[Array, "*b 4 4"]:
    top = jnp.concatenate([rotation, position[..., None]], axis=-1)
    bottom = jnp.broadcast_to(jnp.array([0.0, 0.0, 0.0, 1.0], top.dtype), (*top.shape[:-2], 1, 4))
    return jnp.concatenate([top, bottom], axis=-2)


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
    return _transform(jnp.swapaxes(rotation, -1, -2), -_apply_transposed(rotation, transform[..., :3, 3]))


def compose_se3(first: Float[Array, "*#b 4 4"], second: Float[Array, "*#b 4 4"]) -> Float[Array, "... 4 4"]:
    """T_1 T_2."""
    return jnp.sum(first[..., :, :, None] * second[..., None, :, :], axis=-2)


def orthonormal_se3(transform: Float[Array, "*b 4 4"]) -> Float[Array, "*b 4 4"]:
    """A pose whose R has left the group by rounding, led back by Newton's step R (3 I - R^T R) / 2.

    One that is orthonormal to 1e-5 stays as it is, to the last bit: after some ten products in float32, never in
    float64.
    """
    rotation = transform[..., :3, :3]
    excess = jnp.sum(rotation[..., :, :, None] * rotation[..., :, None, :], axis=-3) - jnp.eye(3, dtype=rotation.dtype)
    led_back = rotation - 0.5 * jnp.sum(rotation[..., :, :, None] * excess[..., None, :, :], axis=-2)
    has_left = jnp.max(jnp.abs(excess), axis=(-2, -1), keepdims=True) > 1e-5
    return _transform(jnp.where(has_left, led_back, rotation), transform[..., :3, 3])


def act_se3(transform: Float[Array, "*#b 4 4"], point_body: Float[Array, "*#b 3"]) -> Float[Array, "... 3"]:
    """The world position R q + position of a body-frame point q."""
    return transform[..., :3, 3] + _apply(transform[..., :3, :3], point_body)


def body_point_se3(transform: Float[Array, "*#b 4 4"], point_world: Float[Array, "*#b 3"]) -> Float[Array, "... 3"]:
    """The body-frame point q = Q T^-1 [zeta; 1] = R^T (zeta - position) of a world position zeta."""
    return _apply_transposed(transform[..., :3, :3], point_world - transform[..., :3, 3])
