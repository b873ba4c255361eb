"""The expected GOSPA against the mean of GOSPA over targets drawn from tracks and intensity."""

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.worlds_of_detections import HALL

from foveate.evaluation.gospa import gospa
from foveate.models.detections.expectation import capped, expected_gospa
from foveate.models.detections.records import Tracks

PROBLEM = HALL.problem()
CUTOFF_M = 4.0
"""Half the depth of the hall's view."""


def test_its_square_is_the_mean_over_drawn_targets():
    """Tracks far apart, two of them reported and one of these hardly known; two more targets expected elsewhere."""
    rng, model = np.random.default_rng(0), PROBLEM.detections
    existence, std = np.array([0.9, 0.6, 0.3, 0.0]), np.array([0.5, 5.0, 1.0, 1.0])
    mean = np.zeros((4, 4))
    mean[:, 0] = [0.0, 1e3, 2e3, 3e3]
    covariance = np.eye(4) * std[:, None, None] ** 2
    tracks = Tracks(jnp.asarray(existence), jnp.asarray(mean), jnp.asarray(covariance), jnp.arange(4))
    cells = np.full((8, 8), 2.0 / 64)
    squares = []
    for _ in range(4000):
        there = rng.uniform(size=4) < existence
        targets = (mean[:, :2] + std[:, None] * rng.normal(size=(4, 2)))[there]
        hidden = -1e4 * np.arange(1, rng.poisson(2.0) + 1)[:, None] * np.array([[1.0, 0.0]])
        found = gospa(mean[existence > model.confirm, :2], np.concatenate([targets, hidden]), CUTOFF_M)
        squares.append(found.gospa**2)
    mine = float(expected_gospa(PROBLEM, model, tracks, jnp.asarray(cells))) ** 2
    assert abs(mine - np.mean(squares)) < 4 * np.std(squares) / np.sqrt(len(squares))


@pytest.mark.parametrize("std", [0.1, 1.0, 4.0, 40.0])
def test_a_capped_square_is_that_of_gaussian_errors(std):
    apart = np.random.default_rng(1).normal(0.0, std, (200_000, 2))
    drawn = np.minimum((apart**2).sum(axis=-1), CUTOFF_M**2)
    mine = float(capped(jnp.asarray(2 * std**2), jnp.asarray(CUTOFF_M)))
    assert abs(mine - drawn.mean()) < 4 * drawn.std() / np.sqrt(len(drawn)) + 1e-9


def test_nothing_expected_costs_nothing():
    empty = Tracks(jnp.zeros(1), jnp.zeros((1, 4)), jnp.eye(4)[None], jnp.full(1, -1))
    assert float(expected_gospa(PROBLEM, PROBLEM.detections, empty, jnp.zeros((8, 8)))) < 1e-5
