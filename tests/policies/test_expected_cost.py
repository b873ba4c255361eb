"""What ways are expected to cost: by hand, by brute force over detections, and by a Kalman filter."""

import itertools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from policies.test_search import PROBLEM, expecting, seen, tracking  # noqa: F401

from foveate.models.detections.expectation import position_loss
from foveate.policies.expected_cost import LOOKS, errors_ahead, of_undetected


@pytest.fixture
def test_undetected_targets_are_found_with_their_probability(seen, still):  # noqa: F811
    """One expected well in view, one behind: 0.2^k of the former are left, and births are added in each step."""
    cost = eqx.filter_jit(of_undetected)
    left = cost(PROBLEM, expecting(seen, {(5, 4): 1.0, (0, 4): 1.0}), jnp.zeros(3), still)
    births = np.array([0.0, 0.3, 0.6])
    expected = 1.0 + 0.2 ** np.arange(1, 4) + births
    # Births ahead of the robot may be found, too: at most all of them.
    assert (np.asarray(left) <= expected + 1e-5).all()  # an error of 0 counts 1e-6
    assert (np.asarray(left) >= expected - births - 1e-9).all()


def test_what_is_found_and_left_behind_counts_by_its_error(seen):  # noqa: F811
    """Two looks at a target, then three steps away from it: the mean over all sequences of detections and misses."""
    way = jnp.zeros((5, 3)).at[2:, 2].set(jnp.pi)
    error_m2 = np.array([0.1, 1.0, 4.0, 9.0, 300.0])
    cost = eqx.filter_jit(of_undetected)
    given = [expecting(seen, cells) for cells in ({(5, 4): 1.0}, {})]
    found = cost(PROBLEM, given[0], jnp.asarray(error_m2), way) - cost(PROBLEM, given[1], jnp.asarray(error_m2), way)
    loss = np.asarray(position_loss(jnp.asarray(error_m2), PROBLEM.detections.cutoff))
    expected = np.zeros(5)
    for detected in itertools.product((False, True), repeat=2):
        last = None
        for step in range(5):
            last = step if step < 2 and detected[step] else last
            share = 1.0 if last is None else loss[step - last]
            is_reported = last is not None and 1.0 - share > 0.5
            expected[step] += np.prod(np.where(detected, 0.8, 0.2)) * (2.0 * share if is_reported else 1.0)
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_errors_of_what_is_found_are_those_of_a_kalman_filter(seen):  # noqa: F811
    """From the prior by `LOOKS` measurements of the position, then without any."""
    A = np.kron([[1.0, 1.0], [0.0, 1.0]], np.eye(2))
    W = 0.01 * np.kron([[1 / 3, 1 / 2], [1 / 2, 1.0]], np.eye(2))
    H, P = np.eye(2, 4), np.linalg.inv(np.asarray(PROBLEM.prior_information))
    for look in range(LOOKS):
        P = A @ P @ A.T + W if look else P
        P = P - P @ H.T @ np.linalg.inv(H @ P @ H.T + 0.04 * np.eye(2)) @ H @ P
    expected = []
    for _ in range(4):
        expected.append(np.trace(P[:2, :2]))
        P = A @ P @ A.T + W
    errors = eqx.filter_jit(errors_ahead)(PROBLEM, seen, 4)
    np.testing.assert_allclose(errors.found, expected, rtol=1e-4)


def test_errors_grow_as_the_motion_says(seen):  # noqa: F811
    """Variance P + 2 k c + k^2 V + W of each axis, by the closed form of white acceleration."""
    errors = eqx.filter_jit(errors_ahead)(PROBLEM, tracking(seen, 3.0, 1.0, 0.5), 4)
    k = np.arange(4)
    closed = 2 * (0.25 + k**2 * 0.25 + 0.01 * k**3 / 3)
    np.testing.assert_allclose(errors.unseen[:, 0], closed, rtol=1e-5)
    after = 2 / (1 / 0.25 + 1 / 0.04)
    np.testing.assert_allclose(errors.seen[0, 0], after, rtol=1e-5)
