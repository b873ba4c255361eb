"""Means and gradients in micro-batches."""

import jax.numpy as jnp
import numpy as np
import pytest

from foveate.learning.gradient import mean_and_gradient


@pytest.mark.slow
@pytest.mark.parametrize("micro_batch", [1, 4, 7, 11, 100])
def test_micro_batches_of_any_size_give_the_same_mean_and_gradient(micro_batch):
    """Of (a x - y)^2, by hand: the derivative in a is the mean of 2 x (a x - y)."""
    x, y = np.random.default_rng(0).normal(size=(2, 11))
    value, gradient = mean_and_gradient(lambda a, xy: (a * xy[0] - xy[1]) ** 2, jnp.array(0.7), (x, y), micro_batch)
    np.testing.assert_allclose(value, np.mean((0.7 * x - y) ** 2), rtol=1e-12)
    np.testing.assert_allclose(gradient, np.mean(2 * x * (0.7 * x - y)), rtol=1e-12)
