"""Stamps and positions of ROS messages: poses from their bytes, many at once; others from rosbags' objects.

Poses are the same bytes in every version of ROS. Messages of one topic and one length differ in their numbers alone,
except for texts that grow and shrink; so numpy reads all of them as one table.
"""

import struct
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

POSE_BYTES = 56
_BODIES = (0, 1, 2, 3, 10)
"""Types of markers that stand for a thing at their pose: arrow, cube, sphere, cylinder, mesh."""
_ADDED = 0
"""Action of a marker that is shown; the others remove."""


class Rows(NamedTuple):
    """Stamps [ns] and positions [m] of some fixes, and of each the place of its target's name in `names`."""

    names: list[str]
    owners: Int[np.ndarray, " rows"]
    stamps_ns: Int[np.ndarray, " rows"]
    points: Float[np.ndarray, "rows 3"]
    unstamped: int
    """Messages without a stamp; they have the times of their recording."""


class _Places(NamedTuple):
    """Byte order, where the lengths are (of texts and of an array), and where the first of the `poses` is."""

    order: str
    lengths: tuple[int, ...]
    at: int
    poses: int


def unpacked(
    kind: str, topic: str, messages: Sequence[bytes], received_ns: Int[np.ndarray, " m"], is_ros2: bool
) -> list[Rows]:
    """Rows of messages of one length: "pose", "odometry" or "array". Raises ValueError or struct.error for others."""
    places = _places(kind, messages[0], is_ros2)
    table = np.frombuffer(b"".join(messages), np.uint8).reshape(len(messages), -1)
    fixed = [1, *(at + i for at in places.lengths for i in range(4))] if is_ros2 else places.lengths
    if len(messages) > 1 and (table[:, list(fixed)] != table[0, list(fixed)]).any():
        halves = np.array_split(np.arange(len(messages)), 2)
        parts = ([messages[i] for i in half] for half in halves)
        return [
            rows
            for part, half in zip(parts, halves, strict=True)
            for rows in unpacked(kind, topic, part, received_ns[half], is_ros2)
        ]
    end = places.at + POSE_BYTES * places.poses
    if end > table.shape[1]:
        raise ValueError(f"a message of {topic} has {table.shape[1]} bytes, and needs {end}")
    head = np.ascontiguousarray(table[:, 4:12]).view(f"{places.order}{'i4' if is_ros2 else 'u4'}")
    stamps = head[:, 0].astype(np.int64) * 10**9 + head[:, 1].astype(np.int64)
    numbers = np.ascontiguousarray(table[:, places.at : end]).view(f"{places.order}f8")
    points = numbers.reshape(-1, POSE_BYTES // 8)[:, :3].astype(float)
    times = np.repeat(np.where(stamps == 0, received_ns, stamps), places.poses)
    names = [f"{topic}/{i}" for i in range(places.poses)] if kind == "array" else [topic]
    owners = np.tile(np.arange(places.poses), len(messages))
    return [Rows(names, owners, times, points, int((stamps == 0).sum()))]


def _places(kind: str, data: bytes, is_ros2: bool) -> _Places:
    """Places of a message; in CDR, which ROS 2 uses, numbers are aligned after a header of 4 bytes."""
    order = ">" if is_ros2 and not data[1] & 1 else "<"
    whole, align = struct.Struct(f"{order}I"), (lambda at, size: at + (4 - at) % size) if is_ros2 else _as_it_is
    lengths, count = [12], 1  # of frame_id, after the stamp; in ROS 1 a sequence number comes first
    at = 16 + whole.unpack_from(data, 12)[0]
    if kind in ("odometry", "array"):  # the length of child_frame_id, or the number of poses
        at = align(at, 4)
        lengths.append(at)
        number = whole.unpack_from(data, at)[0]
        at, count = (at + 4 + number, 1) if kind == "odometry" else (at + 4, number)
    return _Places(order, tuple(lengths), align(at, 8), count)


def _as_it_is(at: int, size: int) -> int:
    return at


def of_objects(kind: str, topic: str, messages: Iterable[Any], received_ns: Int[np.ndarray, " m"]) -> tuple[Rows, int]:
    """Rows of Detection3DArrays ("detections") or MarkerArrays; and how many have no id, and are left out."""
    index: dict[str, int] = {}
    rows, unstamped, unnamed = [], 0, 0
    for message, at_ns in zip(messages, received_ns.tolist(), strict=True):
        found = _detections(message) if kind == "detections" else _markers(message)
        for stamp_ns, name, point in found:
            unnamed += not name
            if name:
                rows.append((index.setdefault(f"{topic}/{name}", len(index)), stamp_ns or at_ns, point))
        unstamped += any(not stamp_ns for stamp_ns, _, _ in found)
    owners, stamps = (np.array([row[i] for row in rows], np.int64) for i in (0, 1))
    points = np.array([row[2] for row in rows], float).reshape(-1, 3)
    return Rows(list(index), owners, stamps, points, unstamped), unnamed


Found = list[tuple[int, str, tuple[float, float, float]]]
"""Stamp [ns], name (empty for none) and position [m] of each target in a message."""


def _detections(message: Any) -> Found:
    """Centres of boxes; the id is called `tracking_id` before vision_msgs 4."""
    common_ns = _nanoseconds(message.header)
    return [
        (
            _nanoseconds(each.header) or common_ns,
            getattr(each, "id", "") or getattr(each, "tracking_id", ""),
            _xyz(each.bbox.center),
        )
        for each in message.detections
    ]


def _markers(message: Any) -> Found:
    """Poses of the markers that stand for a thing; the names are those of namespace and number."""
    shown = [
        each for each in message.markers if each.action == _ADDED and each.type in _BODIES and not len(each.points)
    ]
    return [
        (_nanoseconds(each.header), f"{each.ns}/{each.id}" if each.ns else str(each.id), _xyz(each.pose))
        for each in shown
    ]


def _nanoseconds(header: Any) -> int:
    return header.stamp.sec * 10**9 + header.stamp.nanosec


def _xyz(pose: Any) -> tuple[float, float, float]:
    p = pose.position
    return p.x, p.y, p.z
