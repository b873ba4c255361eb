"""Exponentials and logarithms against `scipy.linalg.expm`, its Frechet derivatives, `logm`, and scipy's `Rotation`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.lie_oracles import (
    AXES,
    FAR_TWISTS,
    NEAR_PI,
    PLANAR_TWISTS,
    PRECISIONS,
    ROTATIONS,
    SE2,
    SE3,
    SO3,
    TWISTS,
    assert_near,
    derivative,
    hat,
    jit,
    matrix_2d,
    second_derivative,
    with_jacobians,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from foveate.geometry import lie, lie_planar


def exp_planar(twist):
    """exp(hat(twist)) as a pose: the move from the identity."""
    return lie_planar.move_se2(jnp.zeros_like(twist), twist)


exp_se2, log_se2 = jit(exp_planar), jit(lie_planar.log_se2)
log_so3, log_se3 = jit(lie.log_so3), jit(lie.log_se3)
derivative_log_so3 = jit(jax.jacrev(lie.log_so3))


# --- exponentials ---------------------------------------------------------------------------------


@PRECISIONS
def test_exp_se3(dtype, tolerance):
    """Catches jaxlie 1.5.0's slip too: near w = 0 its d(position)/dw is twice the right v cross / 2."""
    twists = jnp.asarray(np.concatenate([TWISTS, FAR_TWISTS]), dtype)
    exact = np.asarray(twists, np.float64)
    actual, jacobians = with_jacobians(lie.exp_se3, twists)
    assert_near(actual, expm(hat(SE3, exact)), 2 * tolerance)
    expected = derivative(SE3, exact)
    for jacobian in jacobians:
        assert_near(jacobian, expected, 5 * tolerance)


@PRECISIONS
def test_exp_so3(dtype, tolerance):
    w = jnp.asarray(np.concatenate([ROTATIONS, FAR_TWISTS[:, 3:]]), dtype)
    exact = np.asarray(w, np.float64)
    actual, jacobians = with_jacobians(lie.exp_so3, w)
    assert_near(actual, Rotation.from_rotvec(exact.copy()).as_matrix(), 2 * tolerance)
    expected = derivative(SO3, exact)
    for jacobian in jacobians:
        assert_near(jacobian, expected, 2 * tolerance)


@pytest.mark.slow
@PRECISIONS
def test_exp_se2(dtype, tolerance):
    twists = jnp.asarray(PLANAR_TWISTS, dtype)
    exact = np.asarray(twists, np.float64)
    poses, jacobians = with_jacobians(exp_planar, twists)
    np.testing.assert_array_equal(poses[:, 2], twists[:, 2])
    assert_near(
        [matrix_2d(pose) for pose in poses.astype(np.float64)],
        expm(hat(SE2, exact)),
        2 * tolerance,
    )
    expected = np.tile(np.eye(3), (len(exact), 1, 1))
    expected[:, :2] = derivative(SE2, exact)[:, :2, 2]
    for jacobian in jacobians:
        assert_near(jacobian, expected, 2 * tolerance)


def test_small_planar_turns_keep_their_sideways_step_in_float32():
    """y = v (1 - cos w) / w to a float32's own precision, entry by entry: no 1 - cos w is formed."""
    w = np.float32([1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2])
    twists = jnp.stack([jnp.ones_like(w), jnp.zeros_like(w), jnp.asarray(w)], axis=-1)
    exact = expm(hat(SE2, np.asarray(twists, np.float64)))[:, 1, 2]
    np.testing.assert_allclose(exp_se2(twists)[:, 1], exact, rtol=5e-7)


def test_second_derivatives_of_exp_se3():
    """Planners and Proposition 1 take Hessians: exact at zero, at small angles and around the switches."""
    angles = np.linalg.norm(TWISTS[:, 3:], axis=1).round(9)
    twists = TWISTS[np.isin(angles, [0.0, 1e-4, 0.1, 0.999999, 1.000001, 2.7])][::2]
    assert len(twists) >= 12
    second = jit(jax.vmap(jax.jacfwd(jax.jacrev(lie.exp_se3))))(twists)
    assert_near(second, second_derivative(SE3, twists), 2e-12)


