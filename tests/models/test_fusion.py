"""Fusion of beliefs against brute force over the weights, of evidence against a Kalman filter in covariance form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.models.belief import Belief
from foveate.models.fusion import corrected_by, covariance_intersection, evidence_of


def random_belief(rng, size=3):
    root = rng.normal(size=(size, size))
    return Belief(jnp.asarray(rng.normal(size=size)), jnp.asarray(root @ root.T + 0.3 * np.eye(size)))


@pytest.mark.parametrize("seed", range(4))
def test_covariance_intersection_equals_brute_force(seed):
    """The textbook form, with covariances, at ten thousand weights: its best determinant, and its mean."""
    own, other = (random_belief(np.random.default_rng([seed, i])) for i in range(2))
    fused = covariance_intersection(own, other)
    weights = np.linspace(0.0, 1.0, 10_001)
    first, second = (np.asarray(each.information) for each in (own, other))
    dets = np.linalg.slogdet(weights[:, None, None] * first + (1 - weights[:, None, None]) * second)[1]
    assert dets.max() - 0.01 <= np.linalg.slogdet(fused.information)[1] <= dets.max() + 1e-9
    # The weight that it took, from one number of the matrix; then the textbook's mean.
    w = (np.asarray(fused.information) - second)[0, 0] / (first - second)[0, 0]
    covariance = np.linalg.inv(w * first + (1 - w) * second)
    mean = covariance @ (w * first @ own.mean + (1 - w) * second @ other.mean)
    np.testing.assert_allclose(fused.mean, mean, atol=1e-10)
    np.testing.assert_allclose(np.linalg.inv(fused.information), covariance, atol=1e-10)


def test_equal_beliefs_stay_and_better_ones_replace():
    own = random_belief(np.random.default_rng(0))
    same = covariance_intersection(own, own)
    np.testing.assert_array_equal(same.mean, own.mean)
    np.testing.assert_array_equal(same.information, own.information)
    better = Belief(own.mean + 1.0, own.information + jnp.diag(jnp.array([1.0, 2.0, 3.0])))
    for first, second in ((own, better), (better, own)):
        fused = covariance_intersection(first, second)
        np.testing.assert_allclose(fused.mean, better.mean, atol=1e-12)
        np.testing.assert_allclose(fused.information, better.information, atol=1e-12)


def test_evidence_of_several_robots_adds_up():
    """Two measurements of one target, each corrected by itself, together equal a Kalman filter that takes both."""
    rng = np.random.default_rng(1)
    prior, H, V = random_belief(rng), jnp.asarray(rng.normal(size=(2, 3))), 0.3 * jnp.eye(2)
    mean, P, gain = np.asarray(prior.mean), np.linalg.inv(prior.information), H.T @ jnp.linalg.inv(V) @ H
    reference, found = jnp.array([5.0, -3.0, 1.0]), []
    for z in rng.normal(size=(2, 2)):
        K = np.linalg.inv(prior.information) @ H.T @ np.linalg.inv(H @ np.linalg.inv(prior.information) @ H.T + V)
        found.append(evidence_of(prior, gain, gain[None], prior.mean + K @ (z - H @ prior.mean), reference))
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + V)
        mean, P = mean + K @ (z - H @ mean), (np.eye(3) - K @ H) @ P
    both = jax.tree.map(lambda a, b: a + b, *found)
    np.testing.assert_allclose(corrected_by(prior, both, reference), mean, atol=1e-10)
    np.testing.assert_allclose(prior.information + both.growth[0], np.linalg.inv(P), atol=1e-9)
