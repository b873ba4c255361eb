"""The update by own coordinates against exact posteriors on a grid, Stone Soup, filterpy, and its own claims (NEES)."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2

from foveate.geometry.linalg import inverse_spd
from foveate.models.polar import Polar, coordinates_of, position
from foveate.models.polar_filter import NODES, Reach, one_point, squared_distance, update

RANGE_BEARING = Polar(("range", "bearing"), (0.0, 0.0))
BEARING, RANGE = Polar(("bearing",), (0.0,)), Polar(("range",), (0.0,))
SPATIAL = Polar(("bearing", "elevation", "range"), (0.0, 0.0, 0.0))
V = {RANGE_BEARING: np.diag([0.2, 0.01]) ** 2, BEARING: np.diag([0.02]) ** 2, RANGE: np.diag([0.2]) ** 2,
     SPATIAL: np.diag([0.02, 0.02, 0.2]) ** 2}  # fmt: skip


def corrected(polar, mean, covariance, z, frame):
    """Mean and covariance after the update, of many targets; as before where it is not taken."""
    after = update(np, np.linalg.inv, polar, mean, covariance, z, V[polar], frame)
    information = np.linalg.inv(covariance) + after.H.swapaxes(-1, -2) @ np.linalg.inv(after.V) @ after.H
    taken = after.is_taken
    moved = np.where(taken[:, None], after.mean, mean)
    return moved, np.where(taken[:, None, None], np.linalg.inv(information), covariance), taken


def simulate(polar, std_m, distance, steps, walk, runs=600, seed=0):
    """Static targets with first beliefs that err as they claim: NEES after every step, errors, shares taken."""
    rng, d = np.random.default_rng(seed), 3 if polar is SPATIAL else 2
    direction = rng.normal(size=(runs, d))
    truth = direction / np.linalg.norm(direction, axis=1)[:, None] * rng.uniform(*distance, (runs, 1))
    mean = truth + std_m * rng.normal(size=truth.shape)
    covariance = np.broadcast_to(std_m**2 * np.eye(d), (runs, d, d))
    nees, shares, root = [], [], np.sqrt(np.diagonal(V[polar]))
    for k in range(steps):
        t = walk * k * np.eye(d)[0]
        z = coordinates_of(np, polar, truth - t) + root * rng.normal(size=(runs, len(root)))
        mean, covariance, taken = corrected(polar, mean, covariance, z, (np.eye(d), t, np.eye(d)))
        error = mean - truth
        nees.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error))
        shares.append(taken.mean())
    return np.array(nees), np.linalg.norm(mean - truth, axis=1), np.array(shares)


@pytest.mark.parametrize(
    ("polar", "std_m", "distance", "walk"),
    [(RANGE_BEARING, 5.5, (2.0, 10.0), 0.0), (RANGE_BEARING, 1.0, (2.0, 8.0), 0.5), (SPATIAL, 3.0, (3.0, 10.0), 0.5)],
)
def test_what_it_claims_of_full_measurements_is_true_from_the_first_look_on(polar, std_m, distance, walk):
    """600 runs: mean NEES within 99.9 % of its distribution at the first look, and close to it after ten."""
    nees, error, taken = simulate(polar, std_m, distance, 10, walk)
    d, runs = (3 if polar is SPATIAL else 2), nees.shape[1]
    low, high = chi2.ppf([0.0005, 0.9995], d * runs) / runs
    assert 0.85 * low < nees[0].mean() < 1.1 * high
    assert 0.85 * low < nees[-1].mean() < 1.15 * high
    assert taken.min() > 0.99
    assert np.median(error) < 0.3


def test_what_it_claims_of_bearings_is_true_of_a_sensor_that_moves_across():
    """600 runs of 2 m at 4 to 8 m; the extended filter's NEES is 58 here, with one run in six beyond 99.9 %."""
    nees, error, taken = simulate(BEARING, 2.0, (4.0, 8.0), 20, 0.5)
    assert 1.5 < nees[-1].mean() < 3.5
    assert np.mean(nees[-1] > chi2.ppf(0.999, 2)) < 0.015
    assert np.median(error) < 0.3
    assert taken.mean() > 0.7


def test_bearings_of_a_belief_around_the_sensor_are_refused_and_leave_it_as_it_was():
    """3 m at 2 m: no ellipse stands for a ray; the linear filter would claim a sliver and be wrong by 20 sigma."""
    mean, covariance = np.array([[2.0, 0.0]]), 9.0 * np.eye(2)[None]
    after = update(np, np.linalg.inv, BEARING, mean, covariance, np.array([[2.5]]), V[BEARING],
                   (np.eye(2), np.zeros(2), np.eye(2)))  # fmt: skip
    assert not after.is_taken[0]
    far = update(np, np.linalg.inv, BEARING, 5 * mean, covariance, np.array([[0.3]]), V[BEARING],
                 (np.eye(2), np.zeros(2), np.eye(2)))  # fmt: skip
    assert far.is_taken[0]
    nees, _, taken = simulate(BEARING, 5.5, (2.0, 10.0), 15, 0.5)
    assert taken[0] < 0.6
    assert np.median(nees[-1]) < 1.3 * chi2.median(2)
    assert np.mean(nees[-1] > chi2.ppf(0.999, 2)) < 0.015


