"""95 % regions and faces: chi-square quantiles by scipy, samples, and points of the outline as oracles."""

import numpy as np
import pytest
from matplotlib.path import Path as Outline
from scipy.stats import chi2

from foveate.geometry.fov_planar import triangle
from foveate.geometry.fov_spatial import cone, frustum, prism
from foveate.plotting import ellipsoids


def beliefs(n, d, seed=0):
    """Means and covariances of n beliefs."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, d, d))
    return rng.uniform(-6, 6, (n, d)), root @ root.swapaxes(-1, -2) + 0.1 * np.eye(d)


def squared_distances(points, mean, covariance):
    """Squared Mahalanobis distances of points."""
    away = points - mean
    return np.sum(away * np.linalg.solve(covariance, away.T).T, axis=1)


@pytest.mark.parametrize("d", [1, 2, 3, 6])
def test_quantile_agrees_with_scipy(d):
    assert ellipsoids.chi_square_95(d) == pytest.approx(chi2.ppf(0.95, d), rel=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_regions_hold_95_percent_of_samples(d):
    mean, covariance = beliefs(3, d, seed=1)
    for m, P, L, half in zip(
        mean, covariance, ellipsoids.semi_axes(covariance), ellipsoids.half_widths(covariance), strict=True
    ):
        samples = np.random.default_rng(0).multivariate_normal(m, P, 40_000)
        inside = (np.linalg.solve(L, (samples - m).T) ** 2).sum(axis=0) <= 1.0
        assert abs(inside.mean() - 0.95) < 0.005  # sampling error 0.0011
        # The box around the region touches it on every side.
        np.testing.assert_allclose(np.linalg.norm(L, axis=1), half, rtol=1e-12)
        assert (np.abs(samples[inside] - m) <= half).all()


@pytest.mark.parametrize("d", [2, 3])
def test_semi_axes_are_orthogonal_eigenvectors(d):
    _, covariance = beliefs(4, d, seed=2)
    directions, lengths = ellipsoids.principal_axes(covariance)
    np.testing.assert_allclose(directions @ directions.swapaxes(-1, -2), np.broadcast_to(np.eye(d), covariance.shape),
                               atol=1e-12)  # fmt: skip
    # The singular values of a covariance are its eigenvalues, found by another algorithm.
    values = np.linalg.svd(covariance, compute_uv=False)[:, ::-1]
    np.testing.assert_allclose(lengths, np.sqrt(chi2.ppf(0.95, d) * values), rtol=1e-9)


def test_a_covariance_that_rounding_made_indefinite_has_a_region():
    lengths = ellipsoids.principal_axes(np.diag([1.0, -1e-18]))[1]
    assert (lengths > 0).all()
    assert lengths.min() < 1e-5


def test_an_ellipse_is_the_chi_square_contour_and_holds_95_percent():
    mean, covariance = beliefs(1, 2, seed=3)
    (border,) = ellipsoids.ellipses(mean, covariance)
    np.testing.assert_allclose(squared_distances(border, mean[0], covariance[0]), chi2.ppf(0.95, 2), rtol=1e-9)
    values, vectors = np.linalg.eigh(covariance[0])
    for value, vector in zip(values, vectors.T, strict=True):
        tip = mean[0] + np.sqrt(chi2.ppf(0.95, 2) * value) * vector
        assert np.linalg.norm(border - tip, axis=1).min() < 1e-12
    samples = np.random.default_rng(0).multivariate_normal(mean[0], covariance[0], 40_000)
    # A polygon of 48 corners in the ellipse has 0.3 % less area: 0.0004 of probability; sampling error 0.0011.
    assert abs(Outline(border).contains_points(samples).mean() - 0.95) < 0.005


def test_ellipsoids_are_chi_square_contours():
    mean, covariance = beliefs(3, 3, seed=4)
    eye = np.array([20.0, -30.0, 25.0])
    rims, arcs = ellipsoids.contours(mean, covariance, eye), ellipsoids.meridians(mean, covariance, eye)
    assert rims.shape[0] == 3
    assert arcs.shape[0] == 9
    for j in range(3):
        for points in (rims[j], *arcs[j::3]):
            np.testing.assert_allclose(squared_distances(points, mean[j], covariance[j]), chi2.ppf(0.95, 3), rtol=1e-9)


def test_a_contour_is_seen_edge_on_and_meridians_face_the_eye():
    mean, covariance = beliefs(2, 3, seed=5)
    eye = np.array([12.0, -15.0, 9.0])
    for j in range(2):
        rim = ellipsoids.contours(mean, covariance, eye)[j]
        normal = np.linalg.solve(covariance[j], (rim - mean[j]).T).T
        np.testing.assert_allclose(np.sum(normal * (eye - rim), axis=1), 0.0, atol=1e-8)
        for arc in ellipsoids.meridians(mean, covariance, eye)[j::2]:
            normal = np.linalg.solve(covariance[j], (arc - mean[j]).T).T
            assert np.sum(normal * (eye - mean[j]), axis=1).min() > -1e-8


def test_an_eye_within_an_ellipsoid_sees_no_border():
    rim = ellipsoids.contours(np.zeros((1, 3)), np.eye(3)[None], np.array([0.1, 0.0, 0.2]))
    assert np.isfinite(rim).all()
    assert np.ptp(rim, axis=1).max() < 1e-6


@pytest.mark.parametrize(
    ("outline", "count"),
    [
        (frustum(0.3, 6.0, 1.4, 1.0).outline(), 2 + 4),
        (frustum(0.0, 6.0, 1.4, 1.0).outline(), 2 + 4),
        (cone(0.0, 5.0, 1.2).outline(), 3),
        (cone(1.0, 5.0, 1.2).outline(), 4),
        (prism(triangle(2.0, 2.0)).outline(4.0), 2 + 3),
        ([np.eye(3)[:2]], 0),
        ([], 0),
    ],
)
def test_faces_span_closed_lines_and_joined_edges(outline, count):
    made = ellipsoids.faces(outline)
    assert len(made) == count
    points = np.concatenate([np.zeros((0, 3)), *outline])
    for face in made:
        # Every corner of a face is one of the outline's.
        assert np.abs(face[:, None] - points).sum(axis=-1).min(axis=1).max() < 1e-9


def test_edges_of_a_box_pass_each_corner_three_times():
    box = np.array([[0.0, 1, 2], [3, 5, 9]])
    lines = ellipsoids.box_lines(box)
    length = sum(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in lines)
    assert length == pytest.approx(4 * (3 + 4 + 7))
    (rectangle,) = ellipsoids.box_lines(box[:, :2])
    np.testing.assert_array_equal(np.abs(np.diff(rectangle, axis=0)).sum(axis=0), [6.0, 8.0])
