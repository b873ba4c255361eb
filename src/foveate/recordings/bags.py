"""Read bags of ROS 1 (.bag) and ROS 2 (.mcap, .db3, their folders), without ROS, by the library rosbags (extra `ros`).

rosbags is maintained (Ternaris, Apache 2, since 2021) and written in Python; it brings wheels of apsw, lz4 and zstd, 23
MB in all beside numpy. It finds the messages, through compression and chunks; `unpack` reads them.
"""

import hashlib
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from foveate.errors import InputError
from foveate.recordings.clock import Clock
from foveate.recordings.definitions import typestore
from foveate.recordings.fixes import Collection, Fixes
from foveate.recordings.unpack import Rows, of_objects, unpacked

SUFFIXES = (".bag", ".mcap", ".db3")
_KINDS = {
    "geometry_msgs/msg/PoseStamped": "pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "pose",
    "nav_msgs/msg/Odometry": "odometry",
    "geometry_msgs/msg/PoseArray": "array",
    "vision_msgs/msg/Detection3DArray": "detections",
    "visualization_msgs/msg/MarkerArray": "markers",
}
KINDS = ", ".join(name.rpartition("/")[2] for name in _KINDS)
_BY_DEFAULT = (("pose", "odometry", "array"), ("detections",), ("markers",))
"""Kinds of which all topics are taken: those of the first line that the bag has, as markers show what others say."""
_ROWS = 1 << 16


def is_bag(path: Path) -> bool:
    """True for a bag of ROS: a file, or the folder that ROS 2 writes."""
    return path.suffix in SUFFIXES or (path / "metadata.yaml").is_file()


def read_bag(path: Path, topics: tuple[str, ...], scale: float, collection: Collection, clock: Clock) -> str:
    """Add the poses of a bag, a target for each topic (and each place of an array); return the bag's digest.

    Raises InputError without rosbags, for a damaged bag, and where no topic has poses.
    """
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.serde import SerdeError
    except ImportError as error:
        raise InputError(f"{path}: bags of ROS need the extra ros: pip install 'foveate[ros]' ({error})") from None
    if not path.exists():
        raise FileNotFoundError
    collection.strict = False
    try:
        with AnyReader([path], default_typestore=typestore("latest")) as reader:
            _read(path, reader, topics, scale, collection, clock)
    except (AnyReaderError, SerdeError, struct.error, UnicodeDecodeError, EOFError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is no bag of ROS, or damaged: {str(error)[:200] or type(error).__name__}") from None
    return _digest(path)


def _read(path: Path, reader: Any, topics: tuple[str, ...], scale: float, collection: Collection, clock: Clock) -> None:
    kinds = {each.topic: each.msgtype for each in reader.connections}
    for topic in topics:
        if kinds.get(topic) not in _KINDS:
            raise InputError(f"{path}: topics {topic}: no such topic of {KINDS}; the bag has {_listed(kinds)}")
    chosen = [c for c in reader.connections if c.topic in topics] if topics else _by_default(reader.connections)
    if not chosen:
        raise InputError(f"{path}: no topic of {KINDS}; the bag has {_listed(kinds)}")
    names = {c.topic: _KINDS[c.msgtype] for c in chosen}
    collection.notes.append(f"targets are the topics {', '.join(sorted(names))}; choose others with --topics")
    if "array" in names.values():
        collection.notes.append(
            "poses of an array are told apart by their places in it: expected the same order always"
        )
    # Messages of a topic and a length are alike, and are unpacked together.
    alike: dict[tuple[int, int], list[bytes]] = {}
    received: dict[tuple[int, int], list[int]] = {}
    by_id, count, unstamped = {c.id: c for c in chosen}, 0, 0
    for connection, received_ns, data in reader.messages(connections=chosen):
        key = (connection.id, len(data))
        alike.setdefault(key, []).append(data)
        received.setdefault(key, []).append(received_ns)
        if (count := count + 1) == _ROWS:
            unstamped += _add_all(by_id, alike, received, reader, scale, collection, clock)
            alike, received, count = {}, {}, 0
    unstamped += _add_all(by_id, alike, received, reader, scale, collection, clock)
    if unstamped:
        collection.notes.append(f"{unstamped} messages have no stamp; the times of their recording are taken")
    if not collection.blocks:
        raise InputError(f"{path}: no poses in {', '.join(sorted(names))}")


def _by_default(connections: Sequence[Any]) -> list[Any]:
    """Connections of the most direct kind that a bag has."""
    by_kind = [[c for c in connections if _KINDS.get(c.msgtype) in kinds] for kinds in _BY_DEFAULT]
    return next((found for found in by_kind if found), [])


def _add_all(
    connections: Mapping[int, Any],
    alike: Mapping[tuple[int, int], list[bytes]],
    received: Mapping[tuple[int, int], list[int]],
    reader: Any,
    scale: float,
    collection: Collection,
    clock: Clock,
) -> int:
    """Add messages by connection and length; return the number of those without a stamp."""
    unstamped = 0
    for key, datas in alike.items():
        connection, received_ns = connections[key[0]], np.array(received[key])
        kind, topic = _KINDS[connection.msgtype], connection.topic
        if kind in ("detections", "markers"):
            objects = (reader.deserialize(data, connection.msgtype) for data in datas)
            rows, unnamed = of_objects(kind, topic, objects, received_ns)
            found = [rows]
            if unnamed:
                collection.notes.append(f"detections of {topic} without an id are left out: run a tracker first")
        else:
            found = unpacked(kind, topic, datas, received_ns, reader.is2)
        for rows in found:
            unstamped += rows.unstamped
            _add(rows, scale, collection, clock)
    return unstamped


def _add(rows: Rows, scale: float, collection: Collection, clock: Clock) -> None:
    if not len(rows.owners):
        return
    positions = scale * rows.points
    finite = np.isfinite(positions).all(axis=1)
    if not finite.all():  # trackers publish NaN for what they have lost
        name = rows.names[rows.owners[np.argmin(finite)]]
        collection.notes.append(f"poses that are not finite are left out (the first of {name})")
    owners = np.array([collection.owner(name) for name in rows.names])[rows.owners]
    times = clock.after_origin(rows.stamps_ns)
    collection.blocks.append(Fixes(times_s=times[finite], owners=owners[finite], positions=positions[finite]))


def _listed(kinds: dict[str, str]) -> str:
    topics = [f"{topic} ({kind.rpartition('/')[2]})" for topic, kind in sorted(kinds.items())]
    return ", ".join(topics[:9]) + ", .." * (len(topics) > 9) or "none"


def _digest(path: Path) -> str:
    """SHA-256 of a file, or of the files of a folder in order."""
    parts = sorted(each for each in path.iterdir() if each.is_file()) if path.is_dir() else [path]
    total = hashlib.sha256()
    for part in parts:
        with part.open("rb") as file:
            total.update(hashlib.file_digest(file, "sha256").digest() if path.is_dir() else b"")
            if not path.is_dir():
                return hashlib.file_digest(file, "sha256").hexdigest()
    return total.hexdigest()
