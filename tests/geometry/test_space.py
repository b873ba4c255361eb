"""Both spaces against homogeneous matrices built with scipy, and the poses of files."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from foveate.geometry.lie_planar import wrapped_se2
from foveate.geometry.numpy_poses import arc
from foveate.geometry.space import SPACES, Planar, Spatial

NUMBERS = {"planar": [1.0, -2.0, 2.5], "spatial": [1.0, -2.0, 0.5, -0.4, 0.8, 0.2, -0.4]}
BOTH = pytest.mark.parametrize("space", SPACES.values(), ids=SPACES)


def matrix(name, numbers):
    """The homogeneous transform of a file's numbers, 3 x 3 or 4 x 4."""
    d = {"planar": 2, "spatial": 3}[name]
    turn = Rotation.from_euler("z", numbers[2]) if d == 2 else Rotation.from_quat(numbers[3:], scalar_first=True)
    result = np.eye(d + 1)
    result[:d, :d] = turn.as_matrix()[:d, :d]
    result[:d, d] = numbers[:d]
    return result


def hat(twist):
    """The homogeneous matrix of a twist, 3 x 3 or 4 x 4."""
    if len(twist) == 3:
        v_x, v_y, w = twist
        return np.array([[0, -w, v_x], [w, 0, v_y], [0, 0, 0]])
    v_x, v_y, v_z, w_x, w_y, w_z = twist
    return np.array([[0, -w_z, w_y, v_x], [w_z, 0, -w_x, v_y], [-w_y, w_x, 0, v_z], [0, 0, 0, 0]])


def as_matrix(space, pose):
    return matrix(space.name, [float(x) for x in pose]) if space.name == "planar" else np.asarray(pose)


def test_sizes():
    for name, d, n_u, axes in [("planar", 2, 3, "vx vy wz"), ("spatial", 3, 6, "vx vy vz wx wy wz")]:
        space = SPACES[name]
        assert (space.name, space.dimension, space.twist_size) == (name, d, n_u)
        assert space.axes == tuple(axes.split())
        pose = space.identity()
        assert jax.eval_shape(space.position, pose).shape == (d,)
        assert jax.eval_shape(space.rotation, pose).shape == (d, d)
        assert jax.eval_shape(space.log, pose).shape == (n_u,)
        np.testing.assert_array_equal(as_matrix(space, pose), np.eye(d + 1))


@BOTH
def test_from_numbers_and_the_parts_of_a_pose(space):
    d, expected = space.dimension, matrix(space.name, NUMBERS[space.name])
    pose = space.from_numbers(NUMBERS[space.name])
    np.testing.assert_allclose(as_matrix(space, pose), expected, atol=1e-15)
    np.testing.assert_allclose(space.rotation(pose), expected[:d, :d], atol=1e-15)
    np.testing.assert_allclose(space.position(pose), expected[:d, d], atol=1e-15)


@BOTH
def test_upright_turns_about_the_vertical(space):
    expected = np.eye(space.dimension + 1)
    expected[:2, :2] = Rotation.from_euler("z", 0.7).as_matrix()[:2, :2]
    expected[:-1, -1] = [3.0, -4.0, 5.0][: space.dimension]
    pose = jax.jit(space.upright)(jnp.asarray(expected[:-1, -1]), jnp.asarray(0.7))
    np.testing.assert_allclose(as_matrix(space, pose), expected, atol=1e-15)


@BOTH
def test_move_is_the_exponential_in_the_body_frame(space):
    pose, before = space.from_numbers(NUMBERS[space.name]), matrix(space.name, NUMBERS[space.name])
    displacement = np.array([0.7, -0.3, 1.1, 0.2, -0.5, 0.9])[: space.twist_size]
    expected = before @ expm(hat(displacement))
    moved = jax.jit(space.move)(pose, jnp.asarray(displacement))
    np.testing.assert_allclose(as_matrix(space, moved), expected, atol=1e-14)
    still = jax.jit(space.move)(pose, jnp.zeros(space.twist_size))
    np.testing.assert_allclose(still, pose, atol=1e-15)


