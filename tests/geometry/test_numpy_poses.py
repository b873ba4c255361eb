"""Pose algebra in numpy against that in JAX (`geometry.space`), and the arc between poses against scipy's expm."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from foveate.geometry import numpy_poses
from foveate.geometry.space import SPACES


def random_poses(dimension, count, rng):
    position = rng.normal(0, 3, (count, dimension))
    if dimension == 2:
        return np.column_stack([position, rng.uniform(-10, 10, count)])
    pose = np.tile(np.eye(4), (count, 1, 1))
    pose[:, :3, :3] = Rotation.random(count, random_state=1).as_matrix()
    pose[:, :3, 3] = position
    return pose


@pytest.mark.parametrize("name", SPACES)
def test_poses_equal_those_of_the_space(name):
    space, rng = SPACES[name], np.random.default_rng(0)
    poses, points = random_poses(space.dimension, 20, rng), rng.normal(size=(20, 5, space.dimension))
    position, rotation = jax.vmap(space.position)(jnp.asarray(poses)), jax.vmap(space.rotation)(jnp.asarray(poses))
    world = jax.vmap(space.to_world)(jnp.asarray(poses), jnp.asarray(points))
    np.testing.assert_allclose(numpy_poses.positions(poses), position, rtol=0, atol=1e-13)
    for pose, R, body, expected in zip(poses, rotation, points, world, strict=True):
        np.testing.assert_allclose(numpy_poses.rotation(pose), R, rtol=0, atol=1e-13)
        np.testing.assert_allclose(numpy_poses.placed(pose, body), expected, rtol=0, atol=1e-13)


def test_rotations_of_quaternions_of_any_length():
    rotations = Rotation.random(20, random_state=3)
    for quaternion, expected in zip(rotations.as_quat(scalar_first=True), rotations.as_matrix(), strict=True):
        for length in (1.0, 0.01, -30.0):
            np.testing.assert_allclose(numpy_poses.rotation_quaternion(length * quaternion), expected, atol=1e-14)


@pytest.mark.parametrize("name", SPACES)
def test_arc_follows_the_constant_twist(name):
    """T exp(s log(T^-1 T')) at every part of a step."""
    space, parts = SPACES[name], 7
    poses = random_poses(space.dimension, 6, np.random.default_rng(1))
    arc = numpy_poses.arc(poses, parts)
    np.testing.assert_allclose(arc[::parts], poses, atol=1e-12)
    for i, (start, end) in enumerate(pairwise(poses)):
        first, last = (matrix(pose) for pose in (start, end))
        # scipy's logm takes the least turn; in the plane the yaw counts whole turns beside it.
        twist = planar_twist(start, end) if space.dimension == 2 else logm(np.linalg.solve(first, last)).real
        for k in range(parts):
            expected = first @ expm(k / parts * twist)
            np.testing.assert_allclose(matrix(arc[i * parts + k]), expected, atol=1e-9)


def matrix(pose):
    """The homogeneous matrix of a pose."""
    if pose.shape == (4, 4):
        return pose
    homogeneous = np.eye(3)
    homogeneous[:2, :2], homogeneous[:2, 2] = Rotation.from_euler("z", pose[2]).as_matrix()[:2, :2], pose[:2]
    return homogeneous


def planar_twist(start, end):
    """hat(u) with T exp(hat(u)) = T' and w = yaw' - yaw: v solves (int_0^1 R(s w) ds) v = R^T (x' - x)."""
    w = end[2] - start[2]
    nodes, weights = np.polynomial.legendre.leggauss(40)
    angle = w * (nodes + 1) / 2
    cos, sin = weights @ np.cos(angle) / 2, weights @ np.sin(angle) / 2
    ahead = Rotation.from_euler("z", -start[2]).as_matrix()[:2, :2] @ (end[:2] - start[:2])
    twist = np.array([[0, -w, 0], [w, 0, 0], [0, 0, 0.0]])
    twist[:2, 2] = np.linalg.solve([[cos, -sin], [sin, cos]], ahead)
    return twist


def test_arc_of_single_precision_stays_a_rotation():
    poses = random_poses(3, 4, np.random.default_rng(2)).astype(np.float32).astype(float)
    turn = numpy_poses.arc(poses, 7)[:, :3, :3]
    np.testing.assert_allclose(turn @ turn.swapaxes(-1, -2), np.broadcast_to(np.eye(3), turn.shape), atol=1e-6)
