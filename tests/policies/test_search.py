"""Heuristics that search: they go where targets are expected, and weigh tracks and the way against it."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.episodes import training_episode
from helpers.worlds_of_detections import HALL

from foveate.errors import InputError
from foveate.models.robot import Robot
from foveate.names import SEARCHERS
from foveate.planning.named import heuristic_policy
from foveate.policies.search import Alternate, Explore, undetected_of
from foveate.simulation.records import TRUE, Observation, observe
from foveate.simulation.step import predict, start

PROBLEM = HALL.problem()


@pytest.fixture(scope="module")
def seen() -> Observation:
    """A robot in the middle, heading along x, that knows of nothing."""
    episode = training_episode(PROBLEM, HALL.scenes, jax.random.key(0), noise=True)

    @jax.jit
    def observed(episode):
        predicted = predict(PROBLEM, start(PROBLEM, episode, TRUE), episode.inputs[0])
        return observe(predicted, episode.inputs[0], episode.horizon, Robot.of(PROBLEM))

    first = observed(episode)
    return replace(first, pose=jnp.zeros(3), undetected=jnp.zeros((8, 8)))


def expecting(seen: Observation, cells: dict[tuple[int, int], float]) -> Observation:
    """With expected numbers of targets in some cells of 2.5 m."""
    undetected = np.zeros((8, 8))
    for cell, number in cells.items():
        undetected[cell] = number
    return replace(seen, undetected=jnp.asarray(undetected))


def tracking(seen: Observation, x_m: float, existence: float, std_m: float) -> Observation:
    """With a track behind the robot."""
    information = seen.information.at[0].set(jnp.eye(4) / std_m**2)
    return replace(
        seen,
        mean=seen.mean.at[0].set(jnp.array([x_m, 0.0, 0.0, 0.0])),
        information=information,
        existence=seen.existence.at[0].set(existence),
        present=seen.present.at[0].set(True),
    )


def goal(policy: Explore, seen: Observation) -> np.ndarray:
    return np.asarray(policy.goal(seen, ())[0])


def test_coarse_places_have_the_sums_of_their_cells():
    cells = np.random.default_rng(0).uniform(size=(8, 8))
    found = undetected_of(PROBLEM.detections, jnp.asarray(cells), 4)
    np.testing.assert_allclose(found.number, cells.reshape(4, 2, 4, 2).sum(axis=(1, 3)).ravel())
    np.testing.assert_allclose(found.position_world[0], [-7.5, -7.5])
    np.testing.assert_allclose(found.position_world[-1], [7.5, 7.5])


def test_explore_goes_where_targets_are_expected(seen):
    policy = Explore(PROBLEM, 0.0)
    far = goal(policy, expecting(seen, {(0, 7): 1.0}))
    assert np.hypot(*(far - [-8.75, 8.75])) <= 4.0, "a place from which half the view's depth holds the cell"
    assert goal(policy, expecting(seen, {(0, 7): 1.0, (7, 7): 1.0}))[0] > 0, "of equals the one ahead"
    assert goal(policy, expecting(seen, {(0, 7): 5.0, (7, 7): 1.0}))[0] < 0, "unless the other is worth the way"


def test_alternate_goes_to_a_track_that_is_about_to_be_lost(seen):
    policy = Alternate(PROBLEM, 0.0)
    searching = expecting(seen, {(7, 7): 0.2})
    assert goal(policy, tracking(searching, -6.0, 0.9, 0.1))[0] > 0
    np.testing.assert_allclose(goal(policy, tracking(searching, -6.0, 0.9, 20.0)), [-6.0, 0.0])
    assert goal(policy, tracking(searching, -6.0, 0.01, 20.0))[0] > 0


@pytest.mark.parametrize("method", SEARCHERS)
def test_actions_are_defined_where_nothing_is_expected(method, seen):
    action, _ = heuristic_policy(method, PROBLEM, 8.0)(seen, (), jax.random.key(0))
    assert np.isfinite(action).all()
    assert (np.abs(action) <= 1).all()


def test_with_ids_there_is_nothing_to_search():
    with pytest.raises(InputError, match="method 'explore': expected a scenario with detections without ids"):
        heuristic_policy("explore", replace(HALL, detections=None).problem(), 8.0)


def test_the_lawnmower_sweeps_the_box_of_the_detections(seen):
    corners, _ = heuristic_policy("lawnmower", PROBLEM, 8.0).start(seen)
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [[-10, -10 + 10 / 6], [10, 10 - 10 / 6]])
