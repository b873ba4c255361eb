"""Group operations, actions on points and quaternions against matrices made by `scipy.linalg.expm`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.lie_oracles import (
    PLANAR_TWISTS,
    POSES,
    PRECISIONS,
    SE2,
    SE3,
    SO3,
    TWISTS,
    assert_near,
    derivative,
    hat,
    jit,
    matrix_2d,
)
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from foveate.geometry import lie, lie_planar

move_se2 = jit(lie_planar.move_se2)
quaternion_so3 = jit(lie.quaternion_so3)


GROUPS = {"se3": (SE3, TWISTS), "se2": (SE2, PLANAR_TWISTS)}
OPERATIONS = {
    "se3": {
        "inverse": lie.inverse_se3,
        "compose": lie.compose_se3,
        "act": lie.act_se3,
        "body_point": lie.body_point_se3,
    },
    "se2": {"act": lie_planar.act_se2, "body_point": lie_planar.body_point_se2},
}


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_hat_so3(dtype):
    w = jnp.arange(1, 13, dtype=dtype).reshape(2, 2, 3)
    matrices = lie.hat_so3(w)
    assert matrices.dtype == dtype
    np.testing.assert_array_equal(matrices, hat(SO3, np.asarray(w)))
    for mode in (jax.jacfwd, jax.jacrev):
        np.testing.assert_array_equal(mode(lie.hat_so3)(w[0, 0]), np.moveaxis(SO3, 0, -1))


def element(group, matrix, yaw):
    """A group's element, or its derivative, as the code has it: in the plane position and yaw, else the matrix."""
    return np.concatenate([matrix[:, :2, 2], yaw[:, None]], axis=1) if group == "se2" else matrix


def expected_operations(group, a, b, points):
    """name: value, derivatives by the twists a and b or by the point; all from the exponential."""
    generators, size = GROUPS[group][0], points.shape[1]
    first, second, inverse = (expm(hat(generators, twist)) for twist in (a, b, -a))
    by_a, by_b, inverse_by_a = derivative(generators, a), derivative(generators, b), -derivative(generators, -a)
    last = np.broadcast_to(np.eye(a.shape[1])[-1], a.shape)
    ends = np.concatenate([points, np.ones((len(points), 1))], axis=1)

    def image(matrix):
        return np.einsum("kab...,kb->ka...", matrix, ends)[:, :size]

    compose = element(group, first @ second, a[:, -1] + b[:, -1])
    compose_by_a = element(group, np.einsum("kabi,kbc->kaci", by_a, second), last)
    compose_by_b = element(group, np.einsum("kab,kbci->kaci", first, by_b), last)
    return {
        "inverse": (element(group, inverse, -a[:, -1]), element(group, inverse_by_a, -last)),
        "compose": (compose, compose_by_a, compose_by_b),
        "act": (image(first), image(by_a), first[:, :size, :size]),
        "body_point": (image(inverse), image(inverse_by_a), inverse[:, :size, :size]),
    }


