"""What is in a robot's way by its own beliefs, against those beliefs read by hand."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.episodes import training_episode

from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.team import TeamSettings
from foveate.simulation.bodies import MATE_STEPS, bodies_along, bodies_of
from foveate.simulation.information import believed_future
from foveate.simulation.records import TRUE
from foveate.simulation.team.rollout import first_observations

KEEPING = Scenario(
    keep_off_m=0.8,
    team=TeamSettings(agents=3, half_side_m=(6.0, 6.0)),
    scenes=SceneSettings(targets_min=2, targets_max=2, steps=4),
)


@pytest.fixture(scope="module")
def observed():
    """The first observation of robot 1, which has heard robot 2 too long ago."""
    problem = KEEPING.problem()
    episode = training_episode(problem, KEEPING.scenes, jax.random.key(0), noise=True)
    seen = jax.jit(lambda e: first_observations(problem, e, TRUE))(episode)
    one = jax.tree.map(lambda x: x[1], seen)
    return problem, replace(one, team=replace(one.team, age=jnp.array([MATE_STEPS, 0, MATE_STEPS + 1])))


def test_targets_and_mates_heard_of_lately_are_in_the_way(observed):
    problem, seen = observed
    found = bodies_of(problem, seen)
    np.testing.assert_array_equal(found.positions_world[:-3], np.asarray(seen.mean)[:, :2])
    np.testing.assert_array_equal(found.positions_world[-3:], np.asarray(seen.team.pose)[:, :2])
    np.testing.assert_array_equal(found.present, [*seen.present, True, False, False])
    variance = np.trace(np.linalg.inv(np.asarray(seen.information)), axis1=1, axis2=2) / 2
    np.testing.assert_allclose(found.std_m, [*np.sqrt(variance), 0, 0, 0], rtol=1e-6)


def test_radii_grow_with_the_doubt_up_to_a_limit(observed):
    problem, seen = observed
    for std, times in ((0.0, 1.2), (0.1, 1.2 + 0.2 / 0.8), (9.0, 1.7)):
        sure = replace(seen, information=jnp.broadcast_to(jnp.eye(2) / max(std, 1e-6) ** 2, seen.information.shape))
        np.testing.assert_allclose(bodies_of(problem, sure).radius_m(problem.keep_off_m)[0], times * 0.8, rtol=1e-5)


def test_others_targets_are_in_the_way_and_padding_is_not(observed):
    problem, seen = observed
    told = replace(seen, present=seen.present & False, blocking=seen.present)
    np.testing.assert_array_equal(bodies_of(problem, told).present, bodies_of(problem, seen).present)
    broken = jnp.where(seen.present[:, None, None], seen.information, jnp.nan)
    assert np.isfinite(bodies_of(problem, replace(seen, information=broken)).std_m).all()


def test_along_a_future_targets_move_as_predicted_and_mates_stay(observed):
    problem, seen = observed
    future = believed_future(problem, seen, seen.known_input, 3, jnp.array(3))
    found = future.in_the_way(problem)
    np.testing.assert_array_equal(found.positions_world[:, :-3], np.asarray(future.state)[..., :2])
    np.testing.assert_array_equal(found.positions_world[:, -3:], np.asarray(seen.team.pose)[None, :, :2].repeat(3, 0))
    # Of a future of known states the targets are in the way, and nobody else.
    known = replace(future, bodies=None).in_the_way(problem)
    np.testing.assert_array_equal(known.positions_world, np.asarray(future.state)[..., :2])
    np.testing.assert_array_equal(known.present, np.tile(seen.present, (3, 1)))


def test_without_a_distance_to_keep_nothing_is_in_the_way(observed):
    problem, seen = observed
    free = replace(problem, keep_off_m=None)
    assert bodies_of(free, seen) is None
    assert bodies_along(free, seen, seen.mean[None]) is None
    assert believed_future(free, seen, seen.known_input, 2, jnp.array(2)).in_the_way(free) is None
