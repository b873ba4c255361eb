"""Check that no agent enters an obstacle, and measure what obstacles cost.

    python experiments/obstacles.py [--maps 100] [--episodes 500] [--steps 100] [--kinds circles rooms streets forest]
    python experiments/obstacles.py --cost

The first form plays random actions, heuristics and the trained policy `rooms` over random maps with a robot that is
fast and turns sharply, and looks for every step with shapely whether the arc that the agent went, or a target, came too
near to an obstacle. In a forest it looks in the horizontal section, above the ground on which the trunks stand; they
are taller than the robot flies, and `rooms`, a policy of the plane, is not played there. The second times a step of
1024 environments with a map of 256 x 256 cells and 32 rays each, over one without.
"""

import argparse
import time
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import shapely

from foveate.evaluation.held_out import OneOf
from foveate.experiment.resolve import load
from foveate.geometry.shapes import Shape
from foveate.geometry.sight import fan
from foveate.planning.named import heuristic_policy
from foveate.scenario.agent import DifferentialDrive, Quadrotor
from foveate.scenario.field_of_view import FrustumView
from foveate.scenario.random_obstacles import CircleObstacles, ForestObstacles, RoomObstacles, StreetObstacles
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.starts import start_box
from foveate.simulation.environment import Environment, reset, step
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import TRUE
from foveate.simulation.rollout import rollout

HALL = SceneSettings(
    targets_min=3, targets_max=6, half_side_m=(12.0, 12.0), half_side_per_target_m=0.0, agent_spread=1.0
)
AIR = replace(HALL, centre_m=(0.0, 0.0, 3.0), half_side_m=(12.0, 12.0, 1.5), drift_m_s=(0.8, 0.8, 0.1))
FLYER = Quadrotor(v_max_m_s=8.0, climb_max_m_s=1.0, yaw_rate_max_rad_s=3.0)
ROBOT = DifferentialDrive(v_min_m_s=-2.0, v_max_m_s=8.0, w_max_rad_s=3.0)
KINDS = {"circles": CircleObstacles, "rooms": RoomObstacles, "streets": StreetObstacles, "forest": ForestObstacles}
METHODS = ("random", "nearest", "price", "rooms")
ARC_POINTS, BATCH, TOLERANCE_M = 33, 100, 0.01
ENVIRONMENTS, RAYS, RANGE_M = 1024, 32, 8.0


def geometry(shape: Shape) -> shapely.Geometry:
    """A shape as shapely has it."""
    if len(shape.corners) == 1:
        return shapely.Point(shape.corners[0]).buffer(shape.radius, 64)
    return shapely.Polygon(shape.corners)


def trees(obstacles, box) -> list[shapely.STRtree]:
    """The obstacles of every training map, drawn as the scenario draws them."""
    low, high = np.array(box)
    rngs = [np.random.default_rng([obstacles.seed, False, number]) for number in range(obstacles.maps)]
    return [shapely.STRtree([geometry(shape) for shape in obstacles.shapes_in(rng, low, high)]) for rng in rngs]


def world(kind: str, maps: int, steps: int) -> Scenario:
    """A fast robot that turns sharply among random obstacles of a kind."""
    if kind != "forest":
        scenes = replace(HALL, steps=steps)
        return Scenario(agent=ROBOT, scenes=scenes, obstacles=KINDS[kind](maps=maps, test_maps=0))
    # Of a robot that flies no higher than the trunks: those are in the section of all its ways.
    tall = ForestObstacles(maps=maps, test_maps=0, height_m=(500.0, 500.0))
    return Scenario(agent=FLYER, view=FrustumView(), scenes=replace(AIR, steps=steps), obstacles=tall)


