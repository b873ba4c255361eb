"""What obstacles hide is not measured, not weighed, and not taken for absent; without them there is no such stage."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.episodes import rollout

from foveate.models.problem import Problem
from foveate.models.sensor import Softness, detection_weight
from foveate.policies.heuristics import Random, Still
from foveate.scenario.agent import DifferentialDrive
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.obstacles import ShapeObstacles
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene, SceneSettings
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import DriftTarget
from foveate.simulation.draft import positions_body
from foveate.simulation.records import SURROGATE, TRUE, Protocol
from foveate.simulation.rollout import weights
from foveate.simulation.step import instants, stages
from foveate.simulation.suites import scene_episodes

WALL = ShapeObstacles(boxes=((3.0, -1.0, 4.0, 6.0),), targets="free")
SCENES = SceneSettings(targets_min=1, targets_max=4, jitter_m_s=0.0, process_noise=False, steps=4)
SCENARIO = Scenario(
    view=SectorView(depth_m=8.0, angle_deg=120.0), scenes=SCENES, obstacles=WALL, target=DriftTarget(process_std_m=0.05)
)
SCENE = Scene(
    id="a",
    agent=(0.0, 0.0, 0.0),
    # Before the wall, behind it, past its lower end, and out of the view.
    targets=((2.0, 0.5), (6.0, 0.0), (5.0, -3.5), (-3.0, 0.0)),
    drift=((0.0, 0.0),) * 4,
    horizon=4,
)


def episode_of(problem: Problem):
    return jax.tree.map(lambda x: x[0], scene_episodes(problem, SCENES, [SCENE], 0, 1))


def test_a_target_behind_a_wall_is_not_measured():
    problem = SCENARIO.problem()
    open_world = replace(problem, obstacles=None)
    for each, expected in ((problem, [True, False, True, False]), (open_world, [True, True, True, False])):
        trace = rollout(each, Still(each), episode_of(problem), TRUE, jax.random.key(0))
        assert trace.visible.tolist() == [expected] * 4


def test_measured_targets_are_those_that_shapely_sees():
    """A random drive: in view by the field of view, with no wall across the line."""
    problem = replace(SCENARIO, agent=DifferentialDrive(v_max_m_s=0.1, w_max_rad_s=1.5)).problem()
    scene = replace(SCENE, horizon=60)
    episode = jax.tree.map(lambda x: x[0], scene_episodes(problem, SCENES, [scene], 0, 1))
    trace = rollout(problem, Random(problem), episode, TRUE, jax.random.key(1))
    wall = shapely.box(3.0, -1.0, 4.0, 6.0)
    near = 0
    poses, truth = trace.pose[1:], episode.truth.state[1:]
    views = jax.jit(jax.vmap(lambda *each: problem.sensor.view.contains(positions_body(problem, *each))))(poses, truth)
    shown = map(np.asarray, (poses, truth, trace.visible, views))
    for pose, states, visible, in_view in zip(*shown, strict=True):
        lines = shapely.linestrings([[pose[:2], state] for state in states])
        gap = shapely.distance(wall, lines)
        seen = in_view & (gap > 0.1)
        assert (visible[gap > 0.1] == seen[gap > 0.1]).all()
        inner = shapely.intersects(shapely.box(3.1, -0.9, 3.9, 5.9), lines)
        assert not visible[inner].any()
        near += seen.sum()
    assert near > 10


def test_the_soft_weight_is_that_of_the_view_times_that_of_the_sight():
    problem, level = SCENARIO.problem(), Softness(2.0, 0.3)
    protocol = Protocol(levels=(level,))
    episode = episode_of(problem)
    found = eqx.filter_jit(weights)(problem, Still(problem), episode, protocol, jax.random.key(0))
    bare = eqx.filter_jit(weights)(
        replace(problem, obstacles=None), Still(problem), episode, protocol, jax.random.key(0)
    )
    samples = np.linspace(0, 1, 2000)[:, None, None] * np.asarray(SCENE.targets)
    wall = shapely.box(3.0, -1.0, 4.0, 6.0)
    where = shapely.points(samples)
    outside, inside = shapely.distance(wall, where), shapely.distance(wall.boundary, where)
    least = np.where(shapely.contains(wall, where), -inside, outside).min(axis=0) - 0.05
    expected = np.asarray(bare[0]) * np.asarray(detection_weight(jnp.asarray(-least), Softness(0.0, 0.3)))
    # The means err by the first measurement, and the distances by half a cell.
    np.testing.assert_allclose(found[0], expected, atol=0.25)
    assert float(found[0, 1]) < 0.1 < 0.9 < float(found[0, 0])


def test_looking_at_a_wall_is_no_evidence_of_absence():
    """The belief about the target behind the wall grows as if nobody had looked; before the wall it is cut."""
    sensor = SensorSettings(missed_detections="used")
    target = DriftTarget(process_std_m=0.05, initial_variance_m2=0.5)
    # So narrow that the wall hides all of it beyond.
    scenario = replace(SCENARIO, sensor=sensor, target=target, view=SectorView(depth_m=8.0, angle_deg=30.0))
    # The truth is elsewhere: both beliefs, before and behind the wall, are looked for in vain.
    scene = replace(SCENE, targets=((2.0, 0.6), (6.5, 1.5)), drift=((0.0, 0.0),) * 2)
    problem = scenario.problem()
    episode = jax.tree.map(lambda x: x[0], scene_episodes(problem, SCENES, [scene], 0, 1))
    away = jnp.full_like(episode.truth.state, -20.0)
    episode = replace(episode, truth=replace(episode.truth, state=away))

    def last(problem):
        trace = rollout(problem, Still(problem), episode, TRUE, jax.random.key(0))
        return np.asarray(trace.mean[-1]), np.asarray(trace.information[-1])

    walled, bare = last(problem), last(replace(problem, obstacles=None))
    blind = last(replace(problem, obstacles=None, sensor=replace(problem.sensor, uses_missed_detections=False)))
    np.testing.assert_allclose(walled[0][1], blind[0][1], atol=1e-6)
    np.testing.assert_allclose(walled[1][1], blind[1][1], rtol=1e-6)
    assert np.linalg.norm(bare[0][1] - blind[0][1]) > 0.1
    assert np.linalg.norm(walled[0][0] - blind[0][0]) > 0.1


@pytest.mark.parametrize("protocol", [TRUE, SURROGATE])
def test_a_world_without_obstacles_has_no_stage_for_them(protocol):
    problem = SCENARIO.problem()
    instant = jax.tree.map(lambda x: x[0], instants(episode_of(problem)))

    def names(problem):
        return [stage.__name__ for stage in stages(problem, protocol, instant)]

    more = [name for name in names(problem) if name not in names(replace(problem, obstacles=None))]
    assert "hide" in more
    assert ("weigh_sight" in more) == bool(protocol.levels)
