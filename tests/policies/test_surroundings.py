"""What a policy is told of obstacles, against shapely, and where it aims."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.observations import seen

from foveate.geometry.sight import fan
from foveate.models.robot import Surroundings
from foveate.policies.detour import steer_to
from foveate.policies.pointer_settings import PointerSettings
from foveate.policies.surroundings import RANGE_DEPTHS, surroundings
from foveate.policies.tokens import token_size, tokens_of
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.obstacles import ShapeObstacles
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings

BOXES = ((0.0, -4.0, 0.5, 4.0), (-5.0, 2.0, -1.0, 2.5))
HALL = SceneSettings(half_side_m=(8.0, 8.0), half_side_per_target_m=0.0)
SCENARIO = Scenario(
    view=SectorView(depth_m=4.0, angle_deg=90.0), scenes=HALL, obstacles=ShapeObstacles(boxes=BOXES, resolution_m=0.1)
)
RAYS = 16
POSE = np.array([-3.0, -1.0, 0.4])
tokens = eqx.filter_jit(tokens_of)
TARGETS = np.array([[-4.0, 1.0], [3.0, 0.0], [-3.0, 4.0], [-1.0, -3.0]])


@pytest.fixture(scope="module")
def observation():
    turn = np.array([[np.cos(POSE[2]), -np.sin(POSE[2])], [np.sin(POSE[2]), np.cos(POSE[2])]])
    return seen(SCENARIO, turn, POSE[:2], TARGETS, np.tile(np.eye(2), (4, 1, 1)), np.zeros((4, 2)))


def test_ranges_and_lines_of_sight_are_those_of_shapely(observation):
    found = eqx.filter_jit(surroundings)(observation, observation.robot, jnp.asarray(TARGETS), RAYS, jnp.array(2.0))
    walls = shapely.union_all([shapely.box(*box) for box in BOXES])
    angle = np.arctan2(*fan(RAYS, 2).T[::-1]) + POSE[2]
    most = RANGE_DEPTHS * 4.0
    ends = POSE[:2] + most * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rays = shapely.linestrings(np.stack([np.broadcast_to(POSE[:2], ends.shape), ends], axis=1))
    met = shapely.intersection(rays, walls)
    expected = np.where(shapely.is_empty(met), most, shapely.distance(shapely.Point(POSE[:2]), met))
    short = expected - np.asarray(found.ranges)
    assert (short > -1e-6).all()
    assert np.median(short) < 0.2  # of eight steps, a cell before an obstacle, more where one grazes it
    lines = shapely.linestrings([[POSE[:2], target] for target in TARGETS])
    np.testing.assert_array_equal(found.is_seen, ~shapely.intersects(walls, lines))
    assert not np.asarray(found.is_seen).all()


def test_the_first_mode_aims_along_the_way(observation):
    aim = tokens(observation, "mean", True, rays=RAYS).aim
    problem = SCENARIO.problem()
    action = jax.jit(jax.vmap(lambda place: steer_to(problem, jnp.asarray(POSE), place, 2.0, None)))
    expected = np.asarray(action(jnp.asarray(TARGETS)))
    np.testing.assert_allclose(np.asarray(aim)[:, list(problem.agent.axes)], expected, atol=1e-5)
    blind = tokens(observation, "mean", True)
    assert np.abs(np.asarray(blind.aim - aim))[1].max() > 0.1
    np.testing.assert_allclose(blind.aim[3], aim[3], atol=1e-6)  # nothing is between
    assert blind.features.shape[1] == token_size(problem)


def test_what_an_observation_says_replaces_the_map(observation):
    away, free = np.linalg.norm(TARGETS - POSE[:2], axis=-1), np.ones(4, bool)
    said = Surroundings(*map(jnp.asarray, (np.full(RAYS, RANGE_DEPTHS * 4.0), TARGETS, away, free, free)))
    told = tokens(replace(observation, surroundings=said), "mean", True, rays=RAYS)
    bare = replace(observation, robot=replace(observation.robot, problem=replace(SCENARIO.problem(), obstacles=None)))
    open_world = tokens(bare, "mean", True, rays=RAYS)
    np.testing.assert_allclose(told.features, open_world.features, atol=1e-6)
    np.testing.assert_allclose(told.aim, open_world.aim, atol=1e-6)
    assert np.abs(np.asarray(told.features - tokens(observation, "mean", True, rays=RAYS).features)).max() > 0.1


def test_a_policy_decides_among_obstacles_and_in_the_open(observation):
    policy = PointerSettings(rays=RAYS).policy(SCENARIO.problem(), jax.random.key(0))
    action, _ = eqx.filter_jit(policy)(observation, (), jax.random.key(0))
    assert np.isfinite(np.asarray(action)).all()
    size = token_size(SCENARIO.problem(), RAYS)
    assert jax.eval_shape(policy.tokens, observation).features.shape == (4, size)
    assert size > token_size(SCENARIO.problem()) + RAYS


def test_wrong_numbers_of_rays_are_rejected():
    with pytest.raises(ValueError, match="rays"):
        PointerSettings(rays=-1)
    with pytest.raises(ValueError, match="rays"):
        PointerSettings(rays=100_000)