def check(kind: str, maps: int, episodes: int, steps: int) -> None:
    """Play, and print for every method the numbers of steps, contacts, and violations of agent and targets."""
    scenario = world(kind, maps, steps)
    obstacles, methods = scenario.obstacles, METHODS if scenario.dimension == 2 else METHODS[:3]
    problem, forest = scenario.problem(), trees(obstacles, start_box(scenario.scenes, None))
    depth_m, ground = float(scenario.view.depth_m), start_box(scenario.scenes, None)[0][-1]
    given = [load(m)[1] if m == "rooms" else heuristic_policy(m, problem, depth_m) for m in methods]

    def arc(pose, action, after):
        """Places on the way of a step, up to where the agent really came."""
        twist, space = problem.tau * problem.agent.twist(action), problem.agent.space
        share = jnp.linspace(0.0, 1.0, 8 * (ARC_POINTS - 1) + 1)
        places = jax.vmap(lambda s: space.position(space.move(pose, s * twist)))(share)
        last = space.position(after)
        end = share[jnp.argmin(jnp.sum((places - last) ** 2, axis=-1))]
        way = jax.vmap(lambda s: space.position(space.move(pose, s * end * twist)))(share[::8])
        return way.at[-1].set(last)

    @eqx.filter_jit
    def play(problem, policies, which, keys):
        policy = OneOf(policies, which)

        def run(key):
            episode = training_episode(problem, scenario.scenes, key, noise=True)
            trace = rollout(problem, policy, episode, TRUE, key)
            ways = jax.vmap(arc)(trace.pose[:-1], trace.action, trace.pose[1:])
            targets = episode.truth.state[1:, :, : scenario.dimension]
            return episode.map_number, ways, trace.contacts[-1], targets, episode.present

        return jax.vmap(run)(keys)

    for which, method in enumerate(methods):
        entered = inside = contacts = 0
        for first in range(0, episodes, BATCH):
            keys = jax.random.split(jax.random.key(first), BATCH)
            played = play(problem, tuple(given), jnp.array(which), keys)
            numbers, ways, touched, targets, present = map(np.asarray, played)
            contacts += touched.sum()
            for number, lines, places, real in zip(numbers, ways, targets, present, strict=True):
                lines = lines[(lines[..., 2:] > ground).all(axis=(1, 2))][..., :2]  # beside the trunks
                near = {"predicate": "dwithin", "distance": obstacles.robot_radius_m - TOLERANCE_M}
                entered += len(np.unique(forest[number].query(shapely.linestrings(lines), **near)[0]))
                places = places[:, real].reshape(-1, scenario.dimension)
                points = shapely.points(places[(places[:, 2:] > ground).all(axis=1), :2])
                inside += len(np.unique(forest[number].query(points, predicate="intersects")[0]))
        total = -(-episodes // BATCH) * BATCH * steps
        found = f"{contacts:8} contacts; in obstacles {entered:4} ways, {inside:4} targets"
        print(f"{kind:8} {method:8} {total:9} steps, {found}", flush=True)


def cost(repeats: int = 40) -> None:
    """Time a step in microseconds an environment, without obstacles and with them, in turn."""
    walls = RoomObstacles(maps=1, test_maps=0, resolution_m=26.0 / 256)
    bare = Scenario(scenes=HALL)
    rays = jnp.asarray(fan(RAYS, 2), jnp.float32)
    calls = []
    for scenario in (bare, replace(bare, obstacles=walls)):
        environment = Environment(scenario.problem(), scenario.scenes, TRUE, True)
        keys = jax.random.split(jax.random.key(0), ENVIRONMENTS)
        states = eqx.filter_jit(lambda keys, e=environment: jax.vmap(lambda key: reset(e, key))(keys))(keys)

        def one(environment, state, action):
            after, made = step(environment, state, action)
            obstacles, pose = environment.problem.obstacles, after.predicted.pose
            if obstacles is None:
                return made.reward, after.predicted.mean
            space = environment.problem.agent.space
            return made.reward, after.predicted.mean, obstacles.ranges(space, pose, rays, RANGE_M)

        run = eqx.filter_jit(lambda e, s, a, one=one: jax.vmap(one, (None, 0, 0))(e, s, a))
        actions = jax.random.uniform(jax.random.key(1), (ENVIRONMENTS, 2), minval=-1.0)
        calls.append(lambda run=run, e=environment, s=states, a=actions: jax.block_until_ready(run(e, s, a)))
    times = np.zeros((repeats, 2))
    for row in range(-3, repeats):  # the first ones compile, and are overwritten
        for i, call in enumerate(calls):
            start = time.perf_counter()
            call()
            times[row, i] = time.perf_counter() - start
    # The least: other programs on the machine only add to it.
    without, with_ = 1e6 * times.min(axis=0) / ENVIRONMENTS
    print(
        f"a step: {without:.2f} us without, {with_:.2f} us with obstacles and {RAYS} rays: {with_ / without:.2f} times"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cost", action="store_true")
    for name, default in (("maps", 100), ("episodes", 500), ("steps", 100)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    options = parser.parse_args()
    if options.cost:
        cost()
    else:
        for kind in options.kinds:
            check(kind, options.maps, options.episodes, options.steps)
