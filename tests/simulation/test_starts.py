"""Random scenes among obstacles begin in the open, on the maps of their suite; given ones are checked."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from foveate.errors import InputError
from foveate.scenario.obstacles import ShapeObstacles
from foveate.scenario.random_obstacles import CircleObstacles
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene, SceneSettings, read_scenes, scenes_digest, write_scenes
from foveate.simulation.episodes import training_episode
from foveate.simulation.suites import own_suite, scene_episodes

SCENES = SceneSettings(
    targets_min=2, targets_max=4, half_side_m=(6.0, 6.0), half_side_per_target_m=0.0, agent_spread=1.0, steps=3
)
CIRCLES = CircleObstacles(density_per_m2=0.15, maps=3, test_maps=2, radius_m=(0.5, 1.2))
SCENARIO = Scenario(scenes=SCENES, obstacles=CIRCLES)


def unions():
    low, high = np.full(2, -6.0), np.full(2, 6.0)
    for number in (*range(3), -1, -2):
        shapes = CIRCLES.shapes_in(np.random.default_rng([0, number < 0, abs(number)]), low, high)
        yield shapely.union_all([shapely.Point(s.corners[0]).buffer(s.radius) for s in shapes])


@pytest.mark.slow
def test_training_and_test_scenes_begin_in_the_open_on_their_own_maps():
    problem, maps = SCENARIO.problem(), list(unions())
    keys = jax.random.split(jax.random.key(0), 300)
    episodes = jax.jit(jax.vmap(lambda key: training_episode(problem, SCENES, key, noise=True)))(keys)
    assert set(episodes.map_number.tolist()) == {0, 1, 2}
    for number, pose, states in zip(episodes.map_number, episodes.pose, episodes.truth.state, strict=True):
        union = maps[int(number)]
        assert union.distance(shapely.Point(pose[:2])) >= CIRCLES.robot_radius_m
        assert shapely.distance(union, shapely.points(np.asarray(states[0]))).min() > 0
    suite = own_suite(SCENES, problem)
    assert {scene.map for scene in suite} == {3, 4}
    for scene in suite:
        assert shapely.distance(maps[scene.map], shapely.points(np.array(scene.targets))).min() > 0
    assert scene_episodes(problem, SCENES, suite, 0, 1).map_number.tolist() == [scene.map for scene in suite]


def test_without_test_maps_test_scenes_have_those_of_training():
    problem = replace(SCENARIO, obstacles=replace(CIRCLES, test_maps=0)).problem()
    assert {scene.map for scene in own_suite(SCENES, problem)} == {0, 1, 2}


def test_where_no_try_is_free_a_body_begins_at_the_freest_place():
    """Which is in the box of the starts, though the ground beyond it is freer."""
    below = ShapeObstacles(boxes=((-9.0, -9.0, 9.0, 4.0),))
    obstacles = Scenario(scenes=SCENES, obstacles=below).problem().obstacles
    tries = jnp.zeros((5, 2))
    place = obstacles.free_place(tries, obstacles.radius)
    np.testing.assert_array_equal(place, obstacles.freest[0])
    assert 5.9 < place[1] < 6.1


YARD = Scenario(scenes=SCENES, obstacles=ShapeObstacles(boxes=((-1.0, -1.0, 1.0, 1.0),)))
BAD = {
    "agent inside": (
        Scene(id="a", agent=(0.0, 0.0, 0.0), targets=((4.0, 4.0),)),
        "scene 'a': agent = [0.0, 0.0]: expected",
    ),
    "agent at a wall": (Scene(id="a", agent=(1.1, 0.0, 0.0), targets=((4.0, 4.0),)), "agent = [1.1, 0.0]"),
    "target inside": (
        Scene(id="a", agent=(4.0, 0.0, 0.0), targets=((4.0, 4.0), (0.5, 0.5))),
        "scene 'a': target = [0.5, 0.5]: expected at least",
    ),
    "another map": (Scene(id="a", agent=(4.0, 0.0, 0.0), targets=((4.0, 4.0),), map=1), "map = 1: expected < 1"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_scene_that_begins_in_an_obstacle_is_one_line(name):
    scene, words = BAD[name]
    with pytest.raises(InputError) as caught:
        scene_episodes(
            YARD.problem(), SCENES, [replace(scene, drift=((0.0, 0.0),) * len(scene.targets), horizon=3)], 0, 1
        )
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_target_may_begin_in_a_wall_that_is_no_obstacle_to_it():
    free = replace(YARD, obstacles=replace(YARD.obstacles, targets="free"))
    scene = Scene(id="a", agent=(4.0, 0.0, 0.0), targets=((0.5, 0.5),), drift=((0.0, 0.0),), horizon=3)
    assert scene_episodes(free.problem(), SCENES, [scene], 0, 1).truth is not None


def test_the_map_of_a_scene_is_kept_in_files(tmp_path):
    scenes = [Scene(id=str(i), agent=(0.0, 0.0, 0.0), targets=((1.0, 1.0),), map=i) for i in range(2)]
    write_scenes(tmp_path / "s.json", scenes)
    found = read_scenes(tmp_path / "s.json", YARD.problem().agent.space, SCENES)
    assert [scene.map for scene in found] == [0, 1]
    assert "map" not in scenes[0].record()
    assert scenes_digest(scenes[:1]) != scenes_digest([replace(scenes[0], map=2)])
    with pytest.raises(InputError, match="map = 1: expected none: there are no obstacles"):
        scene_episodes(Scenario().problem(), SCENES, found, 0, 1)
