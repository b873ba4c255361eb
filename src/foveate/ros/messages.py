"""ROS messages from plain records and back, for the classes of rclpy and those of rosbags alike.

`find` returns the class of a name as "geometry_msgs/msg/Twist". Every field is given: rosbags has no defaults.
"""

import re
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import floor, inf, isfinite
from typing import Any

import numpy as np
from jaxtyping import Float

from foveate.errors import InputError
from foveate.io.occupancy import OccupancyGrid
from foveate.ros.markers import UPRIGHT, Shape
from foveate.ros.records import Detections, Estimate, Map, Odometry, Position, Quaternion

MAX_TURN = 1e-4
"""Largest part of a map's quaternion that is rounding."""
MOST_TOPICS = 100
"""Targets with a topic of their own; the markers show all."""
OCCUPIED = 100
"""Per cent of an occupied cell in a nav_msgs/OccupancyGrid."""
KINDS = {"ellipsoid": "SPHERE", "text": "TEXT_VIEW_FACING", "line": "LINE_STRIP"}


def seconds(stamp: Any) -> float:
    """Seconds of a builtin_interfaces/Time."""
    return stamp.sec + 1e-9 * stamp.nanosec


def stamp_of(time_s: float) -> tuple[int, int]:
    """Whole seconds and nanoseconds; from 1970, a float64 of nanoseconds would resolve only 256 of them."""
    second = floor(time_s)
    carried, nanosecond = divmod(round((time_s - second) * 1e9), 10**9)
    return second + carried, nanosecond


