"""The node: by a stand-in of rclpy's interface and rosbags' messages; and, where rclpy is installed, on loopback."""

import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from helpers.ros import PLANE, Watched, detections, odometry

from foveate.errors import InputError
from foveate.experiment.presets import PRESETS
from foveate.ros import node as module
from foveate.ros.main import main
from foveate.ros.messages import Messages, topic_name
from foveate.ros.node import Driver
from foveate.scenario.obstacles import ShapeObstacles

pytest.importorskip("rosbags", reason="message definitions need the extra ros")
from foveate.recordings.definitions import typestore

STORE = typestore("ros2_humble")
MAKE = Messages(find=STORE.types.__getitem__)


class Node:
    """What `Driver` uses of rclpy's Node; sends through the bytes of ROS, so that wrong types fail."""

    def __init__(self, **parameters):
        self.parameters, self.now_s, self.lines = parameters, 100.0, []
        self.sent, self.subscriptions, self.timers, self.levels = {}, {}, [], {}

    def declare_parameter(self, name, default):
        return SimpleNamespace(value=self.parameters.get(name, default))

    def create_publisher(self, kind, topic, qos):
        heard = self.sent.setdefault(topic, [])
        name = kind.__msgtype__

        def publish(message):
            heard.append(STORE.deserialize_cdr(STORE.serialize_cdr(message, name), name))

        return SimpleNamespace(publish=publish)

    def create_subscription(self, kind, topic, callback, qos):
        self.subscriptions[topic] = callback

    def create_timer(self, period_s, callback):
        self.timers.append((period_s, callback))

    def get_clock(self):
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=round(self.now_s * 1e9)))

    def get_logger(self):
        return SimpleNamespace(info=partial(self.log, "info"), warning=partial(self.log, "warning"))

    def log(self, level, text):
        """As rclpy, for which a line of the source has one level."""
        caller = sys._getframe(1)
        place = (caller.f_code.co_filename, caller.f_lineno)
        if self.levels.setdefault(place, level) != level:
            raise ValueError("Logger severity cannot be changed between calls.")
        self.lines.append((level, text))


def find(name):
    return STORE.types[name]


@pytest.fixture
def watched(monkeypatch):
    policy = Watched()
    monkeypatch.setattr(module, "load_model", lambda name, number: policy.core.model)
    return policy


def test_messages_go_in_and_a_command_and_beliefs_come_out(watched):
    node = Node(policy="any")
    driver = Driver(node, find, "qos")
    assert node.timers == [(0.5, driver.step)]
    node.subscriptions["odom"](MAKE.odometry(odometry(99.9, (1, 2, 0)), (0.0,) * 6))
    node.subscriptions["detections"](MAKE.detections(detections(99.95, a=(3, 1, 0))))
    node.subscriptions["poses"](MAKE.pose_array(MAKE.header(100.0, "odom"), [(5.0, 2.0, 0.0)]))
    driver.step()
    (twist,) = node.sent["cmd_vel"]
    assert (twist.linear.x, twist.angular.z, twist.linear.y) == (1.0, -0.5, 0.0)
    np.testing.assert_allclose(watched.belief.mean, [[3, 1], [5, 2]], atol=1e-6)
    for name, x in (("a", 3), ("0", 5)):
        (belief,) = node.sent[f"beliefs/target_{name}"]
        assert (belief.header.frame_id, belief.pose.pose.position.x) == ("odom", pytest.approx(x))
    (markers,) = node.sent["beliefs/markers"]
    assert {each.ns: each.header.frame_id for each in markers.markers[1:]} == {
        "beliefs": "odom", "ids": "odom", "view": "base_link",
    }  # fmt: skip
    driver.stop()
    assert node.sent["cmd_vel"][-1].linear.x == 0.0
    assert [level for level, _ in node.lines] == ["info"]


def test_robots_of_a_team_hear_each_other(watched):
    """What one node sends on /team, as it is in bytes, is what the other takes."""
    nodes = [Node(policy="any", robot=name) for name in ("r1", "r2")]
    drivers = [Driver(node, find, "qos") for node in nodes]
    drivers[0].step()
    assert not nodes[0].sent["/team"]  # without odometry there is no frame
    for node in nodes:
        node.subscriptions["odom"](MAKE.odometry(odometry(99.9), (0.0,) * 6))
    nodes[0].subscriptions["detections"](MAKE.detections(detections(99.95, a=(3, 1, 0))))
    drivers[0].step()
    nodes[1].subscriptions["/team"](nodes[0].sent["/team"][-1])
    drivers[1].step()
    (belief,) = nodes[1].sent["beliefs/target_a"]
    assert belief.pose.pose.position.x == pytest.approx(3)
    nodes[1].subscriptions["/team"](MAKE.text("no message"))
    assert nodes[1].lines[-1][1].startswith("team: a message is no JSON")
    alone = Node(policy="any")
    Driver(alone, find, "qos").step()
    assert "/team" not in {*alone.sent, *alone.subscriptions}


