"""Places of undetected targets as tokens beside those of tracks."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.worlds_of_detections import HALL
from policies.test_search import PROBLEM, expecting, seen, tracking  # noqa: F401

from foveate.errors import InputError
from foveate.models.robot import Robot
from foveate.policies.lookahead import LookAhead
from foveate.policies.places import PLACES, token_count, with_places
from foveate.policies.pointer_settings import PointerSettings
from foveate.policies.tokens import SEARCH_FEATURES, token_size, tokens_of
from foveate.scenario.team import TeamSettings
from foveate.simulation.team.records import TeamView

TRACKS = PROBLEM.detections.tracks


@pytest.fixture(scope="module")
def decisions():
    """What a policy is told, and its decision untrained, beside those of the look-ahead: one program for all tests."""
    policy = PointerSettings().policy(PROBLEM, jax.random.key(0), "gospa")
    planner, key = LookAhead(PROBLEM), jax.random.key(1)

    @jax.jit
    def of(observation):
        searched = with_places(observation)
        tokens = searched.told(tokens_of(searched.observation, "gospa", True))
        return searched, tokens, planner.goals(observation), policy(observation, (), key)[0]

    return of


def test_the_best_places_follow_the_tracks(seen, decisions):  # noqa: F811
    """A track of 0.9, and 2 targets expected in a corner: the first place is that with the best way."""
    found, _, goals, _ = decisions(tracking(expecting(seen, {(7, 7): 2.0}), 3.0, 0.9, 2.0))
    assert found.observation.mean.shape == (TRACKS + PLACES, 4)
    assert found.observation.present.tolist() == [True] + [False] * (TRACKS - 1) + [True] * PLACES
    np.testing.assert_allclose(found.features[:, 0], [0.0] * TRACKS + [1.0] * PLACES)
    assert float(found.features[0, 1]) == pytest.approx(0.9)
    cost = np.sort(np.asarray(goals.cost)[TRACKS:])[:PLACES]
    np.testing.assert_allclose(found.cost[TRACKS:], cost - np.min(goals.cost), atol=1e-9)
    best = np.argmin(np.asarray(goals.cost)[TRACKS:])
    np.testing.assert_allclose(found.observation.mean[TRACKS], [*goals.position_world[TRACKS + best], 0.0, 0.0])
    assert float(found.features[TRACKS, 1]) == pytest.approx(float(goals.number[best]))


def test_tokens_have_the_features_in_front(seen, decisions):  # noqa: F811
    tokens = decisions(seen)[1]
    assert tokens.features.shape == (token_count(PROBLEM, 3), token_size(PROBLEM))
    np.testing.assert_array_equal(tokens.features[TRACKS:, 0], 1.0)
    assert token_size(PROBLEM) == token_size(replace(PROBLEM, detections=None)) + SEARCH_FEATURES
    assert token_count(replace(PROBLEM, detections=None), 3) == 3


def test_an_untrained_policy_decides_as_the_look_ahead(seen, decisions):  # noqa: F811
    for cell, sign in (((4, 7), 1.0), ((4, 0), -1.0)):
        _, _, goals, action = decisions(expecting(seen, {cell: 3.0}))
        np.testing.assert_allclose(action, np.clip(goals.action[np.argmin(goals.cost)], -1, 1), atol=0.05)
        assert np.sign(action[1]) == sign


def test_an_untrained_policy_of_a_team_decides_in_turn(seen):  # noqa: F811
    """More targets to the left than to the right: the first robot of two turns left, the second right."""
    problem = replace(HALL, team=TeamSettings(agents=2)).problem()
    policy = PointerSettings().policy(problem, jax.random.key(0), "gospa")
    expected = replace(expecting(seen, {(4, 7): 3.0, (4, 0): 2.0}), robot=Robot.of(problem))

    @jax.jit
    def decide(number):
        team = TeamView(number, jnp.zeros((2, 3)), jnp.zeros(2, int), jnp.zeros((2, TRACKS)))
        return policy(replace(expected, team=team), jnp.zeros(TRACKS), jax.random.key(1))

    for number, sign in enumerate((1.0, -1.0)):
        action, claims = decide(jnp.asarray(number))
        assert np.sign(action[1]) == sign
        np.testing.assert_array_equal(claims, np.zeros(TRACKS), "it goes for a place, not for a track")


def test_without_the_intensity_it_cannot_decide(seen):  # noqa: F811
    policy = PointerSettings().policy(HALL.problem(), jax.random.key(0), "gospa")
    with pytest.raises(InputError, match=r"observation\.undetected = None: expected that of detections without ids"):
        policy(replace(seen, undetected=None), (), jax.random.key(1))
    assert jnp.isfinite(seen.mean).all()
