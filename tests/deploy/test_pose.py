"""Forms of a pose, with SciPy's rotations, whose quaternions are in the order of ROS."""

import numpy as np
import pytest
from helpers.untyped import unchecked
from scipy.spatial.transform import Rotation

from foveate.deploy.pose import checked_pose
from foveate.errors import InputError


def test_either_order_of_a_quaternion_and_a_matrix_are_one_pose():
    turn = Rotation.from_euler("ZYX", [0.7, -0.4, 0.2])
    x, y, z, w = 3.0 * turn.as_quat()  # of any length
    for numbers, order in (([1, 2, 3, w, x, y, z], "wxyz"), ([1, 2, 3, x, y, z, w], "xyzw")):
        T = checked_pose(numbers, 3, order)
        np.testing.assert_allclose(T[:3, :3], turn.as_matrix(), atol=1e-12)
        np.testing.assert_array_equal(T[:3, 3], [1, 2, 3])
        np.testing.assert_array_equal(checked_pose(T, 3), T)


def test_a_level_body_is_a_pose_in_the_plane():
    x, y, z, w = Rotation.from_euler("z", -2.0).as_quat()
    for numbers, order in (([1, 2, 9, w, x, y, z], "wxyz"), ([1, 2, 9, x, y, z, w], "xyzw")):
        np.testing.assert_allclose(checked_pose(numbers, 2, order), [1, 2, -2.0], atol=1e-12)
    # Heading 90 degrees to the left of x, in the wrong order: upside down.
    with pytest.raises(InputError, match="quaternion='xyzw'"):
        checked_pose([0, 0, 0, 0, 0, np.sqrt(0.5), np.sqrt(0.5)], 2)


@pytest.mark.parametrize(
    ("pose", "dimension"),
    [
        ([0, 0], 2),
        (np.eye(4), 2),
        ([0, 0, 0], 3),
        ([0, 0, np.nan], 2),
        ("here", 2),
        (None, 3),
        ([[0, 1], [2]], 2),
        ([0, 0, 0, 0, 0, 0, 0], 3),
        (np.diag([1.0, 1.0, -1.0, 1.0]), 3),
        (np.ones((4, 4)), 3),
        ([1e10, 0, 0], 2),
    ],
)
def test_others_are_refused_in_one_line(pose, dimension):
    with unchecked(), pytest.raises(InputError, match=r"^pose = .*: expected") as caught:
        checked_pose(pose, dimension)
    assert "\n" not in str(caught.value)
    with unchecked(), pytest.raises(InputError, match="quaternion = 'zyxw'"):
        checked_pose([0, 0, 0], 2, "zyxw")
