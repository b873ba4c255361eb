"""The safety filter keeps its distance by shapely, at any speed, and changes nothing that is safe already."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

import foveate
from foveate.deploy.policy import RobotPolicy
from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.policies.heuristics import Nearest, Random
from foveate.policies.keep_off import KeepOff
from foveate.scenario.agent import DifferentialDrive
from foveate.scenario.obstacles import ShapeObstacles
from foveate.scenario.random_obstacles import CircleObstacles
from foveate.scenario.region import RegionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import TRUE
from foveate.simulation.rollout import rollout
from foveate.simulation.starts import check_free
from foveate.simulation.suites import own_suite

HALL = SceneSettings(
    targets_min=2, targets_max=3, half_side_m=(8.0, 8.0), half_side_per_target_m=0.0, agent_spread=1.0, steps=40
)
CIRCLES = CircleObstacles(density_per_m2=0.06, maps=1, test_maps=0, robot_radius_m=0.2)
FAST = DifferentialDrive(v_min_m_s=-3.0, v_max_m_s=9.0, w_max_rad_s=3.0)
SCENARIO = Scenario(agent=FAST, scenes=HALL, obstacles=CIRCLES)
KEEP_M = 0.3


def union() -> shapely.Geometry:
    rng = np.random.default_rng([0, False, 0])
    shapes = CIRCLES.shapes_in(rng, np.full(2, -8.0), np.full(2, 8.0))
    return shapely.union_all([shapely.Point(shape.corners[0]).buffer(shape.radius, 256) for shape in shapes])


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.parametrize("wild", [True, False])
def test_no_way_comes_nearer_than_it_may(wild):
    """Of episodes that begin far enough away; all whole arcs, as none is ended by a contact."""
    problem = SCENARIO.problem()
    policy = KeepOff(Random(problem) if wild else Nearest(problem, 0.5), problem, KEEP_M)

    def run(key):
        trace = rollout(problem, policy, training_episode(problem, HALL, key, noise=True), TRUE, key)
        twists = problem.tau * jax.vmap(problem.agent.twist)(trace.action)
        space, share = problem.agent.space, jnp.linspace(0.0, 1.0, 101)
        arc = jax.vmap(lambda pose, twist: jax.vmap(lambda s: space.move(pose, s * twist)[:2])(share))
        return trace.pose, trace.contacts, arc(trace.pose[:-1], twists)

    poses, contacts, arcs = map(np.asarray, jax.jit(jax.vmap(run))(jax.random.split(jax.random.key(0), 24)))
    walls = union()
    first = shapely.distance(walls, shapely.points(poses[:, 0, :2]))
    fit = first > CIRCLES.robot_radius_m + KEEP_M + 0.45
    assert fit.sum() > 8
    nearest = shapely.distance(walls, shapely.linestrings(arcs[fit]))
    assert nearest.min() >= CIRCLES.robot_radius_m + KEEP_M - 1e-3
    assert not contacts[fit].any()
    assert np.linalg.norm(np.diff(poses[fit, :, :2], axis=1), axis=-1).mean() > (0.5 if wild else 0.05)


def test_a_safe_action_stays_and_one_into_a_wall_is_shortened_or_turned():
    wall = ShapeObstacles(boxes=((2.0, -6.0, 3.0, 6.0),), robot_radius_m=0.2)
    problem = replace(SCENARIO, obstacles=wall).problem()
    safe = KeepOff(Random(problem), problem, KEEP_M)

    @jax.jit
    def shortened(pose, control):
        return problem.agent.control(safe.shortened(pose, problem.agent.action(control)))

    def after(x, v, w):
        return np.asarray(shortened(np.array([x, 0.0, 0.0]), np.array([v, w])))

    np.testing.assert_allclose(after(-6.0, 4.0, 0.5), [4.0, 0.5], atol=1e-6)
    np.testing.assert_allclose(after(0.0, -3.0, 0.5), [-3.0, 0.5], atol=1e-6)
    v, w = after(0.0, 9.0, 0.3)
    assert 1.2 < v < 1.5
    assert w / v == pytest.approx(0.3 / 9.0, rel=1e-5)
    np.testing.assert_allclose(after(1.39, 9.0, 2.0), [0.0, 2.0], atol=1e-6)


def arcs(starts, controls, count=200):
    """Places (n, count + 1, 2) of robots at constant speed and turn rate for a second, in closed form."""
    (x, y, yaw), (v, w) = np.asarray(starts, float).T, np.asarray(controls, float).T
    t = np.linspace(0.0, 1.0, count + 1)[:, None]
    half = 0.5 * w * t  # the chord of an arc is v t sinc(w t / 2), at half its turn
    chord = v * t * np.sinc(half / np.pi)
    return np.stack([x + chord * np.cos(yaw + half), y + chord * np.sin(yaw + half)], axis=-1).swapaxes(0, 1)


KEEPING = replace(SCENARIO, tau_s=1.0, obstacles=replace(CIRCLES, keep_off_m=KEEP_M))


def test_in_a_scenario_that_keeps_off_no_action_leads_too_near():
    """300 robots, 4 random actions each: all arcs, from where robots are far enough away."""
    problem, rng, walls = KEEPING.problem(), np.random.default_rng(1), union()
    places = rng.uniform(-8.0, 8.0, (1500, 2))
    needed = CIRCLES.robot_radius_m + KEEP_M + 2.5 * CIRCLES.resolution_m
    poses = places[shapely.distance(walls, shapely.points(places)) > needed][:300]
    poses = np.column_stack([poses, rng.uniform(-3.0, 3.0, len(poses))])

    @jax.jit
    @jax.vmap
    def move(pose, action):
        short = problem.kept_off(pose, action)
        return problem.move(pose, action, None), problem.agent.control(short)

    nearest, stopped = [], 0
    for _ in range(4):
        actions = rng.uniform(-1.0, 1.0, (len(poses), 2))
        after, controls = map(np.asarray, move(poses, actions))
        ways = arcs(poses, controls)
        np.testing.assert_allclose(after[:, :2], ways[:, -1], atol=1e-4)  # to its end: nothing is in the way
        nearest.append(shapely.distance(walls, shapely.linestrings(ways)).min())
        stopped += int((controls[:, 0] == 0).sum())
        poses = after
    assert len(poses) == 300
    assert min(nearest) >= CIRCLES.robot_radius_m + KEEP_M - 1e-3
    assert 0 < stopped < 400


@pytest.mark.slow
def test_an_episode_in_it_has_no_contact_and_records_what_was_done():
    def run(key):
        problem = KEEPING.problem()
        return rollout(problem, Random(problem), training_episode(problem, HALL, key, noise=True), TRUE, key)

    trace = jax.jit(jax.vmap(run))(jax.random.split(jax.random.key(0), 8))
    assert not np.asarray(trace.contacts).any()
    agent = KEEPING.problem().agent
    controls = np.asarray(jax.vmap(jax.vmap(agent.control))(trace.action))
    poses = np.asarray(trace.pose)
    ends = arcs(poses[:, :-1].reshape(-1, 3), controls.reshape(-1, 2))[:, -1]
    np.testing.assert_allclose(poses[:, 1:, :2].reshape(-1, 2), ends, atol=1e-4)


def test_its_starts_and_ways_keep_the_distance_too():
    """A wall with a door of 1.2 m at y = 0, which a robot of 0.4 m that keeps 0.6 m does not go through."""
    wall = ShapeObstacles(boxes=((-0.2, -20.0, 0.2, -0.6), (-0.2, 0.6, 0.2, 5.0)))
    eye, end = jnp.array([-3.0, 0.0]), jnp.array([[3.0, 0.0]])
    for keep_off_m, least, most in ((0.0, 5.9, 6.6), (0.6, 13.0, 17.0)):
        obstacles = replace(SCENARIO, obstacles=replace(wall, keep_off_m=keep_off_m)).problem().obstacles
        assert obstacles is not None
        assert least < float(obstacles.ways_to(eye, end, 0.0).length[0]) < most

    problem, walls = KEEPING.problem(), union()
    starts = [scene.agent[:2] for scene in own_suite(HALL, problem)]
    assert shapely.distance(walls, shapely.points(np.array(starts))).min() >= CIRCLES.robot_radius_m + KEEP_M
    shape = CIRCLES.shapes_in(np.random.default_rng([0, False, 0]), np.full(2, -8.0), np.full(2, 8.0))[0]
    place = shape.corners[0] + [shape.radius + 0.45, 0.0]
    with pytest.raises(InputError, match=r"agent = .* expected at least 0\.7"):
        check_free(problem, [replace(own_suite(HALL, problem)[0], agent=(*place.tolist(), 0.0))])


def test_a_robots_command_is_shortened_in_it():
    """Of random policies that want ahead, 0.35 m and a margin before a wall; in the open none is."""
    wall = ShapeObstacles(boxes=((2.0, -6.0, 3.0, 6.0),), robot_radius_m=0.2)
    agent, belief = DifferentialDrive(v_min_m_s=0.0, v_max_m_s=2.0), foveate.Belief([[3.5, 0.0]], covariance=np.eye(2))
    commands = []
    for obstacles in (replace(wall, keep_off_m=0.0), wall):
        scenario = replace(SCENARIO, agent=agent, obstacles=obstacles)
        network = Random(scenario.problem())
        policy = RobotPolicy(name="random", experiment=Experiment(scenario=scenario), network=network, seed=1)
        commands.append(policy(belief, [1.3, 0.0, 0.0]))
    assert commands[1][0] > 0.8
    way = shapely.linestrings(arcs([[1.3, 0.0, 0.0]], [commands[0]]))[0]
    assert 0.2 <= shapely.distance(shapely.box(2.0, -6.0, 3.0, 6.0), way) < 0.5


BAD = {
    "no obstacles": (replace(SCENARIO, obstacles=None), KEEP_M, "problem.obstacles = None"),
    "negative": (SCENARIO, -1.0, "keep_off_m = -1.0: expected >= 0"),
    "no number": (SCENARIO, float("nan"), "keep_off_m = nan: expected >= 0"),
    "always ahead": (
        replace(SCENARIO, agent=DifferentialDrive(v_min_m_s=1.0)),
        KEEP_M,
        "expected limits that allow to stand still",
    ),
    "commands": (
        replace(SCENARIO, agent=DifferentialDrive(commands=((0.0, 0.0), (1.0, 0.0)))),
        KEEP_M,
        "agent.commands: expected none",
    ),
    "borders": (
        replace(SCENARIO, region=RegionSettings(low_m=(-9.0, -9.0), high_m=(9.0, 9.0))),
        KEEP_M,
        "region.agent: expected 'free'",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_kept_is_one_line(name):
    scenario, keep_off_m, words = BAD[name]
    problem = scenario.problem()
    with pytest.raises(InputError) as caught:
        KeepOff(Random(problem), problem, keep_off_m)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_loaded_policy_is_wrapped_as_its_network():
    policy = foveate.load("any").for_scenario(SCENARIO)
    safe = KeepOff(policy, SCENARIO.problem(), KEEP_M)
    assert safe.policy is policy.network
    with pytest.raises(InputError, match="policy = 'nearest': expected one of foveate"):
        KeepOff("nearest", SCENARIO.problem(), KEEP_M)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"pose": [0.0, 0.0], "action": [1.0, 0.0]}, "pose = "),
        ({"pose": [0.0, 0.0, 0.0], "action": [1.0]}, "action = "),
        ({"pose": [0.0, 0.0, 0.0], "action": [1.0, 0.0], "map_number": 1}, "map_number = 1: expected 0 to 0"),
    ],
)
def test_a_pose_that_does_not_fit_is_one_line(given, words):
    problem = SCENARIO.problem()
    with pytest.raises(InputError, match=words) as caught:
        KeepOff(Random(problem), problem, KEEP_M).shortened(**given)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["always ahead", "commands", "borders"])
def test_a_scenario_that_cannot_keep_off_is_one_line(name):
    scenario, _, words = BAD[name]
    with pytest.raises(InputError) as caught:
        replace(scenario, obstacles=replace(CIRCLES, keep_off_m=0.1))
    assert str(caught.value).startswith("obstacles.keep_off_m: ")
    assert words in str(caught.value)
    with pytest.raises(InputError, match="keep_off_m"):
        replace(CIRCLES, keep_off_m=-0.1)
