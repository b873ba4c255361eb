"""Means and gradients in micro-batches, of groups of several shapes."""

import jax.numpy as jnp
import numpy as np
import pytest

from foveate.learning.devices import Share
from foveate.learning.gradient import Group, mean_and_gradient


def squared(a, xy):
    """(a x - y)^2."""
    return (a * xy[0] - xy[1]) ** 2


@pytest.mark.slow
@pytest.mark.parametrize("micro_batch", [1, 4, 7, 11, 100])
def test_micro_batches_of_any_size_give_the_same_mean_and_gradient(micro_batch):
    """Of (a x - y)^2, by hand: the derivative in a is the mean of 2 x (a x - y)."""
    x, y = jnp.asarray(np.random.default_rng(0).normal(size=(2, 11)))
    value, gradient = mean_and_gradient([Group(squared, (x, y), Share(11, micro_batch))], jnp.array(0.7))
    np.testing.assert_allclose(value, np.mean((0.7 * x - y) ** 2), rtol=1e-12)
    np.testing.assert_allclose(gradient, np.mean(2 * x * (0.7 * x - y)), rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("micro_batches", [(2, 3), (100, 1)])
def test_groups_weigh_by_their_episodes(micro_batches):
    """Episodes of one and of three numbers, each its own loss: the mean is that of all nine."""
    rng = np.random.default_rng(1)
    (x, y), z = jnp.asarray(rng.normal(size=(2, 5))), jnp.asarray(rng.normal(size=(4, 3)))
    groups = [
        Group(squared, (x, y), Share(5, micro_batches[0])),
        Group(lambda a, z: a * jnp.sum(z), z, Share(4, micro_batches[1], cost=3.0)),
    ]
    value, gradient = mean_and_gradient(groups, jnp.array(0.7))
    np.testing.assert_allclose(value, np.append((0.7 * x - y) ** 2, 0.7 * z.sum(axis=1)).mean(), rtol=1e-12)
    np.testing.assert_allclose(gradient, np.append(2 * x * (0.7 * x - y), z.sum(axis=1)).mean(), rtol=1e-12)