def test_parameters_reach_the_core(watched):
    node = Node(stamped=True, odometry_timeout_s=0.2, gate=1.0, period_s=0.25, lag_s=2.0)
    driver = Driver(node, find, "qos", "runs/a")
    settings = driver.core.settings
    assert (settings.odometry_timeout_s, settings.gate, settings.lag_s) == (0.2, None, 2.0)
    assert node.timers[0][0] == 0.25
    assert ("warning", "watched was trained for a period of 0.5 s; it runs at 0.25 s") in node.lines
    node.subscriptions["odom"](MAKE.odometry(odometry(99.9), (0.0,) * 6))
    driver.step()
    (stamped,) = node.sent["cmd_vel"]
    assert (stamped.header.frame_id, stamped.twist.linear.x) == ("base_link", 1.0)


def test_a_policy_of_random_maps_asks_for_the_robots_own(monkeypatch):
    rooms = Watched(PRESETS["rooms"].scenario)
    monkeypatch.setattr(module, "load_model", lambda name, number: rooms.core.model)
    with pytest.raises(InputError, match="map_topic = '': expected the topic of the robot's map"):
        Driver(Node(policy="rooms"), find, "qos")


def test_a_map_is_waited_for_and_taken(watched):
    """A wall 0.3 m ahead of a robot of 0.25 m, on the topic of the parameter, as rosbags has the message."""
    node = Node(policy="any", map_topic="/map", robot_radius_m=0.25, keep_off_m=0.0)
    driver = Driver(node, find, "qos")
    node.subscriptions["odom"](MAKE.odometry(odometry(99.9), (0.0,) * 6))
    driver.step()
    assert node.lines[-1] == ("warning", "stopped: no map yet")
    cells = np.zeros((40, 40), np.int8)
    cells[:, 23:25] = 100
    header, origin = MAKE.header(99.0, "odom"), MAKE.pose((-2.0, -2.0, 0.0))
    info = find("nav_msgs/msg/MapMetaData")(
        map_load_time=header.stamp, resolution=0.1, width=40, height=40, origin=origin
    )
    node.subscriptions["/map"](find("nav_msgs/msg/OccupancyGrid")(header=header, info=info, data=cells.ravel()))
    assert node.sent["cmd_vel"][-1].linear.x == 0.0  # it stands meanwhile
    driver.step()
    assert [(each.linear.x, each.angular.z) for each in node.sent["cmd_vel"]][-1] == (0.0, -0.5)
    (walls,) = node.sent["walls"]  # once, and as they came, within a border of one cell: all beyond is a wall
    assert (walls.header.frame_id, walls.info.width, walls.info.height) == ("odom", 42, 42)
    corner, resolution = walls.info.origin.position, walls.info.resolution
    np.testing.assert_allclose([corner.x, corner.y, resolution], [-2.1, -2.1, 0.1], atol=1e-6)
    np.testing.assert_array_equal(walls.data.reshape(42, 42)[1:-1, 1:-1], cells)
    assert (walls.data.reshape(42, 42)[[0, -1]] == 100).all()
    node.subscriptions["odom"](MAKE.odometry(odometry(100.0, frame="map"), (0.0,) * 6))
    node.subscriptions["odom"](MAKE.odometry(odometry(100.1, frame="map"), (0.0,) * 6))
    assert len(node.sent["walls"]) == 1  # in another frame they are none, until a map comes in that
    assert "map" not in [text.partition(":")[0] for _, text in node.lines]


def test_walls_that_a_policy_was_trained_among_are_published(monkeypatch):
    """Those of its scenario, cell by cell: a wall of 0.4 m across, as shapely has it."""
    wall = ShapeObstacles(boxes=((1.0, -2.0, 1.4, 3.0),))
    policy = Watched(replace(PLANE, obstacles=wall))
    monkeypatch.setattr(module, "load_model", lambda name, number: policy.core.model)
    node = Node(policy="any")
    Driver(node, find, "qos")
    assert not node.sent["walls"]  # there is no frame yet
    for time_s in (99.9, 100.0):
        node.subscriptions["odom"](MAKE.odometry(odometry(time_s), (0.0,) * 6))
    (walls,) = node.sent["walls"]
    info, corner = walls.info, walls.info.origin.position
    x, y = (c + info.resolution * (np.arange(n) + 0.5) for c, n in ((corner.x, info.width), (corner.y, info.height)))
    box, middles = shapely.box(1.0, -2.0, 1.4, 3.0), shapely.points(*np.meshgrid(x, y))
    inside, border = shapely.contains(box, middles), shapely.distance(box.exterior, middles) < 1e-3
    found = walls.data.reshape(info.height, info.width)
    np.testing.assert_array_equal(found[~border], 100 * inside[~border])
    assert 150 < (found == 100).sum() < 260


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({}, "policy: expected a run folder, a preset or a file"),
        ({"policy": "x", "sensor_pose": [0.0, 1.0]}, "sensor_pose"),
        ({"policy": "x", "lag_s": -1.0}, "lag_s"),
        ({"policy": "x", "period_s": -1.0}, "period_s"),
    ],
)
def test_wrong_parameters_are_named(watched, parameters, message):
    with pytest.raises(InputError, match=message):
        Driver(Node(**parameters), find, "qos")


