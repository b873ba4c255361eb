"""Look-ahead in worlds without ids: costs by hand, and a way that finds what is expected."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.worlds_of_detections import HALL
from policies.test_search import PROBLEM, expecting, seen, tracking  # noqa: F401

from foveate.policies.lookahead import LookAhead, _of_undetected, errors_ahead
from foveate.scenario.team import RadioSettings, TeamSettings
from foveate.simulation.team.records import TeamView


@pytest.fixture
def still():
    """Three steps at the origin, heading along x."""
    return jnp.zeros((3, 3))


def test_undetected_targets_are_found_with_their_probability(seen, still):  # noqa: F811
    """One expected well in view, one behind: 0.2^k of the former are left, and births are added in each step."""
    left = eqx.filter_jit(_of_undetected)(PROBLEM, expecting(seen, {(5, 4): 1.0, (0, 4): 1.0}), still)
    births = np.array([0.0, 0.3, 0.6])
    expected = 1.0 + 0.2 ** np.arange(1, 4) + births
    # Births ahead of the robot may be found, too: at most all of them.
    assert (np.asarray(left) <= expected + 1e-9).all()
    assert (np.asarray(left) >= expected - births - 1e-9).all()


def test_errors_grow_as_the_motion_says(seen):  # noqa: F811
    """Variance P + 2 k c + k^2 V + W of each axis, by the closed form of white acceleration."""
    errors = eqx.filter_jit(errors_ahead)(PROBLEM, tracking(seen, 3.0, 1.0, 0.5), 4)
    k = np.arange(4)
    closed = 2 * (0.25 + k**2 * 0.25 + 0.01 * k**3 / 3)
    np.testing.assert_allclose(errors.unseen[:, 0], closed, rtol=1e-5)
    after = 2 / (1 / 0.25 + 1 / 0.04)
    np.testing.assert_allclose(errors.seen[0, 0], after, rtol=1e-5)


def test_it_turns_to_where_targets_are_expected(seen):  # noqa: F811
    for cell, sign in (((4, 7), 1.0), ((4, 0), -1.0)):
        action, _ = eqx.filter_jit(LookAhead(PROBLEM))(expecting(seen, {cell: 3.0}), (), jax.random.key(0))
        assert np.sign(action[1]) == sign


def test_the_robots_of_a_team_look_in_turn_at_what_others_leave(seen):  # noqa: F811
    """In one place, with more targets to the left: the first turns left, as if alone, and the second right."""
    expected, poses = expecting(seen, {(4, 7): 3.0, (4, 0): 2.0}), jnp.zeros((2, 3))
    for radio, signs in ((RadioSettings(), [1.0, -1.0]), (RadioSettings(loss=1.0), [1.0, 1.0])):
        problem = replace(HALL, team=TeamSettings(agents=2, radio=radio)).problem()
        policy = eqx.filter_jit(LookAhead(problem))
        told = [TeamView(jnp.asarray(i), poses, jnp.zeros(2, int), jnp.zeros((2, 10))) for i in range(2)]
        actions = [policy(replace(expected, team=team), (), jax.random.key(0))[0] for team in told]
        assert [np.sign(action[1]) for action in actions] == signs
    alone, _ = eqx.filter_jit(LookAhead(PROBLEM))(expected, (), jax.random.key(0))
    np.testing.assert_array_equal(actions[0], alone)


def test_a_track_in_view_costs_less_than_one_that_is_not(seen, still):  # noqa: F811
    planner = LookAhead(PROBLEM, 3)

    @eqx.filter_jit
    def cost_of(given):
        return planner.cost(PROBLEM, given, errors_ahead(PROBLEM, given, 3), still)

    cost = [float(cost_of(tracking(seen, x_m, 0.9, 3.0))) for x_m in (4.0, -4.0)]
    assert cost[0] < cost[1]
    assert HALL.detections.confirm < 0.9
