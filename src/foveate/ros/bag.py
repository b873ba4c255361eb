"""Write a replay as a bag that Foxglove, Rerun and `ros2 bag play` open: one MCAP file (extra `ros`)."""

import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from foveate.deploy import kalman
from foveate.errors import InputError
from foveate.recordings.definitions import typestore
from foveate.recordings.measures import PreparedReplay
from foveate.recordings.results import ReplayResult
from foveate.ros.markers import belief_shapes, quaternion_of, truth_shapes, view_shapes
from foveate.ros.messages import MOST_TOPICS, Messages, position_of, stamp_of, topic_name
from foveate.ros.records import AXES, Detections, Estimate, Odometry
from foveate.ros.walls import own_cells
from foveate.simulation.records import Trace

WORLD, BODY = "map", "base_link"
DISTRIBUTION = "ros2_humble"
"""The oldest distribution with these messages; later ones have the same."""
BAG_VERSION = 9


class Published(NamedTuple):
    """A message on a topic."""

    topic: str
    message: Any


def write_bag(result: ReplayResult, path: Path) -> str:
    """Write the first method of a result, from the first start; return its name. Raises as `write_replay`.

    Raises InputError for detections without ids, too: beliefs in a bag are by the ids of targets; and for a team.
    """
    if result.experiment.scenario.problem().team is not None:
        raise InputError(f"{path}: expected a folder, for a team: a bag holds the beliefs of one robot")
    if result.experiment.scenario.detections is not None:
        raise InputError(f"{path}: expected a folder, with detections without ids: a bag has beliefs by id")
    method = next(iter(result.traces))
    write_replay(*result.traces[method], path, result.recording.clock_origin_s)
    return method


def write_replay(ready: PreparedReplay, trace: Trace, path: Path, clock_origin_s: int = 0) -> None:
    """Write one method's replay: odom, tf, cmd_vel, detections, targets, beliefs/target_ID, beliefs/markers and walls.

    Times are those of the recording's clock, frames `map` and `base_link`. Raises InputError without rosbags.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
    except ImportError as error:
        raise InputError(f"{path}: bags of ROS need the extra ros: pip install 'foveate[ros]' ({error})") from None
    store = typestore(DISTRIBUTION)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".bag-") as scratch:
        folder = Path(scratch) / "bag"  # rosbags makes a folder, with a description of the file in it
        connections: dict[str, Any] = {}
        with Writer(folder, version=BAG_VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
            for time_s, published in _published(ready, trace, store.types.__getitem__, clock_origin_s):
                kind = published.message.__msgtype__
                if published.topic not in connections:
                    connections[published.topic] = writer.add_connection(published.topic, kind, typestore=store)
                data = store.serialize_cdr(published.message, kind)
                second, rest = stamp_of(time_s)
                nanoseconds = second * 10**9 + rest
                writer.write(connections[published.topic], nanoseconds, data)
        os.replace(next(folder.glob("*.mcap")), path)


def _published(
    ready: PreparedReplay, trace: Trace, find: Callable[[str], Any], clock_origin_s: int
) -> Iterator[tuple[float, Published]]:
    """Messages of every instant, in the order of time."""
    make, problem, slots = Messages(find=find), ready.problem, ready.slots
    dimension, twists = problem.agent.space.dimension, _twists(ready, trace)
    outline = problem.sensor.view.outline()
    view = view_shapes([outline] if isinstance(outline, np.ndarray) else outline)
    measured, topics = _measurements(ready, trace), dict.fromkeys(slots.track_ids[:MOST_TOPICS])
    poses, means = np.asarray(trace.pose, float), np.asarray(trace.mean, float)
    # The information matrix of an absent target may be singular.
    information = np.where(np.asarray(trace.present)[..., None, None], trace.information, np.eye(means.shape[-1]))
    covariance = np.linalg.inv(information)
    if (cells := own_cells(problem)) is not None:
        first_s = float(slots.times_s[0]) + clock_origin_s
        yield first_s, Published("/walls", make.occupancy(make.header(first_s, WORLD), cells))
    for k, time in enumerate(slots.times_s):
        time_s = float(time) + clock_origin_s
        odometry, header = _odometry(time_s, poses[k]), make.header(time_s, WORLD)
        twist = twists[min(k, len(twists) - 1)].tolist()
        yield time_s, Published("/tf", make.transform(odometry))
        yield time_s, Published("/odom", make.odometry(odometry, twist))
        yield time_s, Published("/cmd_vel", make.twist_stamped(make.header(time_s, BODY), twist))
        here = np.flatnonzero(slots.track_index[k] >= 0)
        names = [slots.track_ids[i] for i in slots.track_index[k, here]]
        if k:
            found = {name: measured[k - 1, i] for name, i in zip(names, here, strict=True) if trace.visible[k - 1, i]}
            points = {name: position_of(z, dimension) for name, z in found.items()}
            yield time_s, Published("/detections", make.detections(Detections(time_s, WORLD, points)))
        truth = slots.positions_m[k, here]
        yield time_s, Published("/targets", make.pose_array(header, [position_of(p, dimension) for p in truth]))
        beliefs = [Estimate(n, means[k, i], covariance[k, i]) for n, i in zip(names, here, strict=True)]
        for each in beliefs:
            if each.target in topics:
                topic = f"/beliefs/{topic_name(each.target)}"
                yield time_s, Published(topic, make.belief(header, each, dimension))
        message = make.markers(header, [*belief_shapes(beliefs, dimension), *truth_shapes(truth)])
        message.markers.extend(make.added(make.header(time_s, BODY), view))
        yield time_s, Published("/beliefs/markers", message)


def _odometry(time_s: float, pose: Float[np.ndarray, "..."]) -> Odometry:
    T = np.eye(4)
    if pose.shape == (3,):
        x, y, yaw = map(float, pose)
        T[:2, 3], T[:2, :2] = (x, y), [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    else:
        T = np.asarray(pose, float)
    return Odometry(time_s, WORLD, BODY, tuple(T[:3, 3].tolist()), quaternion_of(T[:3, :3]))


def _twists(ready: PreparedReplay, trace: Trace) -> Float[np.ndarray, "K 6"]:
    """Commands as twists, numbers by AXES."""
    agent = ready.problem.agent
    twists = np.zeros((len(trace.action), len(AXES)))
    columns = [AXES.index(agent.space.axes[axis]) for axis in agent.axes]
    twists[:, columns] = np.asarray(jax.vmap(agent.control)(trace.action), float)
    return twists


def _measurements(ready: PreparedReplay, trace: Trace) -> Float[np.ndarray, "K n d"]:
    """Positions as they were measured: z = H y + V^(1/2) noise, as in the simulation; 0 in directions unmeasured."""
    problem, truth = ready.problem, ready.episode.truth
    assert truth is not None, "a replay has it"
    H, Z = np.asarray(problem.sensor.H, float), np.asarray(problem.motion.Z, float)
    V, noise = np.asarray(problem.period.V[0], float), np.asarray(truth.measurement_noise, float)
    states, found = ready.truth[1:], []
    for k, pose in enumerate(np.asarray(trace.pose[1:], float)):
        roots = np.linalg.cholesky(kalman.measurement_noise(problem.sensor, V, pose, states[k] @ Z.T))
        z = states[k] @ H.T + np.einsum("nij,nj->ni", roots, noise[k])
        found.append(z @ np.linalg.pinv(H).T @ Z.T)
    return np.array(found)
