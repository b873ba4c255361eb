"""The sensor against scipy's normal distribution, the paper's printed formula, and numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import erf
from scipy.stats import norm

from foveate.geometry.fov_planar import triangle
from foveate.models.sensor import PAPER_SOFTNESS, Sensor, Softness, detection_weight

LEVELS = [PAPER_SOFTNESS, Softness(1.0, 0.4), Softness(0.3, 0.25), Softness(0.0, 0.01), Softness(-1.0, 3.0)]
VIEW = triangle(2.0, 2 * np.pi / 3)
GENERATOR = np.random.default_rng(0)


def noise_covariance(size):
    root = GENERATOR.normal(size=(size, size))
    return root @ root.T + 0.1 * np.eye(size)


@pytest.mark.parametrize("level", LEVELS)
def test_detection_weight_is_the_papers_formula_and_a_normal_tail(level):
    distance = np.linspace(-6.0, 6.0, 601)
    weight = jax.jit(detection_weight)(distance, level)
    assert weight.dtype == np.float64
    phi = 0.5 * (1 + erf(distance / (np.sqrt(2) * level.kappa) - level.offset))
    np.testing.assert_allclose(weight, 1 - phi, atol=1e-15)
    mean = np.sqrt(2) * level.kappa * level.offset
    np.testing.assert_allclose(weight, norm.sf(distance, loc=mean, scale=level.kappa), rtol=1e-10, atol=1e-300)


def test_weight_one_half_lies_113_cm_outside_for_the_papers_level():
    weight = jax.jit(lambda d: detection_weight(d, PAPER_SOFTNESS))
    half = brentq(lambda d: float(weight(d)) - 0.5, -5.0, 5.0, xtol=1e-12)
    assert half == pytest.approx(2 * np.sqrt(2) * 0.4, abs=1e-10)
    assert half == pytest.approx(1.13, abs=0.005)


def test_detection_weight_in_float32_and_its_derivative():
    distance = np.linspace(-6.0, 6.0, 241, dtype=np.float32)
    weight = jax.jit(lambda d: detection_weight(d, PAPER_SOFTNESS))(distance)
    assert weight.dtype == np.float32
    mean = np.sqrt(2) * 0.4 * 2
    np.testing.assert_allclose(weight, norm.sf(distance.astype(float), mean, 0.4), atol=2e-7)
    slope = jax.jit(jax.vmap(jax.grad(lambda d: detection_weight(d, PAPER_SOFTNESS))))(distance)
    np.testing.assert_allclose(slope, -norm.pdf(distance.astype(float), mean, 0.4), atol=1e-6)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("growth", [0.0, 0.3])
@pytest.mark.parametrize("frame", ["world", "body"])
def test_covariance_turns_with_the_agent_and_grows_with_the_range(dimension, growth, frame):
    V, H = noise_covariance(dimension), np.eye(dimension, 2 * dimension)
    sensor = Sensor(jnp.asarray(H), jnp.asarray(V), VIEW, growth, frame)
    rotation, _ = np.linalg.qr(GENERATOR.normal(size=(dimension, dimension)))
    point = GENERATOR.normal(size=dimension)
    turned = rotation @ V @ rotation.T if frame == "body" else V
    expected = turned * (1 + growth * np.linalg.norm(point)) ** 2
    np.testing.assert_allclose(jax.jit(lambda r, p: sensor.covariance(r, p))(rotation, point), expected, atol=1e-12)


def test_body_noise_is_that_of_measurements_taken_in_the_body_frame():
    """R (body noise) has the covariance that the sensor says: by sampling, not by the formula."""
    V, yaw = np.diag([0.01, 0.25]), 0.7
    rotation = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    body = np.random.default_rng(1).multivariate_normal(np.zeros(2), V, 200_000)
    sensor = Sensor(jnp.eye(2), jnp.asarray(V), VIEW, 0.0, "body")
    covariance = sensor.covariance(jnp.asarray(rotation), jnp.zeros(2))
    np.testing.assert_allclose(covariance, np.cov((body @ rotation.T).T), atol=2e-3)


def test_range_growth_at_the_apex_has_a_finite_derivative_and_elsewhere_the_right_one():
    sensor = Sensor(jnp.eye(2), 0.04 * jnp.eye(2), VIEW, 0.3, "body")

    @jax.jit
    def trace(point):
        return jnp.trace(sensor.covariance(jnp.eye(2), point))

    slope = jax.jit(jax.grad(trace))

    np.testing.assert_allclose(sensor.covariance(jnp.eye(2), jnp.zeros(2)), 0.04 * np.eye(2), atol=1e-15)
    np.testing.assert_array_equal(slope(np.zeros(2)), np.zeros(2))
    point, step = np.array([0.6, -0.8]), 1e-6
    differences = [float(trace(point + step * e) - trace(point - step * e)) / (2 * step) for e in np.eye(2)]
    np.testing.assert_allclose(slope(point), differences, rtol=1e-7)


@pytest.mark.parametrize(("n_z", "n_y"), [(1, 1), (1, 3), (2, 2), (2, 4), (3, 6), (6, 6)])
def test_information(n_z, n_y):
    V, H = noise_covariance(n_z), GENERATOR.normal(size=(n_z, n_y))
    sensor = Sensor(jnp.asarray(H), jnp.asarray(V), VIEW)
    expected = H.T @ np.linalg.solve(V, H)
    np.testing.assert_allclose(jax.jit(lambda v: sensor.information(v))(V), expected, rtol=1e-9, atol=1e-10)
