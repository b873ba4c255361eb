"""The masked softmax against scipy's."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import softmax

from foveate.policies.layers import masked_softmax

RNG = np.random.default_rng(0)


def test_masked_softmax_is_softmax_over_the_unmasked():
    compiled = jax.jit(masked_softmax)
    for scale in (1.0, 50.0, 1e4):
        for _ in range(5):
            scores, mask = scale * RNG.normal(size=9), RNG.random(9) < 0.6
            mask[0] = True
            scores[~mask] *= 1e3  # what lies in the padding has no say
            weights = np.asarray(compiled(scores, mask))
            np.testing.assert_allclose(weights[mask], softmax(scores[mask]), rtol=1e-12)
            np.testing.assert_array_equal(weights[~mask], 0)
    single = np.asarray(compiled(np.float32([1e30, 3e38, -3e38]), np.array([True, False, True])))
    assert single.dtype == np.float32
    np.testing.assert_array_equal(single, [1, 0, 0])


def test_masked_softmax_has_the_right_derivative_and_none_for_an_empty_row():
    scores, mask = RNG.normal(size=5), np.array([1, 0, 1, 1, 0], bool)
    jacobian = jax.jit(jax.jacobian(masked_softmax))
    s = np.where(mask, softmax(np.where(mask, scores, -np.inf)), 0)
    np.testing.assert_allclose(jacobian(scores, mask), np.diag(s) - np.outer(s, s), atol=1e-14)
    for scores in (np.zeros(5), 1e300 * np.ones(5), -1e300 * np.ones(5)):
        np.testing.assert_array_equal(masked_softmax(jnp.asarray(scores), jnp.zeros(5, bool)), np.zeros(5))
        np.testing.assert_array_equal(jacobian(scores, np.zeros(5, bool)), np.zeros((5, 5)))