@pytest.mark.slow
@PRECISIONS
@pytest.mark.parametrize("group", GROUPS)
def test_operations_and_their_jacobians(group, dtype, tolerance):
    generators, a = GROUPS[group]
    b = np.roll(a, len(a) // 2 + 1, axis=0)
    points = np.random.default_rng(0).normal(size=(len(a), 2 if group == "se2" else 3))
    last = np.broadcast_to(np.eye(a.shape[1])[-1], a.shape)
    elements = [element(group, expm(hat(generators, twist)), twist[:, -1]) for twist in (a, b)]
    tangents = [element(group, derivative(generators, twist), last) for twist in (a, b)]
    by_point = np.broadcast_to(np.eye(points.shape[1]), (*points.shape, points.shape[1]))
    first, second, point = (jnp.asarray(each, dtype) for each in (*elements, points))
    arguments = {"inverse": (first,), "compose": (first, second), "act": (first, point), "body_point": (first, point)}
    changes = dict.fromkeys(arguments, (tangents[0], by_point)) | {"inverse": tangents[:1], "compose": tangents}
    expected_values = expected_operations(group, a, b, points)
    for name, function in OPERATIONS[group].items():
        value, *derivatives = expected_values[name]
        places = tuple(range(len(arguments[name])))
        both = jit(jax.vmap(lambda *x, f=function, i=places: (f(*x), jax.jacfwd(f, i)(*x), jax.jacrev(f, i)(*x))))
        actual, *modes = both(*arguments[name])
        assert actual.dtype == dtype
        assert_near(actual, value, 5 * tolerance)
        for jacobians in modes:
            for jacobian, change, expected in zip(jacobians, changes[name], derivatives, strict=True):
                entries = np.asarray(jacobian, np.float64).reshape(len(a), -1, np.prod(change.shape[1:-1]))
                along = entries @ change.reshape(len(a), -1, change.shape[-1])
                assert_near(along.reshape(expected.shape), expected, 5 * tolerance)


def test_planar_rotation_of_any_yaw():
    for pose in POSES:
        np.testing.assert_allclose(lie_planar.rotation_se2(jnp.asarray(pose)), matrix_2d(pose)[:2, :2], atol=1e-14)


@PRECISIONS
def test_move_se2(dtype, tolerance):
    twists = PLANAR_TWISTS.astype(dtype)
    displacements = expm(hat(SE2, twists.astype(np.float64)))
    for start in POSES.astype(dtype):
        moved = np.asarray(move_se2(start, twists))
        expected = matrix_2d(start.astype(np.float64)) @ displacements
        # A float32 yaw of 11 + w is itself only known to 5e-7 rad.
        assert_near(moved[:, :2], expected[:, :2, 2], 5 * tolerance)
        assert_near(moved[:, 2], start[2] + twists[:, 2], 0.0)


@pytest.mark.parametrize("turn", np.eye(3), ids="xyz")
def test_quaternions_of_every_branch(turn):
    """Near the identity and near half turns about x, y and z, where Shepperd's four rows take over."""
    rotations = Rotation.from_rotvec(np.outer([1e-9, 0.3, 1.6, 3.0, -3.1], turn)) * Rotation.from_rotvec(
        [0.1, -0.1, 0.05]
    )
    expected = rotations.as_quat(canonical=True, scalar_first=True)
    np.testing.assert_allclose(quaternion_so3(rotations.as_matrix()), expected, atol=1e-14)


TRANSFORMS = jnp.asarray(expm(hat(SE3, TWISTS[40:43])))
POINTS = jnp.asarray(np.linspace(-1, 2, 15).reshape(5, 3))


@pytest.mark.parametrize(
    ("function", "left", "right"),
    [
        (lie.act_se3, TRANSFORMS, POINTS),
        (lie.body_point_se3, TRANSFORMS, POINTS),
        (lie.compose_se3, TRANSFORMS, TRANSFORMS),
        (lie_planar.act_se2, jnp.asarray(POSES[:3]), POINTS[:, :2]),
        (lie_planar.body_point_se2, jnp.asarray(POSES[:3]), POINTS[:, :2]),
        (lie_planar.move_se2, jnp.asarray(POSES[:3]), POINTS),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_leading_axes_broadcast_and_agree_with_vmap(function, left, right):
    mapped = jit(jax.vmap(jax.vmap(function, (None, 0)), (0, None)))(left, right)
    np.testing.assert_allclose(jit(function)(left[:, None], right), mapped, atol=1e-14)


def test_leading_axes_of_one_argument_agree_with_vmap():
    for function in (lie.log_se3, lie.inverse_se3):
        mapped = jit(jax.vmap(jax.vmap(function)))(TRANSFORMS[:, None])
        np.testing.assert_allclose(jit(function)(TRANSFORMS[:, None]), mapped, atol=1e-14)


def test_float32_rotations_survive_ten_thousand_steps():
    """Composed 10,000 times, it stays orthonormal to 1e-4 and within 1e-3 of the float64 one."""
    twists = 0.5 * np.random.default_rng(0).normal(size=(10_000, 6))

    def walk(steps):
        start = jnp.eye(4, dtype=steps.dtype)
        return jax.lax.scan(lambda pose, u: (lie.compose_se3(pose, lie.exp_se3(u)), None), start, steps)[0]

    exact, rounded = (np.asarray(jit(walk)(jnp.asarray(twists, dtype))) for dtype in (np.float64, np.float32))
    rotation = rounded[:3, :3].astype(np.float64)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-4)
    np.testing.assert_allclose(rotation, exact[:3, :3], atol=1e-3)
