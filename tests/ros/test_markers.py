"""Shapes of beliefs, against sampled Gaussians and SciPy's rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from foveate.ros.markers import belief_shapes, quaternion_of, truth_shapes, view_shapes
from foveate.ros.records import Estimate


@pytest.mark.parametrize("dimension", [2, 3])
def test_an_ellipse_holds_95_percent(dimension):
    rng = np.random.default_rng(dimension)
    root = rng.normal(size=(dimension, dimension))
    covariance, mean = np.eye(2 * dimension), np.arange(1.0, 2 * dimension + 1)
    covariance[:dimension, :dimension] = root @ root.T + 0.1 * np.eye(dimension)
    ellipse, text = belief_shapes([Estimate("anna", mean, covariance)], dimension)
    assert (ellipse.position[:dimension], text.text) == (tuple(mean[:dimension]), "anna")
    samples = rng.multivariate_normal(mean, covariance, 20_000)[:, :dimension] - mean[:dimension]
    points = np.zeros((len(samples), 3))
    points[:, :dimension] = samples
    own = Rotation.from_quat(ellipse.quaternion).inv().apply(points) / (0.5 * np.array(ellipse.size))
    assert (np.linalg.norm(own, axis=1) <= 1).mean() == pytest.approx(0.95, abs=0.006)


def test_quaternions_are_those_of_scipy():
    turns = [*Rotation.random(50, rng=np.random.default_rng(1))]
    turns += [Rotation.from_rotvec(np.pi * axis) for axis in np.eye(3)] + [Rotation.identity()]
    for turn in turns:
        back = Rotation.from_quat(quaternion_of(turn.as_matrix()))
        np.testing.assert_allclose(back.as_matrix(), turn.as_matrix(), atol=1e-12)


def test_lines_and_balls_are_where_they_belong():
    (line,) = view_shapes([np.array([[0.0, 0.0], [1.0, 2.0]])])
    assert line.points == ((0.0, 0.0, 0.0), (1.0, 2.0, 0.0))
    assert [shape.position for shape in truth_shapes(np.array([[1.0, 2.0, 3.0]]))] == [(1.0, 2.0, 3.0)]
