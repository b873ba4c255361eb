"""Own coordinates of sensors against Stone Soup's models, finite differences, and each other in numpy and JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.models.polar import MIN_RANGE_M, Polar, coordinates_of, hessians, jacobian, noise, position, residual

RNG = np.random.default_rng(3)
KINDS = {
    "range-bearing": (("range", "bearing"), 2),
    "bearing": (("bearing",), 2),
    "range": (("range",), 3),
    "azimuth-elevation-range": (("bearing", "elevation", "range"), 3),
    "azimuth-elevation": (("bearing", "elevation"), 3),
}


def points(dimension, count=40):
    return RNG.normal(0.0, 4.0, (count, dimension))


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_are_those_of_finite_differences(kind):
    names, d = KINDS[kind]
    polar, q, step = Polar(names, (0.0,) * len(names)), points(d), 1e-5

    def differences(function):
        return np.stack([(function(q + step * e) - function(q - step * e)) / (2 * step) for e in np.eye(d)], axis=-1)

    first = np.stack(
        [residual(np, polar, coordinates_of(np, polar, q + step * e), coordinates_of(np, polar, q - step * e))
         for e in np.eye(d)],
        axis=-1,
    ) / (2 * step)  # fmt: skip
    np.testing.assert_allclose(jacobian(np, polar, q), first, rtol=1e-6, atol=1e-8)
    second = differences(lambda q: jacobian(np, polar, q))
    np.testing.assert_allclose(hessians(np, polar, q), second, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_numpy_and_jax_agree(kind):
    names, d = KINDS[kind]
    polar, q = Polar(names, (0.1,) * len(names)), points(d)
    V = np.diag(np.arange(1.0, len(names) + 1))
    for function in (coordinates_of, jacobian, hessians):
        np.testing.assert_allclose(function(jnp, polar, jnp.asarray(q)), function(np, polar, q), rtol=1e-12, atol=1e-14)
    expected = V * (1 + 0.1 * np.linalg.norm(q, axis=1))[:, None, None] ** 2
    np.testing.assert_allclose(noise(jnp, polar, V, q), expected, rtol=1e-12)
    np.testing.assert_allclose(noise(np, polar, V, q), expected, rtol=1e-12)


def test_a_position_has_the_coordinates_it_was_made_of():
    for d in (2, 3):
        names = KINDS["range-bearing" if d == 2 else "azimuth-elevation-range"][0]
        q = points(d)
        values = coordinates_of(np, Polar(names, (0.0,) * d), q)
        np.testing.assert_allclose(position(np, dict(zip(names, values.T, strict=True))), q, rtol=1e-12, atol=1e-12)


def test_coordinates_are_those_of_stone_soup():
    nonlinear = pytest.importorskip("stonesoup.models.measurement.nonlinear")
    from stonesoup.types.state import State

    flat, high = (np.eye(2), ("bearing", "range")), (np.eye(3), ("elevation", "bearing", "range"))
    for name, (V, names) in {"CartesianToBearingRange": flat, "CartesianToElevationBearingRange": high}.items():
        d = len(V)
        model = getattr(nonlinear, name)(ndim_state=d, mapping=range(d), noise_covar=V)
        polar = Polar(names, (0.0,) * d)
        for q in points(d, 10):
            state = State(q[:, None])
            theirs = np.asarray(model.function(state, noise=False), float)[:, 0]
            np.testing.assert_allclose(coordinates_of(np, polar, q), theirs, rtol=1e-12)
            np.testing.assert_allclose(jacobian(np, polar, q), np.asarray(model.jacobian(state), float), atol=1e-6)


def test_residuals_of_angles_are_wrapped_and_of_ranges_are_not():
    polar = Polar(("range", "bearing"), (0.0, 0.0))
    z, expected = np.array([9.0, 3.1]), np.array([2.0, -3.1])
    np.testing.assert_allclose(residual(np, polar, z, expected), [7.0, 6.2 - 2 * np.pi])
    np.testing.assert_allclose(residual(np, polar, np.array([0.0, 1e9]), expected)[1] % (2 * np.pi),
                               (1e9 + 3.1) % (2 * np.pi), atol=1e-6)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_at_the_sensor_itself_all_is_finite_with_a_finite_gradient(kind):
    names, d = KINDS[kind]
    polar = Polar(names, (0.1,) * len(names))

    def total(q):
        parts = (coordinates_of(jnp, polar, q), jacobian(jnp, polar, q), hessians(jnp, polar, q))
        return sum(jnp.sum(part) for part in parts)

    for q in (jnp.zeros(d), jnp.full(d, 1e-30), jnp.eye(d)[d - 1]):
        assert np.isfinite(total(q))
        assert np.isfinite(jax.grad(total)(q)).all()
    assert np.abs(jacobian(np, polar, np.zeros(d))).max() <= 1 / MIN_RANGE_M
