"""The robots of a team in a scene: all inside of it, each where it is, with lines between those that have heard."""

import numpy as np
import pytest
from helpers.episode_data import random_episode
from matplotlib.figure import Figure

from foveate.evaluation.evaluate import prepare
from foveate.planning.named import heuristic_in
from foveate.plotting.animation import picture
from foveate.plotting.episode_data import SUBSTEPS, suite_data
from foveate.plotting.mates import lines
from foveate.plotting.replay_figure import replay_figure
from foveate.plotting.scene import PlanarScene, limits
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.kinds import RobotSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.team import TeamSettings
from foveate.simulation.suites import own_suite

POSES = np.random.default_rng(1).normal(0, [9.0, 9.0, 1.0], (5, 2, 3))
HEARD = np.zeros((4, 3, 3), bool)
HEARD[2, 0, 1] = HEARD[2, 1, 0] = HEARD[2, 2, 0] = True


def test_every_robot_is_where_it_is_and_linked_to_whom_it_has_heard():
    data = random_episode(mates=POSES, heard=HEARD)
    box = limits([data])
    assert np.all((box[0] <= POSES[..., :2]) & (POSES[..., :2] <= box[1]))
    scene = PlanarScene(Figure().add_subplot(), data, box)
    scene.show(3 * SUBSTEPS)
    assert scene.mates is not None
    for body, path, pose in zip(scene.mates.bodies, scene.mates.paths, np.moveaxis(POSES, 1, 0), strict=True):
        np.testing.assert_allclose(np.asarray(body.get_xy()).min(axis=0) <= pose[3, :2], True)
        np.testing.assert_allclose(np.asarray(path.get_data()).T[[0, -1]], pose[[0, 3], :2], atol=1e-9)
    first, second, third = data.pose[3, :2], *POSES[3, :, :2]
    np.testing.assert_allclose(np.asarray(scene.mates.both.get_data()).T[:2], [first, second])
    np.testing.assert_allclose(np.asarray(scene.mates.one.get_data()).T[:2], [first, third])
    scene.show(0)
    assert len(np.asarray(scene.mates.both.get_data()).T) == 0


def test_every_robot_has_its_own_view():
    """The sector of each robot at its pose: the far corner is at its own depth, in the picture whole."""
    views = RobotSettings(view=SectorView(depth_m=3.0, angle_deg=90.0)), RobotSettings(view=SectorView(depth_m=12.0))
    scenario = Scenario(view=SectorView(), team=TeamSettings(agents=3, robots=views), scenes=SceneSettings(steps=3))
    problem, scenes = scenario.problem(), own_suite(scenario.scenes, scenario.problem())[:1]
    suite = prepare(problem, scenario.scenes, scenes)
    (data,) = suite_data(suite, heuristic_in(scenario, "still"), "true", "still")
    for outline, depth_m in zip(data.outlines, (3.0, 12.0, 3.0), strict=True):
        assert np.linalg.norm(outline[0], axis=1).max() == pytest.approx(depth_m)
    box = limits([data])
    scene = PlanarScene(Figure().add_subplot(), data, box)
    scene.show(SUBSTEPS)
    assert scene.mates is not None
    for (view,), pose, depth_m in zip(scene.mates.views, data.poses[1, 1:], (12.0, 3.0), strict=True):
        border = np.asarray(view.get_xy())
        assert np.linalg.norm(border - pose[:2], axis=1).max() == pytest.approx(depth_m)
        assert np.all((box[0] <= border) & (border <= box[1]))


def test_lines_have_gaps_between_pairs():
    places, pairs = np.arange(6.0).reshape(3, 2), np.ones((3, 3), bool)
    found = lines(places, pairs)
    assert np.isnan(found[2::3]).all()
    np.testing.assert_array_equal(found[[0, 1, 3, 4, 6, 7]], places[[0, 1, 0, 2, 1, 2]])


def test_a_picture_of_a_team_differs_from_that_of_its_first_robot():
    alone, team = random_episode(), random_episode(mates=POSES, heard=HEARD)
    assert np.any(picture(alone, 3 * SUBSTEPS) != picture(team, 3 * SUBSTEPS))


def test_the_figure_of_a_replay_has_every_path_and_a_row_of_the_radio_for_each_robot(tmp_path):
    data = random_episode(mates=POSES, heard=HEARD)
    figure = replay_figure({"one": data, "two": random_episode(seed=1)}, tmp_path / "a.png")
    axes = {axes.get_title(loc="left").partition(":")[0]: axes for axes in figure.axes}
    ends = [line.get_xydata()[-1] for line in figure.axes[0].get_lines()]
    for pose in (data.pose[-1], *POSES[-1]):
        assert np.nanmin([np.linalg.norm(end - pose[:2]) for end in ends]) < 1e-9
    (mesh,) = axes["others heard"].collections
    np.testing.assert_allclose(np.asarray(mesh.get_array()).reshape(3, 4), HEARD.sum(axis=2).T / 2)
    alone = replay_figure({"one": random_episode()})
    assert len(alone.axes) == len(figure.axes) - 1
