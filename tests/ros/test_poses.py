"""Poses between two times, against SciPy's Slerp."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from foveate.ros.poses import PoseHistory, between, heading, matrix_of


def test_poses_between_two_times():
    rng = np.random.default_rng(0)
    for _ in range(20):
        turns = Rotation.random(2, rng=rng)
        a, b = ((tuple(rng.normal(size=3)), tuple(q)) for q in turns.as_quat())
        b = (b[0], tuple(-np.array(b[1])))  # the same rotation
        for share in (0.0, 0.3, 1.0):
            position, quaternion = between(a, b, share)
            expected = Slerp([0, 1], turns)(share)
            np.testing.assert_allclose(position, np.array(a[0]) + share * (np.array(b[0]) - a[0]), atol=1e-12)
            np.testing.assert_allclose(Rotation.from_quat(quaternion).as_matrix(), expected.as_matrix(), atol=1e-9)
    still = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.6, 0.8))
    np.testing.assert_allclose(between(still, still, 0.4)[1], still[1], atol=1e-15)


def test_a_matrix_is_that_of_the_quaternion():
    turn = Rotation.from_euler("ZYX", (0.5, 0.2, -0.3))
    T = matrix_of((1.0, 2.0, 3.0), tuple(1e-3 * turn.as_quat()))
    np.testing.assert_allclose(T[:3, :3], turn.as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(T[:, 3], [1, 2, 3, 1])
    np.testing.assert_allclose(heading(T)[2], 0.5, atol=1e-12)
    assert matrix_of((1.0, 2.0, np.inf), (0.0, 0.0, 0.0, 1.0)) is None
    assert matrix_of((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 0.0)) is None


def test_a_history_ends_where_it_knows_nothing():
    upright = (0.0, 0.0, 0.0, 1.0)
    history = PoseHistory(keep_s=1.0)
    assert (history.latest_s, history.at(0.0, 1.0)) == (None, None)
    for k in range(30):
        history.add(0.1 * k, (1.0 * k, 0.0, 0.0), upright)
    history.add(2.85, (-99.0, 0.0, 0.0), upright)  # out of order
    assert history.latest_s == pytest.approx(2.9)
    assert history.at(2.55, 0.1)[0, 3] == pytest.approx(25.5)
    assert history.at(2.95, 0.1)[0, 3] == 29.0
    assert history.at(3.05, 0.1) is None
    assert history.at(1.5, 0.1) is None  # forgotten