def odometry_of(message: Any) -> Odometry:
    """Record of a nav_msgs/Odometry."""
    p, q = message.pose.pose.position, message.pose.pose.orientation
    header, pose = message.header, ((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
    return Odometry(seconds(header.stamp), header.frame_id, message.child_frame_id, *pose)


def detections_of_array(message: Any) -> Detections:
    """Record of a geometry_msgs/PoseArray, whose places are the ids."""
    points = {str(i): (p.position.x, p.position.y, p.position.z) for i, p in enumerate(message.poses)}
    return Detections(seconds(message.header.stamp), message.header.frame_id, points)


def detections_of_vision(message: Any) -> tuple[Detections, int]:
    """Record of a vision_msgs/Detection3DArray, and the number of its detections without an id, which are left out.

    A position is the centre of the box.
    """
    centres = [(each.id, each.bbox.center.position) for each in message.detections]
    points = {name: (p.x, p.y, p.z) for name, p in centres if name}
    unnamed = sum(not name for name, _ in centres)
    return Detections(seconds(message.header.stamp), message.header.frame_id, points), unnamed


def map_of(message: Any) -> Map:
    """Record of a nav_msgs/OccupancyGrid: occupied is all from 50 % on, and what is unknown (-1).

    Raises InputError for a map without cells, of a wrong size, with numbers that are not finite, or turned.
    """
    info, data = message.info, np.asarray(message.data, np.int16)
    if not 0 < info.resolution < inf or len(data) != info.width * info.height or not len(data):
        size = f"{len(data)} cells of {info.resolution:g} m"
        right = f"expected {info.width} x {info.height} cells, at least one, and a finite resolution > 0"
        raise InputError(f"map: {size}: {right}")
    origin, q = info.origin.position, info.origin.orientation
    if not isfinite(origin.x + origin.y):
        raise InputError(f"map: its origin is {origin.x:g}, {origin.y:g}: expected finite numbers")
    # Not `> MAX_TURN`, which is false of NaN.
    if not all(abs(part) <= MAX_TURN for part in (q.x, q.y, q.z)):
        raise InputError("map: its origin is turned: expected a map along the axes of its frame")
    cells = data.reshape(info.height, info.width).T
    occupied = np.ascontiguousarray((cells < 0) | (cells >= 50))
    return Map(message.header.frame_id, OccupancyGrid(occupied, np.array([origin.x, origin.y]), float(info.resolution)))


def topic_name(target: str) -> str:
    """Name of a target's topic: ROS allows letters, digits and single underscores."""
    return "target_" + (re.sub(r"[^A-Za-z0-9]+", "_", target).strip("_") or "x")


@dataclass(frozen=True, kw_only=True)
class Messages:
    """Makes messages of the classes that `find` knows."""

    find: Callable[[str], Any]

    def _make(self, package: str, name: str, **fields: Any) -> Any:
        kind = self.find(f"{package}/msg/{name}")
        # rclpy's classes, which have this, take array.array for a sequence of bytes; rosbags' take numpy only.
        if isinstance(data := fields.get("data"), np.ndarray) and hasattr(kind, "get_fields_and_field_types"):
            fields["data"] = array(data.dtype.char, data.tobytes())
        return kind(**fields)

    def text(self, content: str) -> Any:
        """A text."""
        return self._make("std_msgs", "String", data=content)

    def header(self, time_s: float, frame: str) -> Any:
        """Header of a time and a frame."""
        second, nanosecond = stamp_of(time_s)
        stamp = self._make("builtin_interfaces", "Time", sec=second, nanosec=nanosecond)
        return self._make("std_msgs", "Header", stamp=stamp, frame_id=frame)

    def point(self, position: Position) -> Any:
        """Point [m]."""
        x, y, z = position
        return self._make("geometry_msgs", "Point", x=x, y=y, z=z)

    def vector(self, numbers: Sequence[float]) -> Any:
        """Vector of three numbers."""
        x, y, z = numbers
        return self._make("geometry_msgs", "Vector3", x=x, y=y, z=z)

    def rotation(self, quaternion: Quaternion) -> Any:
        """Quaternion."""
        x, y, z, w = quaternion
        return self._make("geometry_msgs", "Quaternion", x=x, y=y, z=z, w=w)

    def pose(self, position: Position, quaternion: Quaternion = UPRIGHT) -> Any:
        """Pose [m]."""
        return self._make("geometry_msgs", "Pose", position=self.point(position), orientation=self.rotation(quaternion))

    def twist(self, numbers: Sequence[float]) -> Any:
        """Twist in the body frame, vx, vy, vz [m/s], wx, wy, wz [rad/s]."""
        linear, angular = self.vector(numbers[:3]), self.vector(numbers[3:])
        return self._make("geometry_msgs", "Twist", linear=linear, angular=angular)

    def twist_stamped(self, header: Any, numbers: Sequence[float]) -> Any:
        """The same with a header."""
        return self._make("geometry_msgs", "TwistStamped", header=header, twist=self.twist(numbers))

    def pose_array(self, header: Any, positions: Iterable[Position]) -> Any:
        """Poses without directions."""
        return self._make("geometry_msgs", "PoseArray", header=header, poses=[self.pose(p) for p in positions])

    def belief(self, header: Any, estimate: Estimate, dimension: int) -> Any:
        """PoseWithCovarianceStamped of a target's position; of its direction nothing is known, which -1 says."""
        covariance = np.zeros((6, 6))
        covariance[:dimension, :dimension] = estimate.covariance[:dimension, :dimension]
        covariance[range(3, 6), range(3, 6)] = -1.0
        pose = self._make(
            "geometry_msgs", "PoseWithCovariance",
            pose=self.pose(position_of(estimate.mean, dimension)), covariance=covariance.ravel(),
        )  # fmt: skip
        return self._make("geometry_msgs", "PoseWithCovarianceStamped", header=header, pose=pose)

    def odometry(self, record: Odometry, twist: Sequence[float]) -> Any:
        """Odometry without uncertainty."""
        pose, nothing = self.pose(record.position, record.quaternion), np.zeros(36)
        return self._make(
            "nav_msgs", "Odometry",
            header=self.header(record.time_s, record.frame), child_frame_id=record.child,
            pose=self._make("geometry_msgs", "PoseWithCovariance", pose=pose, covariance=nothing),
            twist=self._make("geometry_msgs", "TwistWithCovariance", twist=self.twist(twist), covariance=nothing),
        )  # fmt: skip

    def occupancy(self, header: Any, grid: OccupancyGrid) -> Any:
        """OccupancyGrid in the plane z = 0, of cells that are free or occupied."""
        width, height = grid.occupied.shape
        origin = self.pose((float(grid.low[0]), float(grid.low[1]), 0.0))
        info = self._make(
            "nav_msgs", "MapMetaData",
            map_load_time=header.stamp, resolution=grid.cell_m, width=width, height=height, origin=origin,
        )  # fmt: skip
        cells = OCCUPIED * grid.occupied.T.astype(np.int8).ravel()
        return self._make("nav_msgs", "OccupancyGrid", header=header, info=info, data=cells)

    def transform(self, record: Odometry) -> Any:
        """Message for /tf of the body in the world."""
        moved = self._make(
            "geometry_msgs", "Transform",
            translation=self.vector(record.position), rotation=self.rotation(record.quaternion),
        )  # fmt: skip
        header = self.header(record.time_s, record.frame)
        stamped = self._make(
            "geometry_msgs", "TransformStamped", header=header, child_frame_id=record.child, transform=moved
        )
        return self._make("tf2_msgs", "TFMessage", transforms=[stamped])

    def detections(self, record: Detections) -> Any:
        """Detection3DArray of positions with ids, certain and without extent."""
        header, nothing = self.header(record.time_s, record.frame), self.vector((0.0, 0.0, 0.0))
        boxes = {
            name: self._make("vision_msgs", "BoundingBox3D", center=self.pose(position), size=nothing)
            for name, position in record.positions.items()
        }
        found = [
            self._make("vision_msgs", "Detection3D", header=header, results=[], bbox=box, id=name)
            for name, box in boxes.items()
        ]
        return self._make("vision_msgs", "Detection3DArray", header=header, detections=found)

    def markers(self, header: Any, shapes: Iterable[Shape]) -> Any:
        """MarkerArray that replaces all earlier ones of its topic."""
        kind = self.find("visualization_msgs/msg/Marker")
        clear = Shape("", "ellipsoid", (0.0, 0.0, 0.0), UPRIGHT, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
        found = [self._marker(header, kind.DELETEALL, 0, clear), *self.added(header, shapes)]
        return self._make("visualization_msgs", "MarkerArray", markers=found)

    def added(self, header: Any, shapes: Iterable[Shape]) -> list[Any]:
        """Markers of shapes in the frame of a header."""
        action = self.find("visualization_msgs/msg/Marker").ADD
        return [self._marker(header, action, i, shape) for i, shape in enumerate(shapes)]

    def _marker(self, header: Any, action: int, number: int, shape: Shape) -> Any:
        r, g, b, a = shape.colour
        return self._make(
            "visualization_msgs", "Marker",
            header=header, ns=shape.namespace, id=number, action=action,
            type=getattr(self.find("visualization_msgs/msg/Marker"), KINDS[shape.kind]),
            pose=self.pose(shape.position, shape.quaternion), scale=self.vector(shape.size),
            color=self._make("std_msgs", "ColorRGBA", r=r, g=g, b=b, a=a),
            points=[self.point(each) for each in shape.points], text=shape.text, **self._unused,
        )  # fmt: skip

    @cached_property
    def _unused(self) -> dict[str, Any]:
        """The other fields of a marker."""
        nothing, none = self.header(0.0, ""), np.zeros(0, np.uint8)
        return {
            "lifetime": self._make("builtin_interfaces", "Duration", sec=0, nanosec=0),
            "frame_locked": False,
            "colors": [],
            "texture_resource": "",
            "texture": self._make("sensor_msgs", "CompressedImage", header=nothing, format="", data=none),
            "uv_coordinates": [],
            "mesh_resource": "",
            "mesh_file": self._make("visualization_msgs", "MeshFile", filename="", data=none),
            "mesh_use_embedded_materials": False,
        }


def position_of(mean: Float[np.ndarray, " n_y"], dimension: int) -> Position:
    """Position of a state, with z = 0 in the plane."""
    x, y, *rest = mean[:dimension].tolist()
    return x, y, rest[0] if rest else 0.0
