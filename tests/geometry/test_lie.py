"""The Lie groups against `scipy.linalg.expm`, its Frechet derivatives, `logm`, and scipy's `Rotation`."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from foveate.geometry import lie

# Zero, the small angles where a difference of nearly equal numbers shows, both sides of the series switches
# (1 rad; 2 rad in the plane, where half the angle counts; 0.2 rad in the logarithm), and both sides of pi.
SWITCHES = [angle + side for angle in (0.2, 1.0, 2.0) for side in (-1e-6, 1e-6)]
ANGLES = [0.0, *(10.0**e for e in range(-8, 0)), 3e-3, 0.5, *SWITCHES, 2.7, 3.1, np.pi - 1e-6]
BEYOND_PI = [np.pi, np.pi + 1e-6, 4.0, 6.2]
AXES = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0], [0.6, -0.48, 0.64], [-0.1, 0.02, 0.99]])
AXES = AXES / np.linalg.norm(AXES, axis=1, keepdims=True)
VELOCITIES = np.array([[1.0, -0.7, 0.4], [0.0, 0.0, 0.0], [0.3, 2.0, -1.1]])

ROTATIONS = np.array([angle * axis for angle in ANGLES for axis in AXES])
TWISTS = np.concatenate([np.resize(VELOCITIES, ROTATIONS.shape), ROTATIONS], axis=1)
FAR_TWISTS = np.array([[*VELOCITIES[i % 3], *(a * n)] for a in BEYOND_PI for i, n in enumerate(AXES)])
PLANAR_TWISTS = np.array(
    [[*v[:2], sign * angle] for angle in (*ANGLES, *BEYOND_PI) for v in VELOCITIES for sign in (1.0, -1.0)]
)
POSES = np.array([[1.0, -2.0, 0.3], [-0.5, 4.0, -2.9], [3.0, 0.2, 11.0], [0.0, 0.0, 0.0]])

# Of the largest entry. 1e-10 and 1e-5 would do; the code is better, and a lost digit should not pass unseen.
PRECISIONS = pytest.mark.parametrize(
    ("dtype", "tolerance"), [(np.float64, 1e-13), (np.float32, 1e-6)], ids=["float64", "float32"]
)


# These graphs are large and run once: compiled without optimisation they cost 40 % less.
jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
exp_se2, log_se2, move_se2 = jit(lie.exp_se2), jit(lie.log_se2), jit(lie.move_se2)
log_so3, log_se3 = jit(lie.log_so3), jit(lie.log_se3)
quaternion_so3, rotation_quaternion = jit(lie.quaternion_so3), jit(lie.rotation_quaternion)
derivative_log_so3 = jit(jax.jacrev(lie.log_so3))


# The matrices of the unit twists, e_i cross e_j in column j.
SO3 = np.array([np.cross(axis, np.eye(3)).T for axis in np.eye(3)])
SE3 = np.zeros((6, 4, 4))
SE3[[0, 1, 2], [0, 1, 2], 3], SE3[3:, :3, :3] = 1.0, SO3
SE2 = SE3[np.ix_([0, 1, 5], [0, 1, 3], [0, 1, 3])]


def hat(generators, twists):
    return np.einsum("...i,iab->...ab", twists, generators)


def matrix_2d(pose):
    matrix = np.eye(3)
    matrix[:2, :2] = Rotation.from_euler("z", pose[2]).as_matrix()[:2, :2]
    matrix[:2, 2] = pose[:2]
    return matrix


def derivative(generators, twists):
    """d expm(hat) / d twist, the twist's axis last: expm [[X, E], [0, X]] has it in its corner."""
    x, e = np.broadcast_arrays(hat(generators, twists)[:, None], generators)
    corner = expm(np.block([[x, e], [np.zeros_like(x), x]]))[..., : x.shape[-1], x.shape[-1] :]
    return np.moveaxis(corner, 1, -1)


def second_derivative(generators, twists):
    """d2 expm(hat) / d twist2, read off a block matrix in the same way (Higham and Relton 2014)."""
    x, a, b = np.broadcast_arrays(hat(generators, twists)[:, None, None], generators[:, None], generators[None, :])
    o = np.zeros_like(x)
    corner = expm(np.block([[x, a, b, o], [o, x, o, b], [o, o, x, a], [o, o, o, x]]))
    return np.moveaxis(corner[..., : x.shape[-1], -x.shape[-1] :], (1, 2), (-2, -1))


def assert_near(actual, expected, tolerance):
    """Every sample's largest error, in parts of the sample's largest entry (at least 1)."""
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert actual.shape == expected.shape
    each = tuple(range(1, expected.ndim))
    error = np.abs(actual - expected).max(axis=each) / np.maximum(np.abs(expected).max(axis=each), 1.0)
    assert np.all(error <= tolerance), f"sample {np.nanargmax(error)}: {error.max():.1e} > {tolerance:.0e}"


