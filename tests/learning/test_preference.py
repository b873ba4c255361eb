"""The first preference is the best of those that are tried."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.learning.preference import PREFERENCES, best_preference
from foveate.policies.pointer import PREFERENCE
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.scenario import Scenario

POLICY = PointerSettings(kind="pointer").policy(Scenario().problem(), jax.random.key(0))


@pytest.mark.parametrize("best", range(len(PREFERENCES)))
def test_the_best_is_taken(best):
    tried = []

    def score_of(policy):
        tried.append(tuple(np.asarray(policy.preference).tolist()))
        return jnp.asarray(-abs(len(tried) - 1 - best), float)

    found = best_preference(POLICY, score_of)
    assert tried == [tuple(each) for each in PREFERENCES]
    np.testing.assert_array_equal(found.preference, PREFERENCES[best])
    assert found.mode_layer is POLICY.mode_layer, "nothing else changes"


def test_the_first_of_equals_is_the_usual_one():
    found = best_preference(POLICY, lambda policy: jnp.asarray(1.0))
    np.testing.assert_array_equal(found.preference, PREFERENCE)