@PRECISIONS
def test_second_derivatives_of_exp_se2(dtype, tolerance):
    twists = PLANAR_TWISTS[::3].astype(dtype)
    second = jit(jax.vmap(jax.jacfwd(jax.jacrev(exp_planar))))(twists)
    expected = np.zeros(second.shape)
    expected[:, :2] = second_derivative(SE2, twists.astype(np.float64))[:, :2, 2]
    assert_near(second, expected, 5 * tolerance)


def test_derivatives_of_a_thousand_turns_in_float32():
    """The branch not taken must not overflow: inf * 0 would poison the reverse mode."""
    angle = np.float32(1e5)
    jacobian = jit(jax.jacrev(lie.exp_so3))(jnp.array([angle, 0.0, 0.0], jnp.float32))
    np.testing.assert_allclose(jacobian[1, 1, 0], -np.sin(np.float64(angle)), atol=1e-5)
    planar = jit(jax.jacrev(exp_planar))(jnp.array([1.0, 0.0, angle], jnp.float32))
    np.testing.assert_allclose(planar[0, 0], np.sin(np.float64(angle)) / angle, atol=1e-6)
    assert np.all(np.isfinite(jacobian))
    assert np.all(np.isfinite(planar))


@PRECISIONS
def test_left_jacobian(dtype, tolerance):
    """J(w) = integral of exp(s w^) over s in [0, 1], a block of the exponential of [[w^, I], [0, 0]]."""
    w = jnp.asarray(ROTATIONS, dtype)
    blocks = [np.block([[hat(SO3, each), np.eye(3)], [np.zeros((3, 6))]]) for each in np.asarray(w, np.float64)]
    expected = np.array([expm(block)[:3, 3:] for block in blocks])
    assert_near(jit(lie.left_jacobian_so3)(w), expected, 2 * tolerance)
    assert_near(jit(lie.inverse_left_jacobian_so3)(w), np.linalg.inv(expected), 5 * tolerance)


# --- logarithms -----------------------------------------------------------------------------------


def assert_inverts(jacobian, changes, tolerance):
    """d log(T) along the change of expm under twist entry i is the i-th unit vector."""
    products = np.einsum("kiab,kabj->kij", jacobian, changes)
    assert_near(products, np.broadcast_to(np.eye(products.shape[-1]), products.shape), tolerance)


@pytest.mark.slow
@PRECISIONS
def test_log_inverts_expm_in_value_and_derivative(dtype, tolerance):
    """Also of rotations with rounding errors, about any axis up to pi, where it may be the other logarithm."""
    rng = np.random.default_rng(0)
    axes = rng.normal(size=(200, 3))
    half_turns = axes / np.linalg.norm(axes, axis=1, keepdims=True) * rng.choice([*NEAR_PI, np.pi], (200, 1))
    twists = np.concatenate([TWISTS, np.concatenate([rng.normal(size=(200, 3)), half_turns], axis=1)])
    transforms = expm(hat(SE3, twists))
    transforms[len(TWISTS) :, :3, :3] += np.finfo(dtype).eps * rng.uniform(-1, 1, (200, 3, 3))
    actual, jacobians = with_jacobians(lie.log_se3, jnp.asarray(transforms, dtype))
    exact = np.asarray(actual, np.float64)
    assert np.linalg.norm(exact[:, 3:], axis=1).max() <= np.pi + tolerance
    assert_near(expm(hat(SE3, exact)), transforms, 20 * tolerance)
    same = np.linalg.norm(twists[:, 3:], axis=1) < np.pi - 20 * tolerance
    assert same.sum() > len(TWISTS) - 11 + 50
    assert_near(exact[same], twists[same], 20 * tolerance)
    changes = derivative(SE3, exact)
    for jacobian in jacobians:
        assert_inverts(jacobian, changes, 50 * tolerance if dtype == np.float64 else 5 * tolerance)


@PRECISIONS
def test_log_of_a_small_turn_keeps_its_digits(dtype, tolerance):
    """Relative to the turn itself, from 1e-20 rad, which no float32 of order 1 resolves, to 0.1 rad."""
    w = np.array([angle * axis for angle in 10.0 ** np.arange(-20.0, 0.0) for axis in AXES])
    actual = np.asarray(log_so3(jnp.asarray(expm(hat(SO3, w)), dtype)))
    error = np.linalg.norm(actual - w, axis=1) / np.linalg.norm(w, axis=1)
    assert error.max() < tolerance


