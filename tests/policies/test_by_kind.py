"""A policy for each kind of robot: every robot decides by its own, and what all share is held once."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from helpers.episodes import training_episode
from helpers.rejections import assert_rejected

from foveate.planning.named import heuristic_in
from foveate.policies.by_kind import ByKind
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.kinds import RobotSettings
from foveate.scenario.obstacles import ShapeObstacles
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.team import TeamSettings
from foveate.simulation.records import TRUE
from foveate.simulation.team.rollout import first_observations

FAR = RobotSettings(view=SectorView(depth_m=9.0))
SCENARIO = Scenario(
    view=SectorView(depth_m=3.0),
    scenes=SceneSettings(targets_min=3, targets_max=3),
    team=TeamSettings(agents=3, robots=(RobotSettings(), FAR)),
)


@pytest.fixture(scope="module")
def seen():
    problem = SCENARIO.problem()
    episode = training_episode(problem, SCENARIO.scenes, jax.random.key(1), noise=True)
    return jax.jit(lambda episode: first_observations(problem, episode, TRUE))(episode)


@pytest.mark.parametrize("name", ["nearest", "price", "lawnmower"])
def test_every_robot_decides_by_the_policy_of_its_kind(seen, name):
    policy, key = heuristic_in(SCENARIO, name), jax.random.key(0)

    def decided(policy, observation):
        return policy(observation, policy.start(observation), key)[0]

    actions = jax.jit(jax.vmap(lambda each: decided(policy, each)))(seen)
    for m in range(3):
        own = heuristic_in(SCENARIO.of_robot(m), name)
        alone = jax.jit(lambda each, own=own: decided(own, each))(jax.tree.map(lambda x, m=m: x[m], seen))
        np.testing.assert_allclose(actions[m], alone, atol=1e-12)
    lonely = replace(jax.tree.map(lambda x: x[0], seen), team=None)
    assert_rejected(lambda: policy.start(lonely), "observation.team = None: expected a robot")


def test_followers_stop_before_the_target_by_half_their_own_view():
    policy = heuristic_in(SCENARIO, "nearest")
    assert isinstance(policy, ByKind)
    assert [float(policy.of_robot(m).standoff_m) for m in range(3)] == [1.5, 4.5, 1.5]


def test_a_map_is_held_once():
    walls = ShapeObstacles(circles=((9.0, 9.0, 1.0),), resolution_m=0.5)
    policy = heuristic_in(replace(SCENARIO, obstacles=walls), "nearest")
    grid = policy.rest.problem.obstacles.grid
    assert jax.tree.leaves(grid)
    assert not jax.tree.leaves(policy.own.problem.obstacles.grid)
