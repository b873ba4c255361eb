"""Assignments against scipy's, and greedy ones against their definition."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from foveate.policies.assignment import greedy, optimal


@pytest.mark.parametrize("shape", [(1, 1), (4, 4), (3, 6), (6, 3), (16, 16)], ids=str)
def test_optimal_costs_what_scipy_finds(shape):
    costs = np.random.default_rng(shape).normal(size=(40, *shape)) * 10
    found = np.asarray(jax.jit(jax.vmap(optimal))(jnp.asarray(costs)))
    for cost, columns in zip(costs, found, strict=True):
        rows = np.flatnonzero(columns >= 0)
        assert len(rows) == len(set(columns[rows])) == min(shape)
        best = linear_sum_assignment(cost)
        np.testing.assert_allclose(cost[rows, columns[rows]].sum(), cost[best].sum(), atol=1e-9)


def test_optimal_with_equal_and_large_costs():
    cost = np.array([[1.0, 1.0, 1e6], [1.0, 1.0, 1e6], [1e6, 5.0, 1e6]])
    columns = np.asarray(optimal(jnp.asarray(cost)))
    assert cost[np.arange(3), columns].sum() == cost[linear_sum_assignment(cost)].sum()


@pytest.mark.parametrize("shape", [(4, 4), (2, 5), (5, 2)], ids=str)
def test_greedy_takes_the_least_pair_first(shape):
    cost = np.random.default_rng(0).normal(size=shape)
    left, expected = cost.copy(), np.full(shape[0], -1)
    for _ in range(min(shape)):
        row, column = np.unravel_index(np.argmin(left), shape)
        expected[row], left[row], left[:, column] = column, np.inf, np.inf
    np.testing.assert_array_equal(greedy(jnp.asarray(cost)), expected)
