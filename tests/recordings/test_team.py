"""A team on a recording: each robot against the replay of a single one, and all against geometry."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.recordings import ANGLE, DEPTH, TAU
from helpers.rejections import assert_rejected

from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.planning.named import heuristic_policy
from foveate.recordings.compare import replay
from foveate.recordings.replay import drive, prepare_replay
from foveate.recordings.starts import agent_starts, default_agent_start, random_agent_starts
from foveate.ros.bag import write_bag
from foveate.scenario.detections import DetectionSettings
from foveate.scenario.kinds import RobotSettings
from foveate.scenario.team import RadioSettings, TeamSettings

POSES = (0.0, 0.0, 0.0), (2.0, 5.0, -1.5), (-2.0, -1.0, 3.0)
ALL = [number for pose in POSES for number in pose]
SILENT, PERFECT = RadioSettings(loss=1.0), RadioSettings()


def team_of(scenario, radio):
    return replace(scenario, team=TeamSettings(agents=3, radio=radio))


def still(scenario, recording, start, gate=0.9999):
    ready = prepare_replay(scenario, recording, start, 2.0, gate=gate)
    return ready, *drive(ready, "still", heuristic_policy("still", ready.problem, DEPTH))


def inside(pose, position, depth_m=DEPTH):
    """In the sector ahead of a robot."""
    x, y, yaw = pose
    away = math.hypot(position[0] - x, position[1] - y)
    turn = math.atan2(position[1] - y, position[0] - x) - yaw
    return away <= depth_m and abs(math.degrees(math.remainder(turn, 2 * math.pi))) <= ANGLE / 2


def test_without_a_radio_the_first_robot_is_alone(scenario, recording):
    _, alone, single = still(scenario, recording, POSES[0])
    _, row, trace = still(team_of(scenario, SILENT), recording, ALL)
    np.testing.assert_array_equal(trace.team.visible[:, 0], single.visible)
    np.testing.assert_allclose(trace.team.log_det[:, 0], single.log_det, atol=1e-12)
    np.testing.assert_array_equal(trace.team.rejections[:, 0], single.rejections)
    assert alone.rejected > 0  # `a` walks straight on, as this scenario does not expect
    own = row.robots[0]
    assert own.log_det_mean == pytest.approx(alone.log_det_mean)
    assert own.nees == pytest.approx(alone.nees)
    assert own.seen_time_fraction == alone.seen_time_fraction
    assert [each.heard_fraction for each in row.robots] == [0, 0, 0]
    assert row.worst_log_det_mean == min(each.log_det_mean for each in row.robots)
    assert row.log_det_mean > own.log_det_mean


def test_robots_with_a_radio_know_what_all_have_seen(scenario, recording):
    ready, row, trace = still(team_of(scenario, PERFECT), recording, ALL, gate=None)
    for each in row.robots:
        assert each.log_det_mean == pytest.approx(row.log_det_mean)
        assert each.nees == pytest.approx(row.nees)
        assert each.heard_fraction == 1.0
    slots = ready.slots
    counted = slots.present[1:] & slots.present[:-1]
    seen = np.array([[[inside(pose, p) for p in row] for row in slots.positions_m[1:]] for pose in POSES])
    np.testing.assert_array_equal(trace.team.visible[:, :, :][np.repeat(counted[:, None], 3, axis=1)],
                                  np.moveaxis(seen, 0, 1)[np.repeat(counted[:, None], 3, axis=1)])  # fmt: skip
    assert row.seen_time_fraction == pytest.approx(seen.any(axis=0)[counted].mean())
    for own, each in zip(seen, row.robots, strict=True):
        assert each.seen_time_fraction == pytest.approx(own[counted].mean())
    # A target that appears begins in all beliefs, and in the same one.
    begins = slots.present[1:] & ~slots.present[:-1]
    np.testing.assert_allclose(trace.information[1:][begins], np.eye(2) / 2.0 * np.ones((begins.sum(), 1, 1)))
    np.testing.assert_allclose(trace.team.log_det[begins.any(axis=1)][:, 0][begins[begins.any(axis=1)]], -2 * np.log(2))


def test_robots_without_ids_are_no_team_on_a_recording(scenario, recording):
    box = DetectionSettings(low_m=(-50.0, -50.0), high_m=(50.0, 50.0), cells=(4, 4))
    without = replace(team_of(scenario, PERFECT), detections=box)
    assert_rejected(lambda: prepare_replay(without, recording, ALL), "scenario.team.agents = 3: expected 1 with")


def test_robots_of_different_kinds_see_by_their_own_views(scenario, recording):
    """A second robot that sees half as far: its share of the time follows from where the targets are."""
    short = RobotSettings(view=replace(scenario.view, depth_m=DEPTH / 2))
    mixed = replace(scenario, team=TeamSettings(agents=3, robots=(RobotSettings(), short)))
    ready, row, _ = still(mixed, recording, ALL)
    slots = ready.slots
    counted = slots.present[1:] & slots.present[:-1]
    for pose, depth_m, own in zip(POSES, (DEPTH, DEPTH / 2, DEPTH), row.robots, strict=True):
        seen = np.array([[inside(pose, p, depth_m) for p in each] for each in slots.positions_m[1:]])
        assert own.seen_time_fraction == pytest.approx(seen[counted].mean())
    alike = still(team_of(scenario, PERFECT), recording, ALL)[1]
    assert row.robots[1].seen_time_fraction < alike.robots[1].seen_time_fraction


def test_the_others_start_at_random_places_or_where_they_are_told(scenario, recording):
    team = team_of(scenario, SILENT)
    default = np.reshape(default_agent_start(recording, team), (3, 3))
    np.testing.assert_array_equal(default[0], default_agent_start(recording, scenario))
    starts = np.reshape(random_agent_starts(recording, team, 20, seed=3), (20, 3, 3))
    np.testing.assert_array_equal(starts[:, 0], random_agent_starts(recording, scenario, 20, seed=3))
    lower, upper = recording.extent
    assert ((starts[..., :2] >= lower) & (starts[..., :2] <= upper)).all()
    assert np.ptp(starts, axis=(0, 1)).min() > 1.0
    assert len(np.unique(starts[..., 0])) == 60
    (first,) = agent_starts(recording, team, POSES[1], 1, seed=0)
    np.testing.assert_allclose(np.reshape(first, (3, 3))[0], POSES[1])
    assert agent_starts(recording, team, ALL, 1, seed=0) == [ALL]
    with pytest.raises(InputError, match=r"agent_start 0,0,1,2:.*, or the poses of all 3 robots"):
        agent_starts(recording, team, (0.0, 0.0, 1.0, 2.0), 1, seed=0)


def test_a_replay_has_a_table_and_a_record_of_every_robot(scenario, recording, tmp_path):
    team = team_of(scenario, RadioSettings(range_m=6.0, loss=0.5))
    policy = heuristic_policy("nearest", team.problem(), DEPTH)
    method = ["nearest", "uncertain+greedy"]
    result = replay(policy, recording, scenario=team, method=method, starts=2, progress=False)
    table, robots = result.table, result.robots_table
    assert [row[0] for row in table.rows] == method
    assert {"robots", "worst log det", "robots' NEES"} <= set(table.header)
    assert [row[:2] for row in robots.rows] == [(name, str(m)) for name in method for m in (1, 2, 3)]
    mine = [row for row in result.rows if row.method == "uncertain+greedy"]
    heard = np.mean([row.robots[1].heard_fraction for row in mine])
    assert robots.rows[4][robots.header.index("heard")] == f"{heard:.1%}"
    assert 0 < heard < 0.6
    assert str(table.title) in repr(result)
    assert str(robots.title) in repr(result)
    result.to_json(tmp_path / "replay.json")
    for row, each in zip(json.loads((tmp_path / "replay.json").read_text())["rows"], result.rows, strict=True):
        assert row["agents"] == 3
        assert row["robots"][2]["log_det_mean"] == each.robots[2].log_det_mean
        assert len(row["agent_start"]) == 9
    with pytest.raises(InputError, match="for a team"):
        write_bag(result, tmp_path / "a.mcap")


def test_a_single_robot_has_no_columns_of_a_team(scenario, recording):
    result = replay(
        heuristic_policy("still", scenario.problem(), DEPTH),
        recording,
        scenario=scenario,
        method="still",
        progress=False,
    )
    assert result.robots_table is None
    assert "robots" not in result.table.header
    assert not {"agents", "robots", "worst_log_det_mean", "members_nees"} & set(result.rows[0].record())


def test_what_is_for_the_other_kind_of_scenario_is_rejected(scenario, recording):
    for given, method, why in (
        (team_of(scenario, SILENT), "refine-3", "refine-3: expected none with scenario.team.agents = 3"),
        (scenario, "icr+greedy", "the scenario has no team"),
        (scenario, "nearest+greedy", "the scenario has no team"),
        (team_of(scenario, SILENT), "nearest+best", "NAME"),
    ):
        assert Experiment(scenario=given).scenario.tau_s == TAU
        policy = heuristic_policy("still", given.problem(), DEPTH)
        with pytest.raises(InputError, match=why):
            replay(policy, recording, scenario=given, method=method, progress=False)