def test_bearings_from_one_place_make_up_nothing_about_the_range():
    """30 looks of a sensor at rest: it stays as unsure of the range as it was (the extended filter: NEES 82)."""
    nees, error, _ = simulate(BEARING, 2.0, (4.0, 8.0), 30, 0.0)
    assert nees[-1].mean() < 3.5
    assert np.mean(nees[-1] > chi2.ppf(0.999, 2)) < 0.03
    assert np.sqrt(np.mean(error**2)) > 1.5


def test_what_it_claims_of_ranges_is_true_but_for_mirror_images():
    nees, error, _ = simulate(RANGE, 1.0, (4.0, 8.0), 20, 0.5)
    assert np.median(nees[-1]) < 2.2
    assert np.mean(nees[-1] > chi2.ppf(0.999, 2)) < 0.06
    assert np.median(error) < 0.3


@pytest.mark.parametrize("polar", [RANGE_BEARING, BEARING, RANGE])
def test_mean_and_covariance_are_those_of_the_posterior_on_a_grid(polar):
    """Bayes' rule summed over a grid of positions: a belief of 1 m at 6 m, measured 1.5 sigma aside."""
    mean, covariance, truth = np.array([6.0, 1.0]), np.diag([1.0, 0.6]) + 0.2, np.array([6.8, 2.1])
    z, inverse = coordinates_of(np, polar, truth), np.linalg.inv(covariance)
    axis = np.linspace(-5.0, 5.0, 1201)
    grid = mean + np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
    apart, missed = grid - mean, z - coordinates_of(np, polar, grid)
    log = np.sum((apart @ inverse) * apart, 1) + np.sum(missed @ np.linalg.inv(V[polar]) * missed, 1)
    weight = np.exp(-0.5 * (log - log.min()))
    weight /= weight.sum()
    middle = weight @ grid
    spread = (grid - middle).T @ (weight[:, None] * (grid - middle))
    moved, left, _ = corrected(polar, mean[None], covariance[None], z[None], (np.eye(2), np.zeros(2), np.eye(2)))
    sigma = np.sqrt(np.linalg.eigvalsh(spread)[-1])
    assert np.abs(moved[0] - middle).max() < 0.25 * sigma
    ratio = np.linalg.eigvals(np.linalg.solve(spread, left[0])).real
    assert ratio.min() > 0.6
    assert ratio.max() < 1.6


def test_it_is_the_extended_filter_where_that_is_right():
    """A belief of 5 cm at 8 m: Stone Soup's extended and unscented updates, in a turned and displaced frame."""
    pytest.importorskip("stonesoup")
    from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.prediction import GaussianStatePrediction
    from stonesoup.updater.kalman import ExtendedKalmanUpdater, UnscentedKalmanUpdater

    yaw, t, mean = 0.7, np.array([1.0, -2.0]), np.array([6.0, 4.0])
    R = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    covariance = np.array([[0.0025, 0.001], [0.001, 0.004]])
    z = np.array([7.81 + 0.1, wrapped_bearing(R.T @ (mean - t)) + 0.005])
    after = update(np, np.linalg.inv, RANGE_BEARING, mean[None], covariance[None], z[None], V[RANGE_BEARING],
                   (R, t, np.eye(2)))  # fmt: skip
    left = np.linalg.inv(np.linalg.inv(covariance) + after.H[0].T @ np.linalg.inv(after.V[0]) @ after.H[0])
    model = CartesianToBearingRange(
        ndim_state=2, mapping=(0, 1), noise_covar=np.diag([0.01, 0.2]) ** 2, translation_offset=t[:, None],
        rotation_offset=np.array([[0.0], [0.0], [yaw]]),
    )  # fmt: skip
    for updater in (ExtendedKalmanUpdater(model), UnscentedKalmanUpdater(model)):
        prediction = GaussianStatePrediction(mean[:, None], covariance)
        detection = Detection(np.array([[z[1]], [z[0]]]), measurement_model=model)
        theirs = updater.update(SingleHypothesis(prediction, detection))
        np.testing.assert_allclose(after.mean[0], np.asarray(theirs.mean, float)[:, 0], atol=2e-4)
        np.testing.assert_allclose(left, np.asarray(theirs.covar, float), rtol=0.02, atol=2e-5)


def wrapped_bearing(q):
    return np.arctan2(q[1], q[0])


