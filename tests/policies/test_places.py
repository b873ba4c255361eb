"""Places of undetected targets as tokens beside those of tracks."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.worlds_of_detections import HALL
from policies.test_search import PROBLEM, expecting, seen, tracking  # noqa: F401

from foveate.errors import InputError
from foveate.policies.places import PLACES, token_count, with_places
from foveate.policies.pointer import PointerSettings
from foveate.policies.tokens import SEARCH_FEATURES, token_size, tokens_of

TRACKS = PROBLEM.detections.tracks


def test_the_best_places_follow_the_tracks(seen):  # noqa: F811
    """A track of 0.9, and 2 targets expected in a corner: the first place is the nearest that has both in reach."""
    found = eqx.filter_jit(with_places)(tracking(expecting(seen, {(7, 7): 2.0}), 3.0, 0.9, 2.0))
    assert found.observation.mean.shape == (TRACKS + PLACES, 4)
    assert found.observation.present.tolist() == [True] + [False] * (TRACKS - 1) + [True] * PLACES
    np.testing.assert_allclose(found.features[:, 0], [0.0] * TRACKS + [1.0] * PLACES)
    np.testing.assert_allclose(found.features[[0, TRACKS], 1], [0.9, 2.0])
    place = found.observation.mean[TRACKS]
    assert np.hypot(*(place[:2] - 8.75)) <= 4.0
    np.testing.assert_array_equal(place[2:], 0.0)
    assert (np.diff(found.log_worth[TRACKS:]) <= 0).all()


def test_tokens_have_the_features_in_front(seen):  # noqa: F811
    plain = jax.eval_shape(lambda seen: tokens_of(replace(seen, undetected=None), "terminal", True), seen)

    def told(seen):
        searched = with_places(seen)
        return searched.told(tokens_of(searched.observation, "gospa", True))

    tokens = jax.eval_shape(told, seen)
    assert tokens.features.shape == (token_count(PROBLEM, 3), token_size(PROBLEM))
    assert token_size(PROBLEM) == plain.features.shape[1] + SEARCH_FEATURES
    assert token_count(replace(PROBLEM, detections=None), 3) == 3


def test_an_untrained_policy_goes_where_targets_are_expected(seen):  # noqa: F811
    policy = PointerSettings().policy(PROBLEM, jax.random.key(0), "gospa")
    for cell, sign in (((4, 7), 1.0), ((4, 0), -1.0)):
        action, _ = eqx.filter_jit(policy)(expecting(seen, {cell: 3.0}), (), jax.random.key(1))
        assert np.sign(action[1]) == sign


def test_without_the_intensity_it_cannot_decide(seen):  # noqa: F811
    policy = PointerSettings().policy(HALL.problem(), jax.random.key(0), "gospa")
    with pytest.raises(InputError, match=r"observation\.undetected = None: expected that of detections without ids"):
        policy(replace(seen, undetected=None), (), jax.random.key(1))
    assert jnp.isfinite(seen.mean).all()