def test_planar_yaw_counts_turns():
    assert float(Planar().move(jnp.array([0.0, 0.0, 6.0]), jnp.array([0.0, 0.0, 3.0]))[2]) == 9.0


@BOTH
def test_ten_thousand_turns_in_float32_keep_the_heading(space):
    """Against float64: the yaw keeps its digits, and R stays a rotation."""
    twist = np.array([0.3, 0.0, 0.5003]) if space.dimension == 2 else np.array([0.3, 0.0, 0.1, 0.4, -0.3, 2.0])

    def after(dtype):
        def move(pose, _):
            return space.move(pose, jnp.asarray(twist, dtype)), None

        return jax.jit(lambda start: jax.lax.scan(move, start, length=10_000)[0])(space.identity().astype(dtype))

    R, exact = (np.asarray(space.rotation(after(dtype)), float) for dtype in (jnp.float32, jnp.float64))
    turned = Rotation.from_rotvec([0, 0, 5003.0]).as_matrix()[:2, :2]
    if space.dimension == 3:
        turned = Rotation.from_rotvec(10_000 * twist[3:]).as_matrix()
    np.testing.assert_allclose(exact, turned, atol=1e-9)
    np.testing.assert_allclose(R @ R.T, np.eye(len(R)), atol=1e-4)
    np.testing.assert_allclose(R, turned, atol=3e-3)


def test_a_yaw_within_two_turns_stays_to_the_last_bit():
    yaw = np.random.default_rng(0).uniform(-12.5, 12.5, 1000).astype(np.float32)
    poses = jnp.asarray(np.stack([0 * yaw, 0 * yaw, yaw], axis=-1))
    np.testing.assert_array_equal(wrapped_se2(poses)[:, 2], yaw)
    far = wrapped_se2(jnp.array([1.0, 2.0, 100.0]))
    np.testing.assert_allclose(far, [1.0, 2.0, 100.0 - 32 * np.pi], atol=1e-12)
    path = arc(np.array([[0.0, 0.0, 12.5], [0.1, 0.0, 12.7 - 8 * np.pi]]), 4)
    np.testing.assert_allclose(path[:-1, 2], 12.5 + 0.05 * np.arange(4))


@BOTH
def test_points_between_the_frames(space):
    d = space.dimension
    pose, transform = space.from_numbers(NUMBERS[space.name]), matrix(space.name, NUMBERS[space.name])
    points = np.arange(4 * d, dtype=float).reshape(4, d) - 5.0
    homogeneous = np.concatenate([points, np.ones((4, 1))], axis=1)
    body, world = space.to_body(pose, jnp.asarray(points)), space.to_world(pose, jnp.asarray(points))
    np.testing.assert_allclose(body, np.linalg.solve(transform, homogeneous.T).T[:, :d], atol=1e-13)
    np.testing.assert_allclose(world, (homogeneous @ transform.T)[:, :d], atol=1e-13)
    np.testing.assert_allclose(space.to_body(pose, jnp.asarray(points[1])), body[1], atol=1e-15)
    assert space.to_body(pose, jnp.zeros((0, d))).shape == (0, d)
    assert space.to_world(pose, jnp.zeros((5, 0, d))).shape == (5, 0, d)


@pytest.mark.parametrize("method", ["to_body", "to_world"])
def test_planar_points_share_one_sine(method):
    jaxpr = jax.make_jaxpr(getattr(Planar(), method))(jnp.zeros(3), jnp.zeros((50, 2)))
    sines = [e.outvars[0].aval.size for e in jaxpr.eqns if e.primitive.name in ("sin", "cos")]
    assert sines == [1, 1]


@BOTH
def test_log(space):
    pose = space.from_numbers(NUMBERS[space.name])
    expected = logm(matrix(space.name, NUMBERS[space.name]))
    np.testing.assert_allclose(hat(np.asarray(jax.jit(space.log)(pose))), expected, atol=1e-12)


