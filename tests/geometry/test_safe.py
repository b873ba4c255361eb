"""Values and derivatives of functions with kinks, on them and off them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.geometry.safe import clipped, larger, length

ARGUMENTS = (0, 1, 2)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
def test_length_has_a_unit_derivative_at_every_scale(scale):
    vector = [jnp.float32(scale * part) for part in (2.0, -3.0, 6.0)]
    np.testing.assert_allclose(length(*vector), 7 * scale, rtol=2e-7)
    for mode in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(jax.jit(mode(length, ARGUMENTS))(*vector), [2 / 7, -3 / 7, 6 / 7], rtol=2e-7)


def test_length_of_zero_has_zero_derivative():
    np.testing.assert_array_equal(length(jnp.zeros(4), jnp.zeros(4)), 0)
    for mode in (jax.grad, jax.jacfwd, jax.hessian):
        assert not np.any(jax.jit(mode(length, (0, 1)))(0.0, 0.0))


def test_length_has_the_second_derivative_of_a_norm():
    """(I - u u^T) / |p|, u the unit vector."""
    unit = np.array([2.0, -3.0, 6.0]) / 7
    second = jax.jit(jax.hessian(length, ARGUMENTS))(*map(jnp.asarray, 14 * unit))
    np.testing.assert_allclose(second, (np.eye(3) - np.outer(unit, unit)) / 14, atol=1e-15)


@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_a_tie_has_the_derivative_of_one(mode):
    """Not half of each."""
    by_both, by_all = jax.jit(mode(larger, (0, 1))), jax.jit(mode(clipped, ARGUMENTS))
    np.testing.assert_array_equal(by_both(2.0, 2.0), [0, 1])
    np.testing.assert_array_equal(by_both(3.0, 2.0), [1, 0])
    for value, expected in [(0.0, [0, 1, 0]), (1.0, [1, 0, 0]), (2.0, [1, 0, 0]), (3.0, [1, 0, 0]), (4.0, [0, 0, 1])]:
        assert float(clipped(*map(jnp.asarray, (value, 1.0, 3.0)))) == min(max(value, 1.0), 3.0)
        np.testing.assert_array_equal(by_all(value, 1.0, 3.0), expected)
