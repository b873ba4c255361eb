"""A step ends at its first contact: never inside of an obstacle and never through one, by shapely on the arcs."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.episodes import rollout, training_episode

from foveate.errors import InputError
from foveate.evaluation.evaluate import evaluate, prepare
from foveate.evaluation.summary import summarise, write_result
from foveate.evaluation.summary_table import summary_table
from foveate.io.strict_json import parse_json
from foveate.models.problem import Problem
from foveate.policies.heuristics import Random, Still
from foveate.scenario.agent import DifferentialDrive, Quadrotor
from foveate.scenario.field_of_view import BallView
from foveate.scenario.obstacles import ShapeObstacles
from foveate.scenario.random_obstacles import CircleObstacles, ForestObstacles, RoomObstacles
from foveate.scenario.region import RegionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene, SceneSettings
from foveate.scenario.starts import start_box
from foveate.scenario.target import VelocityTarget
from foveate.simulation.records import SURROGATE, TRUE
from foveate.simulation.rollout import log_dets
from foveate.simulation.suites import own_suite, scene_episodes

HALL = SceneSettings(
    targets_min=2, targets_max=3, half_side_m=(6.0, 6.0), half_side_per_target_m=0.0, agent_spread=1.0, steps=40
)
CIRCLES = CircleObstacles(density_per_m2=0.1, maps=2, test_maps=0, radius_m=(0.2, 1.0), robot_radius_m=0.25)
FAST = DifferentialDrive(v_min_m_s=-3.0, v_max_m_s=9.0, w_max_rad_s=3.0)
SQUARE = ShapeObstacles(boxes=((2.0, -4.0, 3.0, 4.0),), robot_radius_m=0.25)


def unions(settings: CircleObstacles, half: float = 6.0) -> list[shapely.Geometry]:
    found = []
    for number in range(settings.maps):
        shapes = settings.shapes_in(np.random.default_rng([0, False, number]), np.full(2, -half), np.full(2, half))
        found.append(shapely.union_all([shapely.Point(s.corners[0]).buffer(s.radius, 256) for s in shapes]))
    return found


def ways(problem: Problem, poses, actions, substeps: int = 200) -> np.ndarray:
    """Places (K, substeps + 1, d) of the agent on the arcs from each pose, up to where it really came."""

    def arc(pose, action, after):
        space, twist = problem.agent.space, problem.tau * problem.agent.twist(action)
        places = jax.vmap(lambda s: space.position(space.move(pose, s * twist)))(jnp.linspace(0.0, 1.0, substeps + 1))
        end = space.position(after)
        last = jnp.argmin(jnp.sum((places - end) ** 2, axis=-1))
        return jnp.where((jnp.arange(substeps + 1) < last)[:, None], places, end)

    return np.asarray(jax.jit(jax.vmap(arc))(poses[:-1], actions, poses[1:]))


def play(scenario: Scenario, count: int, policy=Random, seed: int = 0):
    problem = scenario.problem()

    def run(key):
        episode = training_episode(problem, scenario.scenes, key, noise=True)
        return episode.map_number, episode.truth.state, rollout(problem, policy(problem), episode, TRUE, key)

    return problem, jax.jit(jax.vmap(run))(jax.random.split(jax.random.key(seed), count))


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.parametrize("bounded", [False, True])
def test_no_pose_and_no_way_is_in_an_obstacle(bounded):
    """Arcs, or the straight lines of a world with borders, of a fast robot that turns sharply."""
    region = RegionSettings(low_m=(-7.0, -7.0), high_m=(7.0, 7.0)) if bounded else None
    scenario = Scenario(agent=FAST, scenes=HALL, obstacles=CIRCLES, region=region)
    problem, (numbers, _, trace) = play(scenario, 12)
    maps = unions(CIRCLES, 7.0 if bounded else 6.0)
    for number, poses, actions in zip(numbers, trace.pose, trace.action, strict=True):
        places = np.asarray(poses[:, :2])
        way = np.linspace(places[:-1], places[1:], 50, axis=1) if bounded else ways(problem, poses, actions)
        assert shapely.distance(maps[int(number)], shapely.linestrings(way)).min() >= 0.25 - 1e-3
    contacts = np.asarray(trace.contacts)
    assert (np.diff(contacts, axis=1) >= 0).all()
    assert 20 < contacts[:, -1].sum() < 0.7 * contacts.size


@pytest.mark.exhaustive
@pytest.mark.slow
def test_targets_go_around_and_come_on():
    """They are never in an obstacle nor through one, and one that would go through a wall is still on its way."""
    target = VelocityTarget(acceleration_m2_s3=0.05, initial_velocity_variance_m2_s2=0.5)
    scenario = Scenario(scenes=replace(HALL, initial_error="consistent"), obstacles=CIRCLES, target=target)
    _, (numbers, states, trace) = play(scenario, 12, Still)
    maps, moved = unions(CIRCLES), []
    for number, places in zip(numbers, np.asarray(states)[..., :2], strict=True):
        lines = shapely.linestrings(np.stack([places[:-1], places[1:]], axis=2).reshape(-1, 2, 2))
        assert shapely.distance(maps[int(number)], shapely.points(places.reshape(-1, 2))).min() > 0
        # A target slides along an obstacle: the straight line between two instants may cut a curved one a little.
        inner = shapely.buffer(maps[int(number)], -0.15)
        assert not shapely.intersects(inner, lines).any()
        moved.append(np.linalg.norm(np.diff(places, axis=0), axis=-1).mean())
    assert np.mean(moved) > 0.3
    assert not np.asarray(trace.contacts).any()


def arcs(pose, twist, tau, count=120):
    """Places (.., count + 1, d) of a body with a constant twist in its frame and a yaw rate, by the midpoint rule."""
    d = twist.shape[-1] - 1
    yaw = pose[..., -1, None] + twist[..., -1, None] * tau * (np.arange(count) + 0.5) / count
    x, y = twist[..., 0, None], twist[..., 1, None]
    parts = [x * np.cos(yaw) - y * np.sin(yaw), x * np.sin(yaw) + y * np.cos(yaw)]
    parts += [np.broadcast_to(twist[..., i, None], yaw.shape) for i in range(2, d)]
    steps = np.concatenate([np.zeros((*yaw.shape[:-1], 1, d)), np.cumsum(np.stack(parts, -1), -2) * tau / count], -2)
    return pose[..., None, :d] + steps


def section(settings, box, number=0):
    """The obstacles of a map as shapely has them, in the horizontal section of those in space."""
    shapes = settings.shapes_in(np.random.default_rng([0, False, number]), *np.array(box))
    rings = [shapely.Polygon(s.corners) if len(s.corners) > 1 else shapely.Point(s.corners[0]) for s in shapes]
    return shapely.union_all([ring.buffer(s.radius, 256) for ring, s in zip(rings, shapes, strict=True)])


ROOMS = RoomObstacles(maps=1, test_maps=0, room_m=4.0, robot_radius_m=0.25)
WOOD = ForestObstacles(
    maps=1, test_maps=0, density_per_m2=0.04, radius_m=(0.8, 1.2), height_m=(8.0, 9.0), robot_radius_m=0.25
)
AIR = replace(HALL, centre_m=(0.0, 0.0, 3.0), half_side_m=(8.0, 8.0, 1.5), drift_m_s=(0.0,) * 3)
FLYER = Quadrotor(v_max_m_s=8.0, climb_max_m_s=0.5, yaw_rate_max_rad_s=2.0)


@functools.cache
def world(kind: str) -> Scenario:
    if kind == "rooms":
        return Scenario(agent=FAST, scenes=HALL, obstacles=ROOMS)
    view = BallView(radius_m=2.0, center_m=(1.0, 0.0, 0.0))
    return Scenario(agent=FLYER, view=view, scenes=AIR, obstacles=WOOD)


@pytest.mark.parametrize("kind", ["rooms", pytest.param("forest", marks=pytest.mark.slow)])
def test_no_step_ends_in_an_obstacle_or_leads_through_one(kind):
    """200 robots of random actions, 12 steps each: arcs by the midpoint rule, walls and trunks by shapely."""
    scenario = world(kind)
    problem, box, tau = scenario.problem(), start_box(scenario.scenes, None), scenario.tau_s
    agent, walls, d, rng = problem.agent, section(scenario.obstacles, box), scenario.dimension, np.random.default_rng(0)
    places = rng.uniform(*np.array(box), (2000, d))
    free = shapely.distance(walls, shapely.points(places[:, :2])) > 0.25 + 2.5 * scenario.obstacles.resolution_m
    places, yaws = places[free][:200], rng.uniform(-3, 3, 200)
    begin = jax.vmap(agent.space.upright)(jnp.asarray(places), jnp.asarray(yaws))
    actions = jnp.asarray(rng.uniform(-1, 1, (12, 200, len(agent.axes))))

    @jax.jit
    def play(poses, actions):
        def step(poses, actions):
            def one(pose, action):
                return problem.among_obstacles(pose, action, agent.move(pose, action, problem.tau))

            after, touches = jax.vmap(one)(poses, actions)
            return after, (poses, after, jax.vmap(agent.twist)(actions), touches)

        return jax.lax.scan(step, poses, actions)[1]

    before, after, twists, touches = play(begin, actions)
    planar = scenario.dimension == 2
    position = np.asarray(after[..., :2] if planar else after[..., :3, 3])
    start = np.asarray(before[..., :2] if planar else before[..., :3, 3])
    yaw = np.asarray(before[..., 2] if planar else jnp.arctan2(before[..., 1, 0], before[..., 0, 0]))
    twists = np.asarray(twists)
    ways = arcs(
        np.concatenate([start, yaw[..., None]], -1), np.concatenate([twists[..., :d], twists[..., -1:]], -1), tau
    )
    last = np.linalg.norm(ways - position[..., None, :], axis=-1).argmin(axis=-1)[..., None, None]
    ways = np.where(np.arange(ways.shape[-2])[:, None] < last, ways, position[..., None, :])
    # Between the ends of the trunks: what is above or below them is not in the section.
    low = -np.inf if planar else box[0][2]
    inside = np.ones(ways.shape[:2], bool) if planar else (ways[..., 2] > low).all(axis=-1)
    assert inside.mean() > 0.3
    lines = shapely.linestrings(ways[inside][..., :2])
    assert shapely.distance(walls, lines).min() >= 0.25 - 1e-3
    assert 100 < np.asarray(touches).sum() < 0.9 * touches.size
    assert np.linalg.norm(position[-1] - start[0], axis=-1).mean() > 1.0


def test_trunks_hide_and_end_rays_where_shapely_says():
    """In the horizontal section: lines that pass by more than a cell are free, that cut in by more are blocked."""
    problem, box, rng = world("forest").problem(), start_box(AIR, None), np.random.default_rng(1)
    obstacles, walls, cell = problem.obstacles, section(WOOD, box), WOOD.resolution_m
    ends = rng.uniform(*np.array(box), (2, 1500, 3))
    ends[..., 2] = rng.uniform(2.2, 4.5, (2, 1500))
    lines = shapely.linestrings(np.moveaxis(ends[..., :2], 0, 1))
    seen = np.asarray(
        jax.jit(jax.vmap(lambda eye, point: obstacles.sees(eye, point[None], jnp.array([True]))[0]))(*ends)
    )
    clear, cut = (~shapely.intersects(walls.buffer(cell), lines), shapely.intersects(walls.buffer(-cell), lines))
    assert seen[clear].all()
    assert not seen[cut].any()
    assert min(clear.sum(), cut.sum()) > 100

    angles, eyes = (
        2 * np.pi * np.arange(24) / 24,
        ends[0][shapely.distance(walls, shapely.points(ends[0][:, :2])) > cell],
    )
    directions = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    rays = jnp.asarray(directions)
    poses = jax.vmap(problem.agent.space.upright)(jnp.asarray(eyes[:100]), jnp.zeros(len(eyes[:100])))
    found = np.asarray(jax.jit(jax.vmap(lambda T: obstacles.ranges(problem.agent.space, T, rays, 6.0)))(poses))
    starts = np.broadcast_to(eyes[:100, None, :2], (*found.shape, 2))
    lines = shapely.linestrings(np.stack([starts, starts + 6.0 * directions[:, :2]], axis=2))
    met = shapely.intersection(lines, walls)
    expected = np.where(shapely.is_empty(met), 6.0, shapely.distance(shapely.points(starts), met))
    assert (found <= expected + 1e-6).all()
    assert np.median(expected - found) < 2 * cell
    assert np.ptp(found) > 3.0


def test_a_drifting_target_is_turned_by_a_wall_and_its_input_too():
    scenes = replace(HALL, jitter_m_s=0.0, process_noise=False, steps=8)
    problem = Scenario(scenes=scenes, obstacles=SQUARE).problem()
    scene = Scene(id="a", agent=(-5.0, 0.0, 0.0), targets=((0.0, 0.0),), drift=((0.8, 0.1),), horizon=8)
    episode = scene_episodes(problem, scenes, [scene], 0, 1)
    x, y = np.asarray(episode.truth.state[0, :, 0]).T
    assert x.max() < 2.0
    assert x[-1] < x.max() - 1.0
    # Along the wall it goes on as before.
    np.testing.assert_allclose(np.diff(y), 0.1, atol=1e-6)
    np.testing.assert_allclose(np.diff(x)[-1], -0.8, atol=1e-6)
    np.testing.assert_allclose(episode.inputs[0, -1, 0], [-0.8, 0.1], atol=1e-6)


def test_an_agent_at_a_wall_stays_and_turns_and_leaves():
    problem = Scenario(agent=FAST, scenes=HALL, obstacles=SQUARE).problem()
    scene = Scene(id="a", agent=(0.0, 0.0, 0.0), targets=((-4.0, 0.0),), drift=((0.0, 0.0),), horizon=40)
    episode = jax.tree.map(lambda x: x[0], scene_episodes(problem, HALL, [scene], 0, 1))

    class Drive(Random):
        """Ahead for two steps, then ahead while turning about, then away."""

        def __call__(self, observation, memory, key):
            turns = (observation.step >= 2) & (observation.step < 3)
            control = jnp.where(turns, jnp.array([9.0, 3.0]), jnp.array([9.0, 0.0]))
            return self.problem.agent.action(control), memory

    trace = rollout(problem, Drive(problem), episode, TRUE, jax.random.key(0))
    x, yaw = np.asarray(trace.pose[:, 0]), np.asarray(trace.pose[:, 2])
    assert 1.5 < x[1] < 1.75
    np.testing.assert_allclose(x[2:4], x[1], atol=0.05)
    assert yaw[3] == pytest.approx(3.0)
    assert x[4] < -5.0
    assert trace.contacts[:4].tolist() == [1, 2, 3, 3]


@pytest.mark.slow
def test_trunks_stop_a_flying_robot():
    scenes = replace(HALL, centre_m=(0.0, 0.0, 2.0), half_side_m=(5.0, 5.0, 1.5), drift_m_s=(0.0,) * 3, steps=30)
    forest = ForestObstacles(density_per_m2=0.1, maps=1, test_maps=0, radius_m=(0.3, 0.8), height_m=(2.0, 3.0))
    scenario = Scenario(
        agent=Quadrotor(v_max_m_s=6.0),
        view=BallView(radius_m=2.0, center_m=(1.0, 0.0, 0.0)),
        scenes=scenes,
        obstacles=forest,
    )
    problem, (_, _, trace) = play(scenario, 8)
    box = np.array([[-5.0, -5.0, 0.5], [5.0, 5.0, 3.5]])
    trunks = forest.shapes_in(np.random.default_rng([0, False, 0]), *box)
    for poses, actions in zip(trace.pose, trace.action, strict=True):
        places = ways(problem, poses, actions).reshape(-1, 3)
        nearest = np.min([trunk.signed_distance(places) for trunk in trunks], axis=0)
        assert nearest.min() >= forest.robot_radius_m - 1e-3
    assert np.asarray(trace.contacts)[:, -1].sum() > 3


@pytest.mark.slow
def test_the_gradient_of_a_policy_knows_the_wall():
    """The score by a number that scales the speed ahead, against finite differences, with a contact on the way."""
    scenes = replace(HALL, jitter_m_s=0.0, process_noise=False)
    scenario = Scenario(scenes=scenes, obstacles=replace(SQUARE, targets="free"))
    problem = scenario.problem()
    scene = Scene(id="a", agent=(0.0, 0.0, 0.2), targets=((2.0, 6.0),), drift=((0.0, 0.0),), horizon=3)
    episode = jax.tree.map(lambda x: x[0], scene_episodes(problem, scenes, [scene], 0, 1))

    class Turning(Random):
        turn: jax.Array

        def __call__(self, observation, memory, key):
            return jnp.stack([jnp.array(0.4), self.turn]), memory

    def score(turn):
        return log_dets(problem, Turning(problem, turn), episode, SURROGATE, jax.random.key(0))[2, 0]

    turn, step = jnp.array(0.05), 0.02
    _, found = jax.jit(jax.value_and_grad(score))(turn)
    below, above = jax.jit(jax.vmap(score))(jnp.array([turn - step, turn + step]))
    expected = (above - below) / (2 * step)
    assert abs(float(expected)) > 0.02
    assert float(found) == pytest.approx(float(expected), rel=0.15)


def test_contacts_are_reported_only_among_obstacles(tmp_path):
    scenes = replace(HALL, targets_max=2, steps=6)
    open_world = Scenario(agent=FAST, scenes=scenes)
    for scenario in (replace(open_world, obstacles=SQUARE), open_world):
        problem = scenario.problem()
        suite = prepare(problem, scenes, own_suite(scenes, problem)[:12])
        rows = evaluate(suite, "random", Random(problem), ["true"])
        summary = summarise(rows, 2)
        write_result(tmp_path / "r.json", rows, summary)
        written = parse_json((tmp_path / "r.json").read_text(encoding="utf-8"))
        table = summary_table("t", summary, None)
        has_walls = scenario.obstacles is not None
        assert ("contacts" in table.header) == has_walls
        assert all(("contacts" in entry) == has_walls for part in ("rows", "summary") for entry in written[part])
        if has_walls:
            assert summary[0].contacts == pytest.approx(np.mean([row.contacts for row in rows]))
            assert summary[0].contacts > 0


def test_without_noise_targets_cannot_go_around():
    problem = Scenario(scenes=HALL, obstacles=SQUARE).problem()
    with pytest.raises(InputError, match=r"noise = False: expected True, or obstacles\.targets = 'free'"):
        training_episode(problem, HALL, jax.random.key(0), noise=False)