@BOTH
def test_methods_map_over_poses_in_float32(space):
    pose = space.from_numbers(NUMBERS[space.name]).astype(jnp.float32)
    displacement = jnp.full(space.twist_size, 0.25, jnp.float32)
    moved = jax.jit(jax.vmap(space.move, (None, 0)))(pose, jnp.stack([displacement, -displacement]))
    assert moved.dtype == jnp.float32
    logs = jax.jit(jax.vmap(space.log))(moved)
    for sign, each, log in zip((1, -1), moved, logs, strict=True):
        expected = matrix(space.name, NUMBERS[space.name]) @ expm(sign * hat(np.full(space.twist_size, 0.25)))
        np.testing.assert_allclose(as_matrix(space, each.astype(jnp.float64)), expected, atol=1e-6)
        np.testing.assert_allclose(hat(np.asarray(log)), logm(expected), atol=1e-5)


def test_spaces_stand_in_static_and_in_traced_places():
    assert hash(Planar()) == hash(Planar())
    assert Planar() == Planar() != Spatial()
    assert jax.tree.leaves(Spatial()) == []

    def turned(space, pose):
        return space.rotation(pose)

    pose = jnp.array([0.0, 0.0, np.pi / 2])
    for jitted in (jax.jit(turned), jax.jit(turned, static_argnums=0)):
        np.testing.assert_allclose(jitted(Planar(), pose), [[0, -1], [1, 0]], atol=1e-15)


# --- numbers of files -----------------------------------------------------------------------------


def test_planar_numbers_keep_the_yaw():
    assert Planar().to_numbers(Planar().from_numbers([1, 2.5, -11])) == [1.0, 2.5, -11.0]


@settings(max_examples=40, deadline=None)
@given(arrays(np.float64, 7, elements=st.floats(-10, 10)), st.sampled_from([1e-200, 1e-3, 1.0, 1e200]))
def test_spatial_numbers_there_and_back(numbers, length):
    if np.linalg.norm(numbers[3:]) < 1e-3:
        numbers[3] = 1.0
    pose = Spatial().from_numbers(np.concatenate([numbers[:3], length * numbers[3:]]))
    np.testing.assert_allclose(pose, matrix("spatial", numbers), atol=1e-14)
    back = Spatial().to_numbers(pose)
    expected = Rotation.from_quat(numbers[3:], scalar_first=True).as_quat(scalar_first=True)
    assert back[:3] == numbers[:3].tolist()
    assert back[3] >= 0
    np.testing.assert_allclose(abs(np.dot(back[3:], expected)), 1.0, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(back[3:]), 1.0, atol=1e-15)


@pytest.mark.parametrize(
    ("name", "numbers", "problem"),
    [
        ("planar", [1.0, 2.0], r"expected 3 finite numbers \[x, y, yaw\], got \[1.0, 2.0\]"),
        ("planar", [[1.0, 2.0, 3.0]], "expected 3 finite numbers"),
        ("planar", [1.0, float("nan"), 3.0], "got y = nan"),
        ("planar", ["1", "2", "3"], "expected 3 finite numbers"),
        ("planar", [1.0, 2.0, None], "expected 3 finite numbers"),
        ("planar", [[1.0], [2.0, 3.0]], "expected 3 finite numbers"),
        ("spatial", [1.0, 2.0, 3.0], r"expected 7 finite numbers \[x, y, z, qw, qx, qy, qz\], got"),
        ("spatial", [0.0, 0.0, 0.0, float("inf"), 0.0, 0.0, 0.0], "got qw = inf"),
        ("spatial", [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0], "quaternion .* must not be zero"),
    ],
)
def test_wrong_numbers_are_named(name, numbers, problem):
    with pytest.raises(ValueError, match=f"^{name} pose: .*{problem}"):
        SPACES[name].from_numbers(numbers)


def test_a_number_beyond_float32_is_rejected_where_float32_is_the_default():
    with jax.enable_x64(False):
        pose = Planar().from_numbers([1.0, 2.0, 3.0])
        assert pose.dtype == jnp.float32
        with pytest.raises(ValueError, match=r"got x = 1e\+39"):
            Planar().from_numbers([1e39, 0.0, 0.0])