def with_jacobians(function, samples):
    """The values and the Jacobians, of both modes in float64 and the reverse in float32, in one compilation."""
    modes = (jax.jacrev, jax.jacfwd) if samples.dtype == jnp.float64 else (jax.jacrev,)

    def together(sample):
        return function(sample), *(mode(function)(sample) for mode in modes)

    results = [np.asarray(result) for result in jit(jax.vmap(together))(samples)]
    assert all(result.dtype == samples.dtype for result in results)
    return results[0], results[1:]


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


@PRECISIONS
def test_exp_se2(dtype, tolerance):
    twists = jnp.asarray(PLANAR_TWISTS, dtype)
    exact = np.asarray(twists, np.float64)
    poses, jacobians = with_jacobians(lie.exp_se2, twists)
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
    second = jit(jax.vmap(jax.jacfwd(jax.jacrev(lie.exp_se2))))(twists)
    expected = np.zeros(second.shape)
    expected[:, :2] = second_derivative(SE2, twists.astype(np.float64))[:, :2, 2]
    assert_near(second, expected, 5 * tolerance)


def test_derivatives_of_a_thousand_turns_in_float32():
    """The branch not taken must not overflow: inf * 0 would poison the reverse mode."""
    angle = np.float32(1e5)
    jacobian = jit(jax.jacrev(lie.exp_so3))(jnp.array([angle, 0.0, 0.0], jnp.float32))
    np.testing.assert_allclose(jacobian[1, 1, 0], -np.sin(np.float64(angle)), atol=1e-5)
    planar = jit(jax.jacrev(lie.exp_se2))(jnp.array([1.0, 0.0, angle], jnp.float32))
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


@PRECISIONS
def test_log_inverts_expm_in_value_and_derivative(dtype, tolerance):
    """d log(T) along the change of expm under twist entry i is the i-th unit vector."""
    # Rounding to float32 can carry a rotation within 1e-6 of pi across it, to the other logarithm.
    near_pi = np.linalg.norm(TWISTS[:, 3:], axis=1) > 3.12
    twists = TWISTS if dtype == np.float64 else TWISTS[~near_pi]
    transforms = jnp.asarray(expm(hat(SE3, twists)), dtype)
    changes = derivative(SE3, twists)
    actual, jacobians = with_jacobians(lie.log_se3, transforms)
    assert_near(actual, twists, 20 * tolerance)
    identity = np.tile(np.eye(6), (len(twists), 1, 1))
    for jacobian in jacobians:
        assert_near(np.einsum("kiab,kabj->kij", jacobian, changes), identity, 50 * tolerance)


@settings(max_examples=40, deadline=None)
@given(arrays(np.float64, 6, elements=st.floats(-1.7, 1.7)))
def test_log_se3_is_logm(twist):
    transform = expm(hat(SE3, twist))
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
    actual, jacobians = with_jacobians(lie.log_se2, poses)
    assert_near(actual, twists, 5 * tolerance)
    changes = np.tile(np.eye(3), (len(twists), 1, 1))
    changes[:, :2] = derivative(SE2, twists)[:, :2, 2]
    for jacobian in jacobians:
        assert_near(jacobian @ changes, np.tile(np.eye(3), (len(twists), 1, 1)), 10 * tolerance)


@settings(max_examples=40, deadline=None)
@given(arrays(np.float64, 2, elements=st.floats(-50, 50)), st.floats(-3.1, 3.1), st.integers(-4, 4))
def test_log_se2_of_any_yaw_is_logm(position, yaw, turns):
    pose = np.array([*position, yaw + 2 * np.pi * turns])
    actual = log_se2(pose)
    np.testing.assert_allclose(actual[2], yaw, atol=1e-13)
    np.testing.assert_allclose(hat(SE2, np.asarray(actual)), logm(matrix_2d(pose)), atol=1e-9)


@pytest.mark.parametrize("yaw", [np.pi, -np.pi, 3 * np.pi, -5 * np.pi])
def test_log_se2_wraps_to_the_closed_upper_end(yaw):
    assert float(log_se2(jnp.array([1.0, 2.0, yaw]))[2]) == pytest.approx(np.pi, abs=1e-14)


# --- groups and actions ---------------------------------------------------------------------------


def test_hat_and_vee():
    w, twist = np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(jit(lie.hat_so3)(w), hat(SO3, w))
    np.testing.assert_array_equal(jit(lie.hat_se3)(twist), hat(SE3, twist))
    np.testing.assert_array_equal(jit(lie.hat_se2)(w), hat(SE2, w))
    np.testing.assert_array_equal(jit(lie.vee_so3)(hat(SO3, w)), w)
    np.testing.assert_array_equal(jit(lie.vee_se3)(hat(SE3, twist)), twist)


