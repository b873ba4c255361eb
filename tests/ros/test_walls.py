"""A node in a map: commands against shapely, cells of the message, and decisions against those in a scenario."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from helpers.ros import PLANE, Watched, odometry
from PIL import Image

import foveate
from foveate.errors import InputError
from foveate.experiment.presets import PRESETS
from foveate.io.occupancy import OccupancyGrid
from foveate.ros.messages import map_of
from foveate.ros.model import load_model
from foveate.ros.records import Map
from foveate.scenario.obstacles import OccupancyObstacles

CELL, LOW = 0.1, np.array([-4.0, -3.0])
WALLS = shapely.union_all([shapely.box(1.0, -1.0, 1.2, 2.0), shapely.box(-2.0, 1.5, 0.0, 1.8)])


def room(frame: str = "odom") -> Map:
    """8 m x 6 m of cells, occupied where their middles are in a wall."""
    x, y = np.meshgrid(LOW[0] + CELL * (np.arange(80) + 0.5), LOW[1] + CELL * (np.arange(60) + 0.5), indexing="ij")
    return Map(frame, OccupancyGrid(shapely.contains_xy(WALLS, x, y), LOW, CELL))


def arc(pose, twist, tau, count=50):
    """Places of a robot that drives at constant speed and turn rate."""
    t = np.linspace(0.0, tau, count)
    v, w = twist[0], twist[5]
    yaw = pose[2] + w * t
    if abs(w) < 1e-6:
        return pose[:2] + v * t[:, None] * [np.cos(pose[2]), np.sin(pose[2])], yaw[-1]
    x, y = (np.sin(yaw) - np.sin(pose[2])) / w, (np.cos(pose[2]) - np.cos(yaw)) / w
    return pose[:2] + v * np.stack([x, y], axis=1), yaw[-1]


def test_a_robot_that_obeys_keeps_off_the_walls():
    """A policy that only wants ahead and to the right, from several places; a command that is free is untouched."""
    watched = Watched(command=(2.0, -0.3), needs_map=True, robot_radius_m=0.25, keep_off_m=0.15)
    core = watched.core
    assert core.on_map(room()) is None  # before any odometry: kept
    assert core.decide(100.0).stopped == "no odometry yet"
    border = shapely.box(*LOW, *-LOW).exterior
    now, shortened = 100.0, 0
    for pose in ([-3.0, 0.0, 0.0], [0.0, 0.2, 0.1], [-1.0, 0.3, 1.5], [2.5, -1.5, 3.0]):
        for _ in range(8):
            assert core.on_odometry(odometry(now, (*pose[:2], 0.0), (pose[2], 0.0, 0.0))) is None
            decision = core.decide(now)
            assert decision.stopped == ""
            way, yaw = arc(np.array(pose), decision.twist, PLANE.tau_s)
            line = shapely.LineString(way)
            assert min(shapely.distance(WALLS, line), shapely.distance(border, line)) >= 0.4 - 1e-3
            free, _ = arc(np.array(pose), (2.0, 0, 0, 0, 0, -0.3), PLANE.tau_s)
            room_m = min(shapely.distance(g, shapely.LineString(free)) for g in (WALLS, border))
            if room_m > 0.4 + 2 * CELL:
                np.testing.assert_allclose([decision.twist[0], decision.twist[5]], [2.0, -0.3], atol=1e-6)
            shortened += decision.twist[0] < 1.9
            pose, now = [*way[-1], yaw], now + PLANE.tau_s
    assert shortened > 3


def test_without_its_map_the_robot_stands():
    core = Watched(needs_map=True).core
    core.on_odometry(odometry(100.0))
    assert core.decide(100.1).stopped == "no map yet"
    assert "map: its frame is 'map', that of the odometry 'odom'" in str(core.on_map(room("map")))
    assert core.decide(100.1).twist == (0.0,) * 6
    assert core.on_map(room()) is None
    assert core.decide(100.1).stopped == ""
    core.on_odometry(odometry(10.0, frame="map"))  # the clock of a bag that begins again, and another frame
    assert core.decide(10.0).stopped == "no map yet"
    flying = Watched(PRESETS["quadrotor"].scenario, ("vx", "vy", "vz", "wz"), (0.0,) * 4).core
    flying.on_odometry(odometry(100.0))
    assert flying.on_map(room()) == "map: a robot in space: expected one that drives, for a map of the plane"


def message(cells, width, height, resolution=0.5, turn=0.0, x=-1.0):
    """As nav_msgs/OccupancyGrid: rows from the origin up."""
    place = SimpleNamespace(x=x, y=2.0, z=0.0)
    turned = SimpleNamespace(x=0.0, y=0.0, z=np.sin(turn / 2), w=np.cos(turn / 2))
    origin = SimpleNamespace(position=place, orientation=turned)
    info = SimpleNamespace(resolution=resolution, width=width, height=height, origin=origin)
    return SimpleNamespace(header=SimpleNamespace(frame_id="map"), info=info, data=cells)


def test_cells_of_a_message_are_where_it_says():
    found = map_of(message([0, 100, -1, 49, 50, 0], width=3, height=2))
    assert found.frame == "map"
    np.testing.assert_array_equal(found.grid.occupied.T, [[False, True, True], [False, True, False]])
    np.testing.assert_array_equal([*found.grid.low, *found.grid.high], [-1.0, 2.0, 0.5, 3.0])
    for wrong, line in (
        (message([0, 0], 3, 2), "map: 2 cells of 0.5 m: expected 3 x 2 cells"),
        (message([0], 1, 1, resolution=0.0), "expected 1 x 1 cells, at least one, and a finite resolution > 0"),
        (message([0], 1, 1, resolution=np.inf), "a finite resolution > 0"),
        (message([], 0, 0), "at least one"),
        (message([0], 1, 1, x=np.nan), "map: its origin is nan, 2: expected finite numbers"),
        (message([0], 1, 1, turn=np.nan), "map: its origin is turned"),
        (message([0], 1, 1, turn=0.1), "map: its origin is turned"),
    ):
        with pytest.raises(InputError, match=line):
            map_of(wrong)


@pytest.mark.slow
def test_a_policy_is_told_of_the_map(tmp_path):
    """As in a scenario with the same map as a file; without it, it decides otherwise."""
    Image.fromarray(np.where(room().grid.occupied.T[::-1], 0, 254).astype(np.uint8)).save(tmp_path / "m.png")
    (tmp_path / "m.yaml").write_text(f"image: m.png\nresolution: {CELL}\norigin: [{LOW[0]}, {LOW[1]}, 0]\n")
    own = PRESETS["rooms"].scenario
    scenes = replace(own.scenes, half_side_m=(2.0, 2.0), agent_test_half_side_m=2.0)
    inside = replace(own, scenes=scenes, obstacles=OccupancyObstacles(file=str(tmp_path / "m.yaml"), targets="free"))
    model, expected = load_model("rooms"), foveate.load("rooms").for_scenario(inside)
    assert model.in_map is not None
    obstacles = inside.problem().obstacles
    assert obstacles is not None
    decide = model.in_map(obstacles)
    belief = foveate.Belief(np.array([[2.5, 0.5, 0, 0], [-1, 2.5, 0, 0]]), covariance=0.3 * np.eye(4))
    poses, change = np.array([[0.0, 0.5, 0.0], [-1.0, 0.5, 1.5], [0.5, 0.0, 0.5], [0.3, -0.5, 0.2]]), []
    for pose in poses:
        found = decide(belief, pose)
        np.testing.assert_allclose(found, expected(belief, pose), atol=1e-5)
        change.append(np.abs(found - model.decide(belief, pose)).max())
    assert max(change) > 1e-3