@settings(max_examples=40, deadline=None)
@given(arrays(np.float64, 6, elements=st.floats(-1.7, 1.7)))
def test_log_se3_is_logm(twist):
    transform = expm(hat(SE3, twist.round(12)))  # scipy's logm divides by entries too small to be divided by
    np.testing.assert_allclose(hat(SE3, np.asarray(log_se3(transform))), logm(transform), atol=1e-10)


@settings(max_examples=60, deadline=None)
@given(arrays(np.float64, 3, elements=st.floats(-1, 1)), st.floats(1e-15, 1e-3))
def test_log_so3_near_pi(direction, gap):
    if np.linalg.norm(direction) < 1e-3:
        direction = np.array([0.0, 0.0, 1.0])
    w = (np.pi - gap) * direction / np.linalg.norm(direction)
    rotation = Rotation.from_rotvec(w).as_matrix()
    actual = np.array(log_so3(rotation))
    np.testing.assert_allclose(Rotation.from_rotvec(actual).as_matrix(), rotation, atol=1e-14)
    assert np.linalg.norm(actual) <= np.pi + 1e-15
    if gap > 1e-12:
        np.testing.assert_allclose(actual, w, atol=1e-13)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("axis", AXES, ids=str)
def test_log_at_exactly_pi_is_one_of_the_two(dtype, axis):
    rotation = jnp.asarray(2 * np.outer(axis, axis) - np.eye(3), dtype)
    w = np.asarray(log_so3(rotation), np.float64)
    error = 10 * np.finfo(dtype).eps
    np.testing.assert_allclose(np.linalg.norm(w), np.pi, atol=error)
    np.testing.assert_allclose(np.abs(w @ axis), np.pi, atol=error)
    assert np.all(np.isfinite(derivative_log_so3(rotation)))


def test_second_derivative_of_log_near_the_identity_in_float32():
    """Baker, Campbell, Hausdorff: log(exp(a^) exp(b^)) = a + b + a x b / 2 + third order, here at b = 0."""

    def product(a, b):
        return lie.log_so3(jnp.matmul(lie.exp_so3(a), lie.exp_so3(b), precision="highest"))

    sizes = np.float32([0.0, 1e-6, 1e-4, 1e-3])
    a = sizes[:, None] * AXES[3].astype(np.float32)
    mixed = jit(jax.vmap(jax.jacfwd(jax.jacrev(product, 0), 1)))(a, jnp.zeros_like(a))
    expected = np.moveaxis(np.cross(np.eye(3)[:, None], np.eye(3)), -1, 0) / 2
    for size, each in zip(sizes, mixed, strict=True):
        np.testing.assert_allclose(each, expected, atol=1e-6 + 0.5 * size)


@PRECISIONS
def test_log_se2(dtype, tolerance):
    twists = PLANAR_TWISTS[np.abs(PLANAR_TWISTS[:, 2]) < np.pi]
    matrices = expm(hat(SE2, twists))
    poses = np.concatenate([matrices[:, :2, 2], twists[:, 2:]], axis=1).astype(dtype)
    actual, jacobians = with_jacobians(lie_planar.log_se2, poses)
    assert_near(actual, twists, 5 * tolerance)
    changes = np.tile(np.eye(3), (len(twists), 1, 1))
    changes[:, :2] = derivative(SE2, twists)[:, :2, 2]
    for jacobian in jacobians:
        assert_near(jacobian @ changes, np.tile(np.eye(3), (len(twists), 1, 1)), 10 * tolerance)


@settings(max_examples=40, deadline=None)
@given(arrays(np.float64, 2, elements=st.floats(-50, 50)), st.floats(-3.1, 3.1), st.integers(-4, 4))
def test_log_se2_of_any_yaw_is_logm(position, yaw, turns):
    pose = np.array([*position.round(12), yaw + 2 * np.pi * turns])
    actual = log_se2(pose)
    np.testing.assert_allclose(actual[2], yaw, atol=1e-13)
    np.testing.assert_allclose(hat(SE2, np.asarray(actual)), logm(matrix_2d(pose)), atol=1e-9)


@pytest.mark.parametrize("yaw", [np.pi, -np.pi, 3 * np.pi, -5 * np.pi])
def test_log_se2_wraps_to_the_closed_upper_end(yaw):
    assert float(log_se2(jnp.array([1.0, 2.0, yaw]))[2]) == pytest.approx(np.pi, abs=1e-14)
