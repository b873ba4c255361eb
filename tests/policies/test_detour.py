"""Ways around obstacles: lengths are SciPy's shortest paths, and a robot that follows them arrives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from foveate.policies.detour import geodesic, lattice, next_place
from foveate.policies.heuristics import Nearest
from foveate.scenario.agent import DifferentialDrive
from foveate.scenario.obstacles import ShapeObstacles
from foveate.scenario.random_obstacles import RoomObstacles
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene, SceneSettings
from foveate.simulation.records import TRUE
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
ROOMS = RoomObstacles(maps=2, test_maps=0)


def test_distances_are_those_of_scipy():
    obstacles = Scenario(scenes=HALL, obstacles=ROOMS).problem().obstacles.of_map(jnp.asarray(1))
    where = lattice(obstacles)
    free, shape = np.asarray(where.free), where.free.shape
    number = np.arange(free.size).reshape(shape)
    edges = []
    for di, dj in ((1, 0), (0, 1), (1, 1), (1, -1)):
        a = np.s_[max(0, -di) : shape[0] - max(0, di), max(0, -dj) : shape[1] - max(0, dj)]
        b = np.s_[max(0, di) : shape[0] + min(0, di), max(0, dj) : shape[1] + min(0, dj)]
        both = free[a] & free[b]
        edges.append((number[a][both], number[b][both], np.full(both.sum(), float(where.pitch) * np.hypot(di, dj))))
    i, j, length = (np.concatenate(parts) for parts in zip(*edges, strict=True))
    graph = coo_matrix((length, (i, j)), shape=(free.size, free.size)).tocsr()
    # Free nodes lie outside of the hall, too.
    away = np.linalg.norm(np.asarray(where.nodes_world) - [0.5, 0.5], axis=-1)
    goal = int(np.where(free, away, np.inf).argmin())
    expected = dijkstra(graph, directed=False, indices=goal).reshape(shape)
    seeds = jnp.full(shape, jnp.inf).at[np.unravel_index(goal, shape)].set(0.0)
    found = np.asarray(jax.jit(geodesic)(where, seeds))
    np.testing.assert_allclose(np.where(free, found, np.inf), np.where(free, expected, np.inf), atol=1e-6)
    assert np.isfinite(found).mean() > 0.25


def test_the_next_place_leads_around_a_wall_and_is_the_goal_in_the_open():
    wall = ShapeObstacles(boxes=((0.0, -4.0, 0.5, 6.0),))
    obstacles = Scenario(scenes=HALL, obstacles=wall).problem().obstacles
    ask = jax.jit(next_place)
    start = jnp.array([-3.0, 0.0])
    place, direct = ask(obstacles, start, jnp.array([-3.0, 5.0]))
    assert bool(direct)
    np.testing.assert_allclose(place, [-3.0, 5.0])
    place, direct = ask(obstacles, start, jnp.array([3.0, 0.0]))
    assert not bool(direct)
    # Around the lower end of the wall, which is nearer.
    assert float(place[1]) < -3.0
    assert float(place[0]) < 0.5


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_heuristic_arrives_behind_a_wall():
    agent, target = DifferentialDrive(v_max_m_s=1.5, w_max_rad_s=2.0), (4.0, 0.0)
    wall = ShapeObstacles(boxes=((0.0, -4.0, 0.5, 7.0),))
    problem = Scenario(agent=agent, scenes=HALL, obstacles=wall).problem()
    scene = Scene(id="a", agent=(-5.0, -0.5, 0.0), targets=(target,), drift=((0.0, 0.0),), horizon=30)
    episode = jax.tree.map(lambda x: x[0], scene_episodes(problem, HALL, [scene], 0, 1))
    trace = jax.jit(lambda e: rollout(problem, Nearest(problem, 1.0), e, TRUE, jax.random.key(0)))(episode)
    assert np.linalg.norm(np.asarray(trace.pose[-1, :2]) - target) < 2.5
    assert trace.visible.any()
    assert int(trace.contacts[-1]) <= 3
