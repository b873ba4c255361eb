"""Bags of replays, read back by rosbags as any tool would, against the trace."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from helpers.recordings import DEPTH, recording, track
from helpers.ros import PLANE
from scipy.spatial.transform import Rotation

from foveate.cli.main import main
from foveate.errors import InputError
from foveate.experiment.presets import PRESETS
from foveate.planning.named import heuristic_policy
from foveate.recordings.formats import load_recording
from foveate.recordings.replay import drive, prepare_replay
from foveate.ros.bag import write_replay
from foveate.scenario.obstacles import ShapeObstacles

pytest.importorskip("rosbags", reason="bags of ROS need the extra ros")
from rosbags.highlevel import AnyReader

ORIGIN_S = 1_760_000_000
TIMES = np.arange(0.0, 10.1, 0.25)
WALL = ShapeObstacles(boxes=((-4.0, -3.0, -3.6, 2.0),), targets="free")


def read(path):
    """Messages by topic: nanoseconds, and the message of the definitions in the file."""
    found = {}
    with AnyReader([path]) as reader:
        for connection, stamp_ns, data in reader.messages():
            found.setdefault(connection.topic, []).append((stamp_ns, reader.deserialize(data, connection.msgtype)))
        kinds = {each.topic: each.msgtype for each in reader.connections}
    return found, kinds


@pytest.fixture(scope="module", params=["plane", pytest.param("space", marks=pytest.mark.slow)])
def written(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("bag") / "run.mcap"
    if request.param == "plane":
        scenario, d, start = replace(PLANE, obstacles=WALL), 2, [0.0, 0.0, 0.3]
    else:
        scenario, d, start = PRESETS["quadrotor"].scenario, 3, [0.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0]
    line = np.column_stack([2 + 0.1 * TIMES, 0.5 - 0.1 * TIMES, 2.0 + 0 * TIMES])[:, :d]
    whole = recording(track(TIMES, line, "anna"), track(TIMES[10:30], -line[10:30], "7/b"))
    ready = prepare_replay(scenario, whole, start)
    _, trace = drive(ready, "nearest", heuristic_policy("nearest", ready.problem, DEPTH))
    write_replay(ready, trace, path, ORIGIN_S)
    return *read(path), ready, trace, d


def test_topics_have_the_types_that_tools_know(written):
    _, kinds, _, _, d = written
    walls = {"/walls": "nav_msgs/msg/OccupancyGrid"} if d == 2 else {}
    assert kinds == walls | {
        "/tf": "tf2_msgs/msg/TFMessage",
        "/odom": "nav_msgs/msg/Odometry",
        "/cmd_vel": "geometry_msgs/msg/TwistStamped",
        "/detections": "vision_msgs/msg/Detection3DArray",
        "/targets": "geometry_msgs/msg/PoseArray",
        "/beliefs/target_anna": "geometry_msgs/msg/PoseWithCovarianceStamped",
        "/beliefs/target_7_b": "geometry_msgs/msg/PoseWithCovarianceStamped",
        "/beliefs/markers": "visualization_msgs/msg/MarkerArray",
    }


def test_poses_are_those_of_the_trace(written):
    found, _, _, trace, d = written
    assert [stamp for stamp, _ in found["/odom"]] == [
        round((ORIGIN_S + 0.5 * k) * 10) * 10**8 for k in range(len(trace.pose))
    ]
    for k, ((_, odometry), (_, moved)) in enumerate(zip(found["/odom"], found["/tf"], strict=True)):
        p, q = odometry.pose.pose.position, odometry.pose.pose.orientation
        turn = Rotation.from_quat([q.x, q.y, q.z, q.w])
        if d == 2:
            np.testing.assert_allclose([p.x, p.y], trace.pose[k][:2], atol=1e-6)
            yaw = turn.as_euler("ZYX")[0]
            assert np.angle(np.exp(1j * (yaw - trace.pose[k][2]))) == pytest.approx(0.0, abs=1e-6)
        else:
            np.testing.assert_allclose([p.x, p.y, p.z], trace.pose[k][:3, 3], atol=1e-5)
            np.testing.assert_allclose(turn.as_matrix(), trace.pose[k][:3, :3], atol=1e-5)
        (transform,) = moved.transforms
        assert transform.transform.translation.x == p.x
        assert (transform.header.frame_id, transform.child_frame_id, transform.header.stamp.sec) == (
            "map", "base_link", ORIGIN_S + k // 2,
        )  # fmt: skip
    speed = found["/cmd_vel"][0][1].twist.linear.x
    step = np.asarray(trace.pose[1])[:2] - np.asarray(trace.pose[0])[:2] if d == 2 else None
    if step is not None:
        assert np.linalg.norm(step) <= abs(speed) * 0.5 + 1e-6  # an arc is longer than its chord


def test_walls_are_those_of_the_scenario(written):
    """Sent once: their occupied cells have the area of the box, but for half a cell all around."""
    found, _, _, _, d = written
    if d == 3:
        assert "/walls" not in found
        return
    ((stamp, walls),) = found["/walls"]
    assert (stamp, walls.header.frame_id) == (ORIGIN_S * 10**9, "map")
    rows, columns = np.nonzero(walls.data.reshape(walls.info.height, walls.info.width))
    corner, cell = walls.info.origin.position, walls.info.resolution
    for indices, low, first, last in ((columns, corner.x, -4.0, -3.6), (rows, corner.y, -3.0, 2.0)):
        assert low + cell * indices.min() == pytest.approx(first, abs=0.51 * cell)
        assert low + cell * (indices.max() + 1) == pytest.approx(last, abs=0.51 * cell)
    assert len(rows) == (np.ptp(rows) + 1) * (np.ptp(columns) + 1)


def test_beliefs_and_detections_are_those_of_the_trace(written):
    found, _, ready, trace, d = written
    names = [ready.slots.track_ids[i] if i >= 0 else "" for i in ready.slots.track_index[-1]]
    column = names.index("anna")
    assert len(found["/beliefs/target_anna"]) == len(trace.pose)
    assert len(found["/beliefs/target_7_b"]) < 12
    for k, (_, belief) in enumerate(found["/beliefs/target_anna"]):
        p = belief.pose.pose.position
        np.testing.assert_allclose([p.x, p.y, p.z][:d], np.asarray(trace.mean)[k, column, :d], atol=1e-6)
        P = np.linalg.inv(np.asarray(trace.information, float)[k, column])[:d, :d]
        np.testing.assert_allclose(belief.pose.covariance.reshape(6, 6)[:d, :d], P, rtol=1e-5, atol=1e-12)
    seen = [{each.id for each in message.detections} for _, message in found["/detections"]]
    assert ["anna" in ids for ids in seen] == np.asarray(trace.visible)[:, column].tolist()
    errors = [
        np.array([box.x, box.y, box.z])[:d] - ready.slots.positions_m[k + 1, column]
        for k, (_, message) in enumerate(found["/detections"])
        for box in [each.bbox.center.position for each in message.detections if each.id == "anna"]
    ]
    assert len(errors) > 5
    assert 0 < np.abs(errors).max() < 5 * float(np.sqrt(np.asarray(ready.problem.period.V)[0, 0, 0]))
    assert len(found["/targets"][-1][1].poses) == 1
    markers = found["/beliefs/markers"][0][1].markers
    assert {"beliefs", "ids", "targets", "view"} <= {each.ns for each in markers}


@pytest.mark.slow
def test_replay_writes_a_bag(tmp_path, capsys):
    csv, path = tmp_path / "walk.csv", tmp_path / "run.mcap"
    rows = [f"{t},a,{2 + 0.1 * t},0.5\n" for t in TIMES]
    csv.write_text("time_s,track_id,x_m,y_m\n" + "".join(rows))
    assert main(["replay", "pan", str(csv), "--method", "nearest", "--out", str(path)]) == 0
    assert f"{path}: a bag (nearest)" in capsys.readouterr().out
    assert [each.name for each in tmp_path.iterdir() if each.name != "walk.csv"] == ["run.mcap"]
    again = load_recording(path, topics=["/targets"], planar=True)
    np.testing.assert_allclose(again.tracks[0].positions_m[:, 0], 2 + 0.1 * again.tracks[0].times_s, atol=1e-9)


def test_without_rosbags_it_says_what_to_install(written, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(InputError, match=r"pip install 'foveate\[ros\]'"):
        write_replay(written[2], written[3], tmp_path / "a.mcap")
