"""Steering around obstacles: a robot arrives where a way leads, and heuristics ask for the way, not the distance."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.api import load
from foveate.planning.named import heuristic_in
from foveate.policies.detour import reachable, steer_to, unfolded
from foveate.policies.heuristics import Nearest
from foveate.policies.steering import steer
from foveate.scenario.agent import DifferentialDrive
from foveate.scenario.field_of_view import TriangleView
from foveate.scenario.obstacles import ShapeObstacles
from foveate.scenario.random_obstacles import RoomObstacles
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene, SceneSettings
from foveate.simulation.records import TRUE, Policy
from foveate.simulation.rollout import rollout
from foveate.simulation.suites import scene_episodes

HALL = SceneSettings(
    targets_min=1,
    targets_max=2,
    half_side_m=(8.0, 8.0),
    half_side_per_target_m=0.0,
    agent_spread=1.0,
    steps=30,
    jitter_m_s=0.0,
    process_noise=False,
)
WALL = ShapeObstacles(boxes=((0.0, -4.0, 0.5, 6.0),))


def test_a_place_behind_a_wall_unfolds_to_the_length_of_the_way():
    problem = Scenario(scenes=HALL, obstacles=WALL).problem()
    pose, ends = jnp.array([-3.0, 0.0, 0.7]), jnp.array([[-3.0, 5.0], [3.0, 0.0]])
    way = jax.jit(lambda: unfolded(problem, pose, ends, 0.5))()
    np.testing.assert_array_equal(way.is_straight, [True, False])
    np.testing.assert_allclose(way.points_body[0], problem.agent.space.to_body(pose, ends[0]), atol=1e-6)
    # Around the lower end of the wall, which is nearer, at the distance of the body from its corners.
    low = -4.0 - 0.2 - 0.07
    expected = np.hypot(3.0, low) + 0.5 + np.hypot(2.5, low)
    assert expected < float(jnp.linalg.norm(way.points_body[1])) < 1.1 * expected + 0.5
    towards = problem.agent.space.to_world(pose, way.points_body[1:])[0] - pose[:2]
    assert float(jnp.arctan2(towards[1], towards[0])) < -0.7
    assert float(way.rest[0]) == 0.5
    # It stops at a bend beside the wall.
    assert 0.0 < float(way.rest[1]) < expected - 2.5


def test_without_obstacles_steering_is_the_steering_law():
    problem = Scenario(scenes=HALL).problem()
    pose, point = jnp.array([1.0, 2.0, 0.3]), jnp.array([4.0, 7.0])
    expected = steer(problem.agent, problem.tau, problem.agent.space.to_body(pose, point), 1.0)
    np.testing.assert_array_equal(steer_to(problem, pose, point, 1.0, None), expected)
    np.testing.assert_array_equal(reachable(problem, point[None]), point[None])


def test_the_nearest_target_is_that_of_the_shortest_way():
    problem = Scenario(scenes=HALL, obstacles=WALL).problem()
    # The second is nearer, but behind the wall.
    scene = Scene(id="a", agent=(-2.0, 0.0, 0.0), targets=((-2.0, 4.0), (1.5, 0.0)), horizon=2)
    episode = jax.tree.map(lambda x: x[0], scene_episodes(problem, HALL, [scene], 0, 1))
    for seen, expected in ((problem, 0), (replace(problem, obstacles=None), 1)):
        policy = Nearest(seen, 1.0)
        trace = jax.jit(lambda e, p=policy, q=seen: rollout(q, p, e, TRUE, jax.random.key(0)))(episode)
        turn = float(trace.pose[1, 2])
        assert (turn > 0.5) == (expected == 0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_robot_arrives_anywhere_among_rooms(seed):
    agent = DifferentialDrive(v_max_m_s=2.0, w_max_rad_s=1.5)
    problem = Scenario(
        tau_s=0.5, agent=agent, scenes=HALL, obstacles=RoomObstacles(maps=4, test_maps=0, seed=seed)
    ).problem()

    def go(key):
        which, starts, ends = jax.random.split(key, 3)
        here = problem.of_map(jax.random.randint(which, (), 0, 4))
        places = jax.random.uniform(starts, (24, 2), minval=-8.0, maxval=8.0)
        assert here.obstacles is not None
        start = here.obstacles.free_place(places, here.obstacles.radius)
        end = reachable(here, jax.random.uniform(ends, (1, 2), minval=-8.0, maxval=8.0))[0]

        def step(pose, _):
            action = steer_to(here, pose, end, 0.0, None)
            after, touches = here.among_obstacles(pose, action, here.agent.move(pose, action, here.tau))
            return after, (jnp.linalg.norm(after[:2] - end), touches)

        return jax.lax.scan(step, jnp.append(start, 0.0), None, 70)[1]

    away, touches = jax.jit(jax.vmap(go))(jax.random.split(jax.random.key(seed), 60))
    assert (np.asarray(away).min(axis=1) < 0.5).all()
    assert np.asarray(touches).mean() < 0.05


# A robot that looks 3 m far and keeps 1 m off targets that stand still; the third is behind the first two.
ROW = Scenario(
    agent=DifferentialDrive(v_max_m_s=2.0, w_max_rad_s=1.5),
    view=TriangleView(depth_m=3.0, angle_deg=90.0),
    keep_off_m=1.0,
    scenes=replace(HALL, targets_min=3, targets_max=3, drift_m_s=(0.0, 0.0), steps=60),
)


def gaps_to_last(policy, y):
    """Distances to the third target along an episode."""
    scene = Scene(id="a", agent=(-4.0, 0.0, 0.0), targets=((0.0, 0.0), (0.7, 0.2), (6.0, y)), horizon=60)
    problem = ROW.problem()
    episode = jax.tree.map(lambda x: x[0], scene_episodes(problem, ROW.scenes, [scene], 0, 1))
    trace = eqx.filter_jit(rollout)(problem, policy, episode, TRUE, jax.random.key(0))
    return np.linalg.norm(np.asarray(trace.pose)[:, :2] - [6.0, y], axis=-1)


class Shown(Policy):
    """A rule that is shown the last target only, as a robot in a team is that follows that one."""

    rule: Policy
    blocking: tuple = eqx.field(static=True)

    def __call__(self, observation, memory, key):
        last = jnp.array([False, False, True])
        return self.rule(replace(observation, present=last, blocking=jnp.array(self.blocking)), memory, key)


@pytest.mark.parametrize("name", ["uncertain", "price", "window", "any"])
@pytest.mark.parametrize("y", [0.0, 0.3, -0.6])
def test_robots_get_past_targets_that_they_keep_off(name, y):
    """Straight on they would stand before the first target for ever: it is in the middle of the way to the third."""
    rule = load("any").for_scenario(ROW).network if name == "any" else heuristic_in(ROW, name)
    assert gaps_to_last(Shown(rule, (True, True, True)), y=y).min() < 3.0
    assert gaps_to_last(Shown(rule, (False, False, True)), y=y).min() > 4.0, "else nothing stands in the way"
