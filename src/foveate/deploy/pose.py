"""Poses as robots give them: numbers with a quaternion in either order, or a matrix."""

from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from foveate.errors import InputError
from foveate.geometry.numpy_poses import rotation_quaternion
from foveate.scenario.rows import MAX_LENGTH

QuaternionOrder = Literal["wxyz", "xyzw"]
"""Order of a quaternion: w first, as foveate's files have it, or last, as ROS, SciPy and Eigen have it."""
LEVEL = 1e-3
"""Largest tilt [-, of a rotation matrix's entries] of a pose of seven numbers that is one in the plane."""


def checked_pose(pose: ArrayLike, dimension: int, quaternion: QuaternionOrder = "wxyz") -> Float[np.ndarray, "..."]:
    """The pose as [x, y, yaw] in the plane, or as a 4 x 4 matrix, body to world, in space [m, rad].

    Taken are [x, y, yaw] in the plane; in space 4 x 4; and in both seven numbers: x, y, z and a quaternion, [qw, qx,
    qy, qz], or with `quaternion="xyzw"` [qx, qy, qz, qw], the order of ROS. Nothing can tell the two apart: the wrong
    one is another pose. In the plane z is ignored, and the body must be level. Raises InputError for others.
    """
    if quaternion not in ("wxyz", "xyzw"):
        raise InputError(f"quaternion = {quaternion!r}: expected 'wxyz', or 'xyzw' as ROS has it")
    last = "qx, qy, qz, qw" if quaternion == "xyzw" else "qw, qx, qy, qz"
    expected = f"expected {'[x, y, yaw]' if dimension == 2 else 'a 4 x 4 matrix'} or [x, y, z, {last}] in m and rad"
    try:
        array = np.array(pose, float)
    except (ValueError, TypeError) as error:
        raise InputError(f"pose = {str(pose)[:80]}: {expected}") from error
    shapes = ((3,), (7,)) if dimension == 2 else ((4, 4), (7,))
    if array.shape not in shapes or not (np.abs(array) <= MAX_LENGTH).all():
        raise InputError(f"pose = {array.tolist()}: {expected}, finite, up to {MAX_LENGTH:g}")
    if array.shape == (7,):
        array = _matrix(array if quaternion == "wxyz" else array[[0, 1, 2, 6, 3, 4, 5]], expected)
        return _in_plane(array) if dimension == 2 else array
    if dimension == 3:
        R = array[:3, :3]
        proper = np.abs(R @ R.T - np.eye(3)).max() < 1e-3 and np.linalg.det(R) > 0
        if not proper or np.any(array[3] != [0, 0, 0, 1]):
            raise InputError(
                f"pose = {array.tolist()}: expected a homogeneous matrix: a rotation, a position, [0, 0, 0, 1]"
            )
    return array


def _matrix(numbers: Float[np.ndarray, "7"], expected: str) -> Float[np.ndarray, "4 4"]:
    """4 x 4 of x, y, z, qw, qx, qy, qz; the quaternion may have any length but zero."""
    largest = np.abs(numbers[3:]).max()
    if largest == 0:
        raise InputError(f"pose = {numbers.tolist()}: {expected}: the quaternion is zero")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_quaternion(numbers[3:] / largest), numbers[:3]
    return T


def _in_plane(T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3"]:
    if np.abs(T[2, :3] - [0, 0, 1]).max() > LEVEL:
        right = "expected a level body in the plane; ROS has its quaternion as x, y, z, w: quaternion='xyzw'"
        raise InputError(f"pose: tilted, its z axis points to {T[:3, 2].round(3).tolist()}: {right}")
    return np.array([*T[:2, 3], np.arctan2(T[1, 0], T[0, 0])])
