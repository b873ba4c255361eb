"""Messages by the definitions of ROS, through the bytes that ROS sends, and back."""

from array import array

import numpy as np
import pytest
from helpers.ros import detections, odometry
from scipy.spatial.transform import Rotation

from foveate.io.occupancy import OccupancyGrid
from foveate.ros.markers import UPRIGHT, Shape, belief_shapes, view_shapes
from foveate.ros.messages import Messages, detections_of_array, detections_of_vision, odometry_of, stamp_of
from foveate.ros.records import Estimate

pytest.importorskip("rosbags", reason="message definitions need the extra ros")
from foveate.recordings.definitions import typestore

NOW = 1_760_000_000.25


@pytest.fixture(scope="module")
def store():
    return typestore("ros2_humble")


@pytest.fixture(scope="module")
def make(store):
    return Messages(find=store.types.__getitem__)


def sent(store, message):
    """The message after serialisation, which checks every field's type."""
    kind = message.__msgtype__
    return store.deserialize_cdr(store.serialize_cdr(message, kind), kind)


def test_records_come_back(store, make):
    record = odometry(NOW, (1, 2, 3), (0.5, 0.1, 0.2))
    back = odometry_of(sent(store, make.odometry(record, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))))
    assert back == record
    found = detections(NOW, "map", a=(1, 2, 3), b=(4, 5, 6))
    assert detections_of_vision(sent(store, make.detections(found))) == (found, 0)
    positions = [(1.0, 2.0, 3.0), (4.0, 5.0, 6.0)]
    array = detections_of_array(sent(store, make.pose_array(make.header(NOW, "map"), positions)))
    assert array == found._replace(positions=dict(zip("01", positions, strict=True)))


def test_bytes_are_arrays_for_rclpy(store):
    """Its setters, where they check, take array.array for int8[] and uint8[], and numpy for float64[36]."""

    class Rclpy:
        ADD, SPHERE, get_fields_and_field_types = 0, 2, None

        def __init__(self, **fields):
            self.__dict__.update(fields)

    make = Messages(find=lambda name: Rclpy)
    occupied = np.array([[False, True], [True, True], [False, False]])
    header, grid = make.header(NOW, "map"), OccupancyGrid(occupied, np.zeros(2), 0.1)
    assert make.occupancy(header, grid).data == array("b", [0, 100, 0, 100, 100, 0])
    (marker,) = make.added(header, [Shape("", "ellipsoid", (0.0,) * 3, UPRIGHT, (0.0,) * 3, (0.0,) * 4)])
    assert marker.mesh_file.data == marker.texture.data == array("B")
    assert isinstance(make.odometry(odometry(NOW), (0.0,) * 6).pose.covariance, np.ndarray)
    assert make.text("a").data == "a"
    sets = Messages(find=store.types.__getitem__)
    assert sent(store, sets.occupancy(sets.header(NOW, "map"), grid)).data.tolist() == [0, 100, 0, 100, 100, 0]


def test_detections_without_ids_are_counted(store, make):
    message = sent(store, make.detections(detections(NOW, "map", a=(1, 2, 3))))
    message.detections[0].id = ""
    assert detections_of_vision(message)[1] == 1
    assert not detections_of_vision(message)[0].positions


def test_a_twist_and_a_transform_have_the_order_of_ros(store, make):
    header = make.header(NOW, "base_link")
    twist = sent(store, make.twist_stamped(header, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))).twist
    assert [twist.linear.x, twist.linear.y, twist.linear.z] == [1, 2, 3]
    assert [twist.angular.x, twist.angular.y, twist.angular.z] == [4, 5, 6]
    (moved,) = sent(store, make.transform(odometry(NOW, (1, 2, 3), (0.7, 0, 0)))).transforms
    q = moved.transform.rotation
    assert Rotation.from_quat([q.x, q.y, q.z, q.w]).as_euler("ZYX")[0] == pytest.approx(0.7)
    assert (moved.header.frame_id, moved.child_frame_id, moved.transform.translation.y) == ("odom", "base_link", 2)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_belief_has_the_covariance_of_its_position(store, make, dimension):
    covariance = np.arange(16.0).reshape(4, 4) if dimension == 2 else np.arange(36.0).reshape(6, 6)
    estimate = Estimate("a", np.arange(1.0, 1 + 2 * dimension), covariance)
    message = sent(store, make.belief(make.header(NOW, "map"), estimate, dimension))
    P = message.pose.covariance.reshape(6, 6)
    np.testing.assert_array_equal(P[:dimension, :dimension], covariance[:dimension, :dimension])
    np.testing.assert_array_equal(np.diag(P)[3:], [-1, -1, -1])
    assert message.pose.pose.position.z == (0.0 if dimension == 2 else 3.0)


def test_markers_replace_those_before_and_have_numbers_of_their_own(store, make):
    shapes = belief_shapes([Estimate(n, np.zeros(2), np.eye(2)) for n in "ab"], 2)
    message = make.markers(make.header(NOW, "map"), shapes)
    message.markers.extend(make.added(make.header(NOW, "base_link"), view_shapes([np.zeros((4, 2))])))
    first, *rest = sent(store, message).markers
    assert first.action == first.DELETEALL
    assert [each.type for each in rest] == [2, 9, 2, 9, 4]  # SPHERE, TEXT_VIEW_FACING, LINE_STRIP
    assert len({(each.ns, each.id) for each in rest}) == len(rest)
    assert [each.text for each in rest] == ["", "a", "", "b", ""]
    assert [len(each.points) for each in rest] == [0, 0, 0, 0, 4]


def test_stamps_are_whole_nanoseconds():
    assert stamp_of(1.999999999) == (1, 999_999_999)
    assert stamp_of(1.9999999999) == (2, 0)
    assert stamp_of(-0.25) == (-1, 750_000_000)
