"""The grid of undetected targets against samples and SciPy's normal distribution."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

from foveate.models.detections.grid import Grid


def grid(*shape):
    return Grid(jnp.full(len(shape), -4.0), jnp.full(len(shape), 6.0), shape)


@pytest.mark.parametrize("shape", [(5, 8), (4, 5, 6)])
def test_targets_return_to_the_cells_where_they_may_be(shape):
    cells, rng = grid(*shape), np.random.default_rng(0)
    mean, std, weight = (
        rng.uniform(-3, 5, (3, len(shape))),
        rng.uniform(0.3, 2, (3, len(shape))),
        np.array([0.2, 0.7, 1.0]),
    )
    found = np.asarray(eqx.filter_jit(cells.deposit)(*map(jnp.asarray, (weight, mean, std))))
    points = np.clip(rng.normal(mean[:, None], std[:, None], (3, 100_000, len(shape))), -4, 6)
    edges = [np.asarray(cells.edges(axis)) for axis in range(len(shape))]
    expected = sum(w * np.histogramdd(p, edges)[0] / len(p) for w, p in zip(weight, points, strict=True))
    np.testing.assert_allclose(found, expected, atol=0.01)
    np.testing.assert_allclose(found.sum(), weight.sum())


def test_a_box_of_births_overlaps_cells_in_part():
    found = np.asarray(grid(5, 2).overlap(jnp.array([-3.0, -4.0]), jnp.array([-1.0, 1.0])))
    expected = np.zeros((5, 2))
    expected[:2, 0] = 0.5
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("std", [0.05, 0.4, 0.72, 2.0])
def test_steps_spread_the_intensity_by_their_variance(std):
    """Short steps, of a fraction of a cell, as well as long ones; no target is lost."""
    cells = grid(40, 4)
    middle = np.asarray(cells.centres())[:, 0, 0]
    before = np.asarray(eqx.filter_jit(cells.deposit)(jnp.ones(1), jnp.array([[1.0, 1.0]]), jnp.array([[0.3, 0.3]])))
    after = np.asarray(eqx.filter_jit(cells.spread)(jnp.asarray(before), jnp.array([std**2, 0.0])))
    variances = [along @ (middle - 1.0) ** 2 for along in (before.sum(axis=1), after.sum(axis=1))]
    tails = 0.06 if std == 2.0 else 1e-3  # the border holds what would be beyond
    assert variances[1] - variances[0] == pytest.approx(std**2, rel=tails)
    np.testing.assert_allclose(after.sum(), 1.0)
    np.testing.assert_allclose(after.sum(axis=0), before.sum(axis=0), atol=1e-12)


def test_the_density_about_a_point_is_the_normal_one_of_its_cells():
    cells = grid(5, 5)
    intensity = np.zeros((5, 5))
    intensity[2, 3] = 8.0  # 0..2 by 2..4
    found = cells.density(jnp.asarray(intensity), jnp.array([[1.5, 2.2]]), jnp.array([[0.5, 1.0]]))
    share = np.diff(norm.cdf([0, 2], 1.5, 0.5)) * np.diff(norm.cdf([2, 4], 2.2, 1.0))
    np.testing.assert_allclose(found, 2.0 * share, rtol=1e-9)
