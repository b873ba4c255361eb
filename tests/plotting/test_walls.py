"""Outlines of obstacles, and the part of a view that they leave, against shapely; pictures of worlds with walls."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from PIL import Image

from foveate.evaluation.evaluate import prepare
from foveate.geometry.numpy_poses import placed
from foveate.plotting.animation import animate
from foveate.plotting.episode_data import suite_data
from foveate.plotting.figures import trajectory_figure
from foveate.plotting.walls import lit, loops, walls_of
from foveate.policies.heuristics import Nearest
from foveate.scenario.agent import Quadrotor
from foveate.scenario.field_of_view import FrustumView, SectorView
from foveate.scenario.obstacles import ShapeObstacles
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.suites import own_suite

HALL = SceneSettings(
    targets_min=2, targets_max=2, half_side_m=(5.0, 5.0), half_side_per_target_m=0.0, agent_spread=1.0, steps=4
)
SQUARE, DISC = (1.0, -2.0, 2.0, 2.0), (-2.0, 2.0, 0.8)
SCENARIO = Scenario(
    scenes=HALL, view=SectorView(depth_m=4.0), obstacles=ShapeObstacles(boxes=(SQUARE,), circles=(DISC,))
)
AIR = replace(HALL, centre_m=(0.0, 0.0, 2.0), half_side_m=(5.0, 5.0, 1.0), drift_m_s=(0.0,) * 3)
TOWER = ShapeObstacles(boxes=((1.0, -2.0, 0.0, 2.0, 2.0, 3.0),), resolution_m=0.25)
SPATIAL = Scenario(scenes=AIR, agent=Quadrotor(), view=FrustumView(), obstacles=TOWER)
UNION = shapely.union_all([shapely.box(*SQUARE), shapely.Point(DISC[:2]).buffer(DISC[2])])


def test_outlines_are_those_of_the_shapes():
    walls = walls_of(SCENARIO.problem())
    found = shapely.union_all([shapely.Polygon(loop) for loop in loops(walls)])
    assert shapely.symmetric_difference(found, UNION).area < 0.02 * UNION.area
    assert walls_of(replace(SCENARIO, obstacles=None).problem()) is None


def test_in_space_they_are_cuts_at_several_heights():
    found = loops(walls_of(SPATIAL.problem()))
    heights = {float(loop[0, 2]) for loop in found}
    assert len(heights) >= 2
    assert all(-0.01 < height < 3.01 for height in heights)
    for loop in found:
        assert np.ptp(loop[:, 2]) == 0
        assert shapely.symmetric_difference(shapely.Polygon(loop[:, :2]), shapely.box(1, -2, 2, 2)).area < 0.4


def test_what_obstacles_leave_of_a_view_is_what_can_be_seen():
    problem = SCENARIO.problem()
    walls, border = walls_of(problem), np.asarray(problem.sensor.view.outline(), float)
    rng = np.random.default_rng(0)
    for pose in (np.array([-0.5, 0.3, 0.4]), np.array([0.2, -1.0, 1.0]), np.array([-4.0, -4.0, 0.7])):
        whole, found = shapely.Polygon(placed(pose, border)), shapely.Polygon(lit(walls, pose, border)).buffer(0)
        low, high = np.array(whole.bounds).reshape(2, 2)
        points = rng.uniform(low, high, (3000, 2))
        lines = shapely.linestrings(np.stack(np.broadcast_arrays(pose[:2], points), axis=1))
        expected = shapely.contains(whole, shapely.points(points)) & ~shapely.intersects(UNION, lines)
        assert (shapely.contains(found, shapely.points(points)) != expected).mean() < 0.03


def test_a_view_that_looks_on_from_outside_is_left_whole():
    away = np.array([[1.0, -1.0], [2.0, -1.0], [2.0, 1.0], [1.0, 1.0]])
    pose = np.array([0.0, 0.0, 0.0])
    found = shapely.Polygon(lit(walls_of(SCENARIO.problem()), pose, away))
    assert (
        found.equals_exact(shapely.Polygon(away), 1e-9) or found.symmetric_difference(shapely.Polygon(away)).area < 1e-9
    )


@pytest.mark.slow
@pytest.mark.parametrize("scenario", [SCENARIO, SPATIAL])
def test_pictures_show_the_walls(tmp_path, scenario):
    """They darken what the same pictures without them show, where beliefs and views lie over them too."""
    problem = scenario.problem()
    suite = prepare(problem, scenario.scenes, own_suite(scenario.scenes, problem)[:1])
    (data,) = suite_data(suite, Nearest(problem, 1.0), "true", "nearest")
    assert data.walls is not None

    def pictures(shown):
        trajectory_figure([shown], tmp_path / "t.png")
        animate(shown, tmp_path / "a.png")
        return [np.asarray(Image.open(tmp_path / name).convert("L"), int) for name in ("t.png", "a.png")]

    for with_walls, without in zip(pictures(data), pictures(replace(data, walls=None)), strict=True):
        assert (with_walls < without - 40).sum() > 200
