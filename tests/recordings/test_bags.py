"""Bags of ROS 1 and 2, as the library rosbags writes them from the definitions of each version."""

import numpy as np
import pytest

from foveate.errors import InputError
from foveate.recordings.formats import load_recording

pytest.importorskip("rosbags", reason="bags of ROS need the extra ros")
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from foveate.recordings.definitions import typestore
from foveate.ros.markers import UPRIGHT, Shape, view_shapes
from foveate.ros.messages import Messages
from foveate.ros.records import Detections

START = 1_760_000_000
SECONDS = np.round(0.1 * np.arange(20), 1)


class Bag:
    """A bag of one of three kinds, to which messages are written."""

    def __init__(self, kind, folder):
        self.kind, self.store = kind, get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
        self.path = folder / ("bag.bag" if kind == "ros1" else kind)
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        self.writer = Writer1(self.path) if kind == "ros1" else Writer2(self.path, version=9, storage_plugin=plugin)
        self.connections = {}

    def __getattr__(self, name):
        package = "nav_msgs" if name == "Odometry" else "std_msgs" if name in ("Header", "String") else "geometry_msgs"
        package = "builtin_interfaces" if name == "Time" else package
        return self.store.types[f"{package}/msg/{name}"]

    def header(self, second, frame="map"):
        whole = int(second)
        stamp = self.Time(sec=whole, nanosec=round((second - whole) * 1e9))
        return self.Header(stamp=stamp, frame_id=frame, **({"seq": 7} if self.kind == "ros1" else {}))

    def pose(self, x, y, z):
        turned = self.Quaternion(x=0.0, y=0.0, z=0.6, w=0.8)
        return self.Pose(position=self.Point(x=x, y=y, z=z), orientation=turned)

    def write(self, topic, message, received_s):
        kind = message.__msgtype__
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        serialise = self.store.serialize_ros1 if self.kind == "ros1" else self.store.serialize_cdr
        self.writer.write(self.connections[topic], int(received_s * 1e9), serialise(message, kind))


@pytest.fixture(params=["ros1", "mcap", "sqlite"])
def bag(request, tmp_path):
    """Two targets, a robot, an array of two and what has no pose; every message is received 0.4 s late."""
    made = Bag(request.param, tmp_path)
    with made.writer:
        for k, second in enumerate(SECONDS):
            late = START + second + 0.4
            anna = made.PoseStamped(header=made.header(START + second), pose=made.pose(1.0 + k, 2.0, 0.0))
            made.write("/anna", anna, late)
            if k % 2 == 0:
                pose = made.PoseWithCovariance(pose=made.pose(-1.0 * k, 5.0, 0.5), covariance=np.zeros(36))
                still = made.Vector3(x=0.0, y=0.0, z=0.0)
                twist = made.TwistWithCovariance(twist=made.Twist(linear=still, angular=still), covariance=np.zeros(36))
                # Names whose lengths leave every alignment to the next number.
                header = made.header(START + second, "o" * (k % 8))
                odometry = made.Odometry(header=header, child_frame_id="base" + "x" * k, pose=pose, twist=twist)
                made.write("/odom", odometry, late)
                made.write("/ben", made.PoseWithCovarianceStamped(header=made.header(START + second), pose=pose), late)
            poses = [made.pose(10.0, 1.0 * k, 0.0), made.pose(float("nan") if k == 3 else 20.0, 0.0, 1.0)]
            made.write("/walkers", made.PoseArray(header=made.header(START + second, "f" * (k % 8)), poses=poses), late)
            made.write("/chatter", made.String(data="hello"), late)
    return made


def test_targets_are_topics_by_the_stamps_of_their_headers(bag):
    read = load_recording(bag.path)
    tracks = {track.track_id: track for track in read.tracks}
    assert set(tracks) == {"/anna", "/odom", "/ben", "/walkers/0", "/walkers/1"}
    assert (read.dimension, read.clock_origin_s) == (3, START)
    np.testing.assert_allclose(tracks["/anna"].times_s, SECONDS, atol=2e-7)
    np.testing.assert_array_equal(tracks["/anna"].positions_m, [[1.0 + k, 2.0, 0.0] for k in range(20)])
    for name in ("/odom", "/ben"):
        np.testing.assert_allclose(tracks[name].times_s, SECONDS[::2], atol=2e-7)
        np.testing.assert_array_equal(tracks[name].positions_m, [[-1.0 * k, 5.0, 0.5] for k in range(0, 20, 2)])
    np.testing.assert_array_equal(tracks["/walkers/0"].positions_m, [[10.0, 1.0 * k, 0.0] for k in range(20)])
    assert len(tracks["/walkers/1"].times_s) == 19  # without the one that is not a number
    assert "not finite" in " ".join(read.notes)
    chosen = load_recording(bag.path, topics=["/anna"], planar=True)
    assert [track.track_id for track in chosen.tracks] == ["/anna"]
    assert chosen.dimension == 2
    assert len(read.sha256) == 64


