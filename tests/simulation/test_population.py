"""Targets that come and go: their numbers, places and lives against closed forms, over many episodes."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.worlds_of_detections import HALL
from scipy.stats import poisson as scipy_poisson

from foveate.errors import InputError
from foveate.scenario.region import RegionSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.population import _lives, poisson
from foveate.simulation.suites import own_suite, scene_episodes

EPISODES = 4000


@pytest.fixture(scope="module")
def crowds():
    """Many training episodes."""
    problem = HALL.problem()
    keys = jax.random.split(jax.random.key(3), EPISODES)
    made = jax.jit(jax.vmap(lambda key: training_episode(problem, HALL.scenes, key, noise=True)))(keys)
    return jax.tree.map(np.asarray, made)


def within(values: np.ndarray, expected: float, errors: float = 4.0) -> bool:
    return abs(values.mean() - expected) <= errors * values.std(ddof=1) / np.sqrt(len(values))


def test_numbers_follow_their_recursion(crowds):
    """2 of a scene in the mean of 1, 2, 3, one in a box, 1 anywhere; then n' = 0.95 n + 0.3."""
    expected = 2.0 + 1.0 + 1.0
    for k in range(HALL.scenes.steps + 1):
        assert within(crowds.scans.alive[:, k].sum(axis=-1), expected), k
        expected = 0.95 * expected + 0.3


def test_a_target_is_born_in_its_box_and_lives_on(crowds):
    alive, state = crowds.scans.alive, crowds.truth.state
    born = alive[:, 1:] & ~alive[:, :-1]
    places = state[:, 1:, :, :2][born]
    in_first = np.all((places >= -9) & (places <= -5), axis=-1)
    assert np.all(in_first | np.all((places >= 5) & (places <= 9), axis=-1))
    assert within(in_first.astype(float), 2 / 3)
    velocity = state[:, 1:, :, 2:][born]
    assert within(velocity.ravel() ** 2, 0.03)
    after = alive[:, 2:] & born[:, :-1]
    step = (state[:, 2:, :, :2] - state[:, 1:-1, :, :2])[after] - state[:, 1:-1, :, 2:][after]
    np.testing.assert_allclose(step.std(), np.sqrt(0.01 / 3), rtol=0.05)


def test_a_place_is_free_for_a_step_between_two_lives(crowds):
    alive = crowds.scans.alive
    moved = np.abs(np.diff(crowds.truth.state[..., :2], axis=1)).max(axis=-1)
    assert moved[alive[:, 1:] & alive[:, :-1]].max() < 3.0


def test_false_alarms_are_poisson_in_the_view(crowds):
    counts = crowds.scans.is_false.sum(axis=-1).ravel()
    assert within(counts, 0.5)
    np.testing.assert_allclose((counts == 0).mean(), np.exp(-0.5), atol=0.01)
    points = crowds.scans.clutter_body[crowds.scans.is_false]
    assert np.hypot(*points.T).max() <= 8.0
    assert np.abs(np.arctan2(points[:, 1], points[:, 0])).max() <= np.pi / 3 + 1e-6


def test_poisson_is_scipys_quantile():
    uniform = np.linspace(1e-6, 1 - 1e-6, 1001)
    mine = jax.vmap(lambda u: poisson(u, jnp.asarray(1.7), 30))(jnp.asarray(uniform))
    np.testing.assert_array_equal(mine, scipy_poisson.ppf(uniform, 1.7))
    assert int(poisson(jnp.asarray(0.999), jnp.asarray(0.0), 0)) == 0


def test_births_take_free_places_in_order():
    first = jnp.array([True, False, False])
    survives = jnp.array([[False, True, True], [True, True, False]])
    alive, begins, number = _lives(first, survives, jnp.array([1, 2]))
    np.testing.assert_array_equal(alive, [[1, 0, 0], [0, 1, 0], [1, 1, 1]])
    np.testing.assert_array_equal(begins, [[0, 1, 0], [1, 0, 1]])
    np.testing.assert_array_equal(number[1], [0, 0, 1])


def test_a_scene_is_the_same_alone_and_beside_larger_ones():
    """All random numbers are of (seed, scene id, episode)."""
    problem = HALL.problem()
    scenes = own_suite(HALL.scenes, problem)[::30]
    alone = scene_episodes(problem, HALL.scenes, scenes[:1], 5, 1)
    beside = scene_episodes(problem, HALL.scenes, scenes, 5, 1)
    n, others = 1, problem.detections.sources.others
    lived = np.asarray(alone.scans.alive[0])
    rows = [*range(n), *range(3, 3 + others)]
    # A place of a scene's target that no longer lives is for births, too: with more such places they move.
    np.testing.assert_array_equal(lived[0], np.asarray(beside.scans.alive[0, 0])[rows])
    np.testing.assert_array_equal(alone.scans.is_false[0], beside.scans.is_false[0])
    np.testing.assert_array_equal(alone.truth.state[0, 0], beside.truth.state[0, 0][np.array(rows)])


def test_known_targets_move_as_with_ids():
    """The same scene and seed: truth and first beliefs are those of the scenario without the table."""
    known = replace(HALL, detections=replace(HALL.detections, known=True, births=(), undetected=0.0, survival=1.0))
    plain = replace(HALL, detections=None)
    scenes = own_suite(HALL.scenes, plain.problem())[::30]
    mine = scene_episodes(known.problem(), known.scenes, scenes, 0, 1)
    theirs = scene_episodes(plain.problem(), plain.scenes, scenes, 0, 1)
    np.testing.assert_array_equal(mine.truth.state, theirs.truth.state)
    np.testing.assert_array_equal(mine.mean[:, :3], theirs.mean)
    np.testing.assert_array_equal(mine.present[:, :3], theirs.present)
    assert not mine.present[:, 3:].any()
    np.testing.assert_array_equal(mine.scans.alive, np.repeat(theirs.present[:, None], 13, axis=1))


@pytest.mark.slow
def test_targets_keep_borders():
    walled = replace(HALL, region=RegionSettings(low_m=(-10.0, -10.0), high_m=(10.0, 10.0), agent="free"))
    problem = walled.problem()
    keys = jax.random.split(jax.random.key(1), 64)
    made = jax.jit(jax.vmap(lambda key: training_episode(problem, walled.scenes, key, noise=True)))(keys)
    assert np.abs(made.truth.state[..., :2]).max() <= 10.0


def test_without_noise_there_is_no_truth_to_detect():
    with pytest.raises(InputError, match="noise = False: expected True with detections without ids"):
        training_episode(HALL.problem(), HALL.scenes, jax.random.key(0), noise=False)