def test_it_is_filterpys_extended_filter_where_that_is_right():
    kalman = pytest.importorskip("filterpy.kalman")
    theirs = kalman.ExtendedKalmanFilter(dim_x=4, dim_z=1)
    mean, covariance = np.array([7.0, 2.0, 0.1, -0.2]), np.diag([0.01, 0.02, 0.1, 0.1])
    covariance[0, 2] = covariance[2, 0] = 0.01
    theirs.x, theirs.P, theirs.R = mean.copy(), covariance.copy(), V[BEARING].copy()
    Z, z = np.eye(2, 4), np.array([np.arctan2(2.0, 7.0) + 0.002])
    theirs.update(
        z,
        lambda x: np.array([[-x[1], x[0], 0.0, 0.0]]) / (x[0] ** 2 + x[1] ** 2),
        lambda x: np.array([np.arctan2(x[1], x[0])]),
    )
    after = update(np, np.linalg.inv, BEARING, mean[None], covariance[None], z[None], V[BEARING],
                   (np.eye(2), np.zeros(2), Z))  # fmt: skip
    np.testing.assert_allclose(after.mean[0], theirs.x, atol=1e-4)
    left = np.linalg.inv(np.linalg.inv(covariance) + after.H[0].T @ np.linalg.inv(after.V[0]) @ after.H[0])
    np.testing.assert_allclose(left, theirs.P, rtol=0.01, atol=1e-5)


def test_numpy_and_jax_agree():
    rng = np.random.default_rng(5)
    for polar, d in ((RANGE_BEARING, 2), (BEARING, 2), (RANGE, 2), (SPATIAL, 3)):
        R = np.linalg.qr(rng.normal(size=(d, d)))[0]
        root = rng.normal(size=(9, 2 * d, 2 * d))
        mean, covariance = 5 * rng.normal(size=(9, 2 * d)), root @ root.swapaxes(1, 2) + np.eye(2 * d)
        frame, z = (R, rng.normal(size=d), np.eye(d, 2 * d)), rng.normal(size=(9, len(V[polar]))) + 1.0
        for function in (update, squared_distance):
            ours = function(np, np.linalg.inv, polar, mean, covariance, z, V[polar], frame)
            compiled = jax.jit(functools.partial(function, jnp, inverse_spd, polar))
            theirs = compiled(mean, covariance, z, V[polar], frame)
            for a, b in zip(ours, theirs, strict=True):
                np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("polar", [RANGE_BEARING, BEARING, RANGE])
def test_a_belief_from_one_measurement_is_that_of_positions_drawn_in_the_view(polar):
    """Positions uniform in a sector of 8 m and 50 degrees to either side, kept where they would measure the same."""
    rng, reach = np.random.default_rng(1), Reach(8.0, np.deg2rad(50.0), np.pi / 2)
    z = {RANGE_BEARING: np.array([5.0, 0.4]), BEARING: np.array([0.4]), RANGE: np.array([5.0])}[polar]
    mean, covariance = one_point(np, polar, z, V[polar], reach, 2)
    count = 200_000
    every = {"range": 8.0 * np.sqrt(rng.uniform(size=count)), "bearing": np.deg2rad(rng.uniform(-50, 50, count))}
    for i, name in enumerate(polar.coordinates):
        every[name] = z[i] + np.sqrt(V[polar][i, i]) * rng.normal(size=count)
    drawn = position(np, every)
    np.testing.assert_allclose(mean, drawn.mean(0), atol=0.05)
    np.testing.assert_allclose(covariance, np.cov(drawn.T), rtol=0.02, atol=8.0 / NODES**2 * 2)


@pytest.mark.parametrize("polar", [RANGE_BEARING, BEARING, RANGE, SPATIAL])
def test_beliefs_hundreds_of_metres_wide_stay_positive_in_float32(polar):
    """The difference of two such covariances has no digits left: the noise that came of it was negative."""
    rng, d, runs = np.random.default_rng(4), 3 if polar is SPATIAL else 2, 2_000
    root = 300.0 * rng.normal(size=(runs, d, d))
    covariance = root @ root.swapaxes(-1, -2)
    mean, truth = 200.0 * rng.normal(size=(runs, d)), rng.uniform(-1.0, 1.0, (runs, d))
    z = coordinates_of(np, polar, truth) + np.sqrt(np.diagonal(V[polar])) * rng.normal(size=(runs, len(V[polar])))
    parts = (x.astype(np.float32) for x in (mean, covariance, z, V[polar], np.eye(d), np.zeros(d)))
    mean, covariance, z, noise, identity, origin = parts
    after = update(np, np.linalg.inv, polar, mean, covariance, z, noise, (identity, origin, identity))
    extra = np.diagonal(after.V, axis1=-2, axis2=-1) / np.diagonal(noise)
    assert extra.min() >= 1.0
    assert np.isfinite(after.mean[after.is_taken]).all()