def messages_of(store, kind, rows):
    """Arrays of detections or markers: rows of a time, ids and positions."""
    make = Messages(find=store.types.__getitem__)
    for second, spots in rows:
        if kind == "detections":
            yield second, make.detections(Detections(START + second, "map", spots))
        else:
            shapes = [Shape("", "ellipsoid", p, UPRIGHT, (1.0, 1.0, 1.0), (1.0, 1.0, 1.0, 1.0)) for p in spots.values()]
            message = make.markers(make.header(START + second, "map"), shapes)
            for marker, name in zip(message.markers[1:], spots, strict=True):
                marker.ns, marker.id = "people", int(name)
            line = make.added(make.header(START + second, "map"), view_shapes([np.ones((3, 2))]))
            message.markers.extend(line)
            yield second, message


@pytest.mark.parametrize("kind", ["detections", "markers"])
@pytest.mark.parametrize("plugin", ["mcap", "sqlite"])
def test_detections_and_markers_are_targets_by_their_ids(tmp_path, kind, plugin):
    store = typestore("ros2_humble")
    rows = [(0.1 * k, {"4": (1.0 * k, 2.0, 0.5)} | ({"9": (0.0, -1.0 * k, 0.0)} if k % 3 else {})) for k in range(10)]
    made = Bag(plugin, tmp_path)
    made.store = store
    with made.writer:
        for second, message in messages_of(store, kind, rows):
            made.write("/seen", message, START + second + 0.5)
            robot = made.PoseStamped(header=made.header(START + second), pose=made.pose(7.0, 7.0, 7.0))
            if kind == "markers":
                made.write("/robot", robot, START + second)
    read = load_recording(made.path, topics=["/seen"])
    tracks = {each.track_id: each for each in read.tracks}
    prefix = "/seen/people/" if kind == "markers" else "/seen/"
    assert set(tracks) == {f"{prefix}4", f"{prefix}9"}
    np.testing.assert_array_equal(tracks[f"{prefix}4"].positions_m, [[1.0 * k, 2.0, 0.5] for k in range(10)])
    np.testing.assert_allclose(tracks[f"{prefix}9"].times_s, [0.1 * k for k in range(10) if k % 3], atol=2e-7)
    by_default = load_recording(made.path)
    assert {each.track_id for each in by_default.tracks} == ({"/robot"} if kind == "markers" else set(tracks))


def test_detections_without_ids_are_left_out(tmp_path):
    store = typestore("ros2_humble")
    made = Bag("mcap", tmp_path)
    made.store = store
    with made.writer:
        for second, message in messages_of(store, "detections", [(0.0, {"a": (1.0, 1.0, 0.0), "b": (2.0, 2.0, 0.0)})]):
            message.detections[1].id = ""
            made.write("/seen", message, START + second)
    read = load_recording(made.path)
    assert [each.track_id for each in read.tracks] == ["/seen/a"]
    assert "detections of /seen without an id are left out" in " ".join(read.notes)


def test_a_message_cut_short_is_damage(tmp_path):
    made = Bag("mcap", tmp_path)
    with made.writer:
        pose = made.PoseStamped(header=made.header(START), pose=made.pose(1.0, 2.0, 0.0))
        made.write("/a", pose, START)
        data = made.store.serialize_cdr(pose, pose.__msgtype__)
        made.writer.write(made.connections["/a"], START * 10**9, data[:40])
    with pytest.raises(InputError, match="is no bag of ROS, or damaged"):
        load_recording(made.path)


def test_other_topics_and_damaged_bags_are_named(bag, tmp_path):
    with pytest.raises(InputError, match=r"topics /chatter: no such topic .* /anna \(PoseStamped\)"):
        load_recording(bag.path, topics=["/chatter"])
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"nonsense" * 100)
    with pytest.raises(InputError, match=r"broken\.mcap: is no bag of ROS, or damaged"):
        load_recording(broken)
    with pytest.raises(InputError, match=r"none\.mcap: no such file"):
        load_recording(tmp_path / "none.mcap")


def test_messages_without_a_stamp_have_the_time_of_their_recording(tmp_path):
    made = Bag("mcap", tmp_path)
    with made.writer:
        for k in range(3):
            made.write("/a", made.PoseStamped(header=made.header(0), pose=made.pose(1.0 * k, 0.0, 0.0)), START + k)
    read = load_recording(made.path)
    np.testing.assert_array_equal(read.tracks[0].times_s, [0, 1, 2])
    assert "3 messages have no stamp" in " ".join(read.notes)
