"""Settings of robots of different kinds: what they inherit, and what cannot differ."""

from dataclasses import replace

import pytest
from helpers.rejections import assert_rejected

from foveate.cli.main import main
from foveate.experiment.experiment import Experiment
from foveate.io.toml import dumps_toml, load_toml
from foveate.scenario.agent import DifferentialDrive, FreeBody
from foveate.scenario.field_of_view import PolygonView, SectorView
from foveate.scenario.kinds import RobotSettings
from foveate.scenario.obstacles import ShapeObstacles
from foveate.scenario.scenario import Scenario
from foveate.scenario.sensor import ScheduleSettings, SensorSettings
from foveate.scenario.team import TeamSettings

TEXT = """
[scenario.agent]
v_max_m_s = 3.0
w_max_rad_s = 0.5
[scenario.view]
shape = "sector"
depth_m = 6.0
angle_deg = 60.0
[scenario.team]
agents = 3
[[scenario.team.robots]]
view = { depth_m = 2.0 }
[[scenario.team.robots]]
agent = { v_max_m_s = 0.5 }
sensor = { std_m = 0.05 }
"""


def test_tables_of_a_robot_inherit_what_they_leave_out(tmp_path):
    path = tmp_path / "team.toml"
    path.write_text(TEXT)
    experiment = load_toml(Experiment, path)
    scenario = experiment.scenario
    first, second, third = (scenario.of_robot(i) for i in range(3))
    assert first.view == SectorView(depth_m=2.0, angle_deg=60.0)
    assert first.agent == scenario.agent
    assert second.agent == DifferentialDrive(v_max_m_s=0.5, w_max_rad_s=0.5)
    assert (second.view, second.sensor) == (scenario.view, SensorSettings(std_m=0.05))
    assert third == first
    assert first.team == TeamSettings(agents=3)
    path.write_text(dumps_toml(experiment))
    assert load_toml(Experiment, path) == experiment


def test_a_robot_that_names_the_kind_that_the_scenario_leaves_out_inherits_too(tmp_path):
    path = tmp_path / "team.toml"
    path.write_text(TEXT.replace("agent = { v_max", 'agent = { kind = "differential_drive", v_max'))
    second = load_toml(Experiment, path).scenario.of_robot(1)
    assert second.agent == DifferentialDrive(v_max_m_s=0.5, w_max_rad_s=0.5)


def test_tables_of_a_robot_inherit_defaults_that_no_file_names(tmp_path):
    path = tmp_path / "team.toml"
    path.write_text("[scenario.team]\nagents = 2\n[[scenario.team.robots]]\nview = { depth_m = 3.0 }\n")
    scenario = load_toml(Experiment, path).scenario
    assert scenario.of_robot(1).view == replace(Scenario().view, depth_m=3.0)


def team(*robots, agents=2, **changes):
    return lambda: Scenario(team=TeamSettings(agents=agents, robots=tuple(robots)), **changes)


def robot(**parts):
    return RobotSettings(**parts)


BODY = FreeBody(space="planar", axes=("vx", "wz"), lower=(0.0, -1.0), upper=(1.0, 1.0))
SQUARE = PolygonView(vertices_m=((0.0, -1.0), (2.0, -1.0), (2.0, 1.0), (0.0, 1.0)))
KITE = PolygonView(vertices_m=((0.0, 0.0), (2.0, -1.0), (2.0, 1.0)))
V = ((0.04, 0.0), (0.0, 0.09))
WALL = ShapeObstacles(circles=((9.0, 9.0, 1.0),), resolution_m=0.5, keep_off_m=0.1)
BAD = {
    "more kinds than robots": (team(robot(), robot(), robot()), "expected 1 to agents = 2 tables"),
    "no kind": (team(), "robots = (): expected 1 to agents = 2 tables"),
    "kinds of a single robot": (team(robot(), agents=1), "expected none for a single robot, which is the scenario's"),
    "another body": (team(robot(agent=BODY)), "team.robots[0].agent.kind = 'body': expected 'differential_drive'"),
    "another shape": (
        team(robot(), robot(view=SectorView())),
        "team.robots[1].view.shape = 'sector': expected 'triangle', as in [scenario.view]: all robots of a team share",
    ),
    "another number of corners": (team(robot(view=KITE), view=SQUARE), "expected as many corners"),
    "other commands": (
        team(robot(agent=DifferentialDrive(commands=((0.0, 0.0),)))),
        "team.robots[0].agent.commands = ((0.0, 0.0),): expected as many rows of commands as in [scenario.agent]",
    ),
    "another measurement": (
        team(robot(sensor=SensorSettings(measures="bearing", std_bearing_rad=0.1))),
        "team.robots[0].sensor.measures = 'bearing': expected none, as in [scenario.sensor]",
    ),
    "another growth": (team(robot(sensor=SensorSettings(range_growth_per_m=0.1))), "sensor.range_growth_per_m = 0.1"),
    "a covariance": (team(robot(sensor=SensorSettings(V=V))), "team.robots[0].sensor.V = "),
    "a deviation where there is a covariance": (
        team(robot(sensor=SensorSettings(V=V, std_m=0.1)), sensor=SensorSettings(V=V)),
        "team.robots[0].sensor.std_m = 0.1: expected V in its place",
    ),
    "a scheduled covariance": (
        team(robot(sensor=SensorSettings(std_m=0.1)), schedule=ScheduleSettings(V=(V,))),
        "whose covariance schedule.V has for all robots",
    ),
    "no way to stand still": (
        team(robot(agent=DifferentialDrive(v_min_m_s=0.5)), obstacles=WALL),
        "obstacles.keep_off_m: agent: expected limits that allow to stand still",
    ),
    "a robot that the team lacks": (lambda: team(robot())().of_robot(2), "robot = 2: expected 0 to 1"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_differ_is_rejected(name):
    assert_rejected(*BAD[name])


def test_a_file_that_cannot_be_is_rejected_in_one_line(tmp_path, capsys):
    path = tmp_path / "team.toml"
    path.write_text(TEXT.replace("view = { depth_m = 2.0 }", 'view = { shape = "triangle" }'))
    assert main(["evaluate", f"any@{path}", "--scenes", "own"]) == 2
    error = capsys.readouterr().err.strip()
    assert error.endswith("'triangle': expected 'sector', as in [scenario.view]: all robots of a team share it")
    assert len(error.splitlines()) == 1
    path.write_text(TEXT.replace("depth_m = 2.0", "deph_m = 2.0"))
    assert main(["evaluate", f"any@{path}", "--scenes", "own"]) == 2
    assert "scenario.team.robots[0].view.deph_m = 2.0: unknown key; did you mean depth_m?" in capsys.readouterr().err
