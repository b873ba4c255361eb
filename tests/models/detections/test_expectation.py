"""The expected GOSPA against the mean of GOSPA over targets drawn from tracks and intensity."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.worlds_of_detections import HALL

from foveate.evaluation.gospa import gospa
from foveate.models.detections.expectation import confirmed, expected_gospa, position_loss
from foveate.models.detections.records import Tracks

PROBLEM = HALL.problem()
CUTOFF_M = 4.0
"""Half the depth of the hall's view."""


EXISTENCE, STD_M = np.array([0.9, 0.95, 0.6, 0.6, 0.3, 0.0]), np.array([0.5, 4.0, 0.5, 2.0, 0.5, 1.0])
"""Of tracks far apart: the second exists and could be anywhere, the fourth is little of both."""


def test_the_reported_tracks_and_their_cost_are_those_of_least_mean_gospa():
    """Of all 64 sets of tracks, over drawn targets; two more targets are expected elsewhere."""
    rng, model, n = np.random.default_rng(0), PROBLEM.detections, len(STD_M)
    mean = np.zeros((n, 4))
    mean[:, 0] = 1e3 * np.arange(n)
    covariance = np.eye(4) * STD_M[:, None, None] ** 2
    tracks = Tracks(jnp.asarray(EXISTENCE), jnp.asarray(mean), jnp.asarray(covariance), jnp.arange(n))
    subsets = [np.array(each) for each in itertools.product([False, True], repeat=n)]
    squares = []
    for _ in range(1000):
        there = rng.uniform(size=n) < EXISTENCE
        targets = (mean[:, :2] + STD_M[:, None] * rng.normal(size=(n, 2)))[there]
        hidden = -1e4 * np.arange(1, rng.poisson(2.0) + 1)[:, None] * np.array([[1.0, 0.0]])
        truth = np.concatenate([targets, hidden])
        squares.append([gospa(mean[which, :2], truth, CUTOFF_M).gospa ** 2 for which in subsets])
    cost = np.mean(squares, axis=0)
    best = int(np.argmin(cost))
    np.testing.assert_array_equal(confirmed(PROBLEM, model, tracks), subsets[best])
    mine = float(expected_gospa(PROBLEM, model, tracks, jnp.full((8, 8), 2.0 / 64))) ** 2
    assert abs(mine - cost[best]) < 4 * np.std(squares, axis=0)[best] / np.sqrt(len(squares))


@pytest.mark.parametrize("std", [0.1, 1.0, 4.0, 40.0])
def test_a_capped_square_is_that_of_gaussian_errors(std):
    apart = np.random.default_rng(1).normal(0.0, std, (200_000, 2))
    drawn = np.minimum((apart**2).sum(axis=-1) / CUTOFF_M**2, 1.0)
    mine = float(position_loss(jnp.asarray(2 * std**2), jnp.asarray(CUTOFF_M)))
    assert abs(mine - drawn.mean()) < 4 * drawn.std() / np.sqrt(len(drawn)) + 1e-6


def test_a_capped_square_keeps_its_digits_in_float32():
    """Its limit for errors far beyond the cutoff, 1 - c^2 / (2 square), is never above 1."""
    square = np.array([1e2, 1e5, 1e7, 1e9, 1e12], np.float32)
    found = np.asarray(position_loss(jnp.asarray(square), jnp.asarray(1.0, jnp.float32)))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, 1.0 - 0.5 / square.astype(float), rtol=1e-4)
    assert (found <= 1.0).all()


def test_nothing_expected_costs_nothing():
    empty = Tracks(jnp.zeros(1), jnp.zeros((1, 4)), jnp.eye(4)[None], jnp.full(1, -1))
    assert float(expected_gospa(PROBLEM, PROBLEM.detections, empty, jnp.zeros((8, 8)))) < 1e-5