def test_se3_group_and_actions():
    a, b = expm(hat(SE3, TWISTS[70])), expm(hat(SE3, FAR_TWISTS[4]))
    assert np.abs(a - b).max() > 1.0
    points = np.array([[1.0, 2.0, 3.0], [-4.0, 0.5, 0.0]])
    homogeneous = np.concatenate([points, np.ones((2, 1))], axis=1)
    np.testing.assert_allclose(lie.compose_se3(jnp.asarray(a), jnp.asarray(b)), a @ b, atol=1e-14)
    np.testing.assert_allclose(lie.inverse_se3(jnp.asarray(a)), np.linalg.inv(a), atol=1e-14)
    world, body = (f(jnp.asarray(a), jnp.asarray(points)) for f in (lie.act_se3, lie.body_point_se3))
    np.testing.assert_allclose(world, (homogeneous @ a.T)[:, :3], atol=1e-14)
    np.testing.assert_allclose(body, (homogeneous @ np.linalg.inv(a).T)[:, :3], atol=1e-14)


def test_se2_group_and_actions():
    points = np.array([[1.0, 2.0], [-4.0, 0.5]])
    homogeneous = np.concatenate([points, np.ones((2, 1))], axis=1)
    for pose in POSES:
        a, matrix = jnp.asarray(pose), matrix_2d(pose)
        np.testing.assert_allclose(lie.matrix_se2(a), matrix, atol=1e-14)
        np.testing.assert_allclose(matrix_2d(np.asarray(lie.inverse_se2(a))), np.linalg.inv(matrix), atol=1e-14)
        np.testing.assert_allclose(lie.act_se2(a, jnp.asarray(points)), (homogeneous @ matrix.T)[:, :2], atol=1e-14)
        body = (homogeneous @ np.linalg.inv(matrix).T)[:, :2]
        np.testing.assert_allclose(lie.body_point_se2(a, jnp.asarray(points)), body, atol=1e-14)
        for other in POSES:
            composed = np.asarray(lie.compose_se2(a, jnp.asarray(other)))
            np.testing.assert_allclose(matrix_2d(composed), matrix @ matrix_2d(other), atol=1e-13)
            assert composed[2] == pose[2] + other[2]  # counts turns: 11 + 11 is not wrapped


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


@PRECISIONS
def test_body_point_derivatives(dtype, tolerance):
    """Against central differences of the homogeneous matrices."""
    point, step = np.array([2.0, -1.0]), 1e-6

    def body(pose):
        return (np.linalg.inv(matrix_2d(pose)) @ [*point, 1.0])[:2]

    for pose in POSES:
        expected = np.stack([(body(pose + d) - body(pose - d)) / (2 * step) for d in step * np.eye(3)], axis=-1)
        for jacobian in (jax.jacfwd, jax.jacrev):
            actual = jit(jacobian(lie.body_point_se2))(jnp.asarray(pose, dtype), jnp.asarray(point, dtype))
            np.testing.assert_allclose(actual, expected, atol=1e-8 + 10 * tolerance)


@pytest.mark.parametrize("turn", np.eye(3), ids="xyz")
def test_quaternions_of_every_branch(turn):
    """Near the identity and near half turns about x, y and z, where Shepperd's four rows take over."""
    rotations = Rotation.from_rotvec(np.outer([1e-9, 0.3, 1.6, 3.0, -3.1], turn)) * Rotation.from_rotvec(
        [0.1, -0.1, 0.05]
    )
    expected = rotations.as_quat(canonical=True, scalar_first=True)
    np.testing.assert_allclose(quaternion_so3(rotations.as_matrix()), expected, atol=1e-14)
    for length in (1.0, 0.01, -30.0):
        actual = rotation_quaternion(length * expected)
        np.testing.assert_allclose(actual, rotations.as_matrix(), atol=1e-14)


TRANSFORMS = jnp.asarray(expm(hat(SE3, TWISTS[40:43])))
POINTS = jnp.asarray(np.linspace(-1, 2, 15).reshape(5, 3))


@pytest.mark.parametrize(
    ("function", "left", "right"),
    [
        (lie.act_se3, TRANSFORMS, POINTS),
        (lie.body_point_se3, TRANSFORMS, POINTS),
        (lie.compose_se3, TRANSFORMS, TRANSFORMS),
        (lie.act_se2, jnp.asarray(POSES[:3]), POINTS[:, :2]),
        (lie.body_point_se2, jnp.asarray(POSES[:3]), POINTS[:, :2]),
        (lie.compose_se2, jnp.asarray(POSES[:3]), POINTS),
        (lie.move_se2, jnp.asarray(POSES[:3]), POINTS),
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