def test_what_is_wrong_is_said_once_in_five_seconds(watched):
    node = Node()
    driver = Driver(node, find, "qos", "x")
    for _ in range(30):
        driver.step()
        node.now_s += 0.5
    stopped = [text for _, text in node.lines if text.startswith("stopped")]
    assert stopped == ["stopped: no odometry yet"] * 3
    assert all(each.linear.x == 0.0 for each in node.sent["cmd_vel"])
    assert not node.sent["beliefs/markers"]
    node.subscriptions["odom"](MAKE.odometry(odometry(node.now_s), (0.0,) * 6))
    unnamed = MAKE.detections(detections(node.now_s, a=(1, 1, 0)))
    unnamed.detections[0].id = ""
    node.subscriptions["detections"](unnamed)
    assert "1 have no id: run a tracker first" in node.lines[-1][1]
    node.now_s += 10.0
    node.subscriptions["poses"](MAKE.pose_array(MAKE.header(node.now_s, "lidar"), [(1.0, 1.0, 0.0)]))
    assert "no odometry of their time" in node.lines[-1][1]


def test_without_vision_msgs_pose_arrays_are_taken(watched):
    def without(name):
        if name.startswith("vision"):
            raise ImportError(name)
        return find(name)

    node = Node()
    Driver(node, without, "qos", "x")
    assert set(node.subscriptions) == {"odom", "poses"}
    assert "vision_msgs is not installed" in node.lines[0][1]


def test_names_of_topics_are_those_of_ros():
    assert [topic_name(name) for name in ("7", "anna", "/walkers/0", "ä", "a--b")] == [
        "target_7", "target_anna", "target_walkers_0", "target_x", "target_a_b",
    ]  # fmt: skip


@pytest.mark.slow
def test_a_decision_costs_less_than_a_millisecond_beyond_the_policy():
    """In a process of its own: types that are checked at run time cost more than that."""
    script = Path(__file__).parents[2] / "experiments" / "ros_node.py"
    ran = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=300)
    assert ran.returncode == 0, ran.stderr
    spent = [float(line.split()[-2]) for line in ran.stdout.splitlines() if line.startswith("decision")]
    assert len(spent) == 3
    assert max(spent) < 1000.0, ran.stdout


def test_without_ros_it_says_what_is_missing(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    assert main(["best"]) == 2
    assert "foveate.ros: rclpy, ROS 2's Python, is not found" in capsys.readouterr().err


LISTENER = Path(__file__).with_name("listener.py")


@pytest.mark.slow
def test_on_loopback_it_drives_and_stops():
    """The node as a process, and another that sends it odometry and detections, through the middleware."""
    pytest.importorskip("rclpy", reason="needs ROS 2, or the extra rclpy")
    here = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOCALHOST_ONLY": "1", "ROS_DOMAIN_ID": "77"}
    environment = {**os.environ, **here}
    command = [sys.executable, "-m", "foveate.ros", "pan", "--ros-args", "-r", "cmd_vel:=/turn", "-p", "lag_s:=0.5"]
    running = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
    try:
        heard = subprocess.run(
            [sys.executable, str(LISTENER)], env=environment, capture_output=True, text=True, timeout=240
        )
    finally:
        running.terminate()
        _, errors = running.communicate(timeout=60)
    assert heard.returncode == 0, heard.stdout + heard.stderr + errors
    assert running.returncode == 0, errors
    assert "stopped: the odometry is" in errors


def test_the_stand_in_has_the_names_of_rclpy():
    """What `Node` above offers is what a real node has."""
    rclpy = pytest.importorskip("rclpy.node", reason="needs ROS 2, or the extra rclpy")
    names = [name for name in vars(Node) if name.startswith(("create", "declare", "get"))]
    assert all(hasattr(rclpy.Node, name) for name in names)
    assert PLANE.tau_s == 0.5
