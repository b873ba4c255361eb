"""Settings of a team: what cannot be is rejected in one line, and a scenario without a team says nothing of it."""

from dataclasses import replace

import pytest
from helpers.rejections import assert_rejected
from helpers.worlds_of_detections import HALL

from foveate.experiment.experiment import Experiment
from foveate.io.toml import dumps_toml, load_toml
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.kinds import RobotSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene, SceneSettings, checked, read_scenes, write_scenes
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.team import RadioSettings, TeamSettings
from foveate.simulation.suites import own_suite, scene_episodes

PAIR = TeamSettings(agents=2)
BAD = {
    "nobody": (lambda: TeamSettings(agents=0), "agents = 0: expected 1 to 1024"),
    "a box of negative size": (lambda: TeamSettings(agents=2, half_side_m=(-1.0, 1.0)), "half_side_m"),
    "a box in another space": (
        lambda: Scenario(team=TeamSettings(agents=2, half_side_m=(1.0,))),
        "team.half_side_m = (1.0,): expected 2 numbers",
    ),
    "a loss above 1": (lambda: RadioSettings(loss=1.5), "loss = 1.5: expected 0 to 1"),
    "a negative range": (lambda: RadioSettings(range_m=-1.0), "range_m = -1.0: expected >= 0"),
    "a negative delay": (lambda: RadioSettings(delay_steps=-1), "delay_steps = -1: expected >= 0"),
    "a memory of the delay": (
        lambda: RadioSettings(delay_steps=8),
        "memory_steps = 8: expected more than delay_steps = 8, at most 64",
    ),
    "births": (lambda: Scenario(team=PAIR, scenes=SceneSettings(birth_and_death=True)), "birth_and_death = True"),
    "missed detections": (
        lambda: Scenario(team=PAIR, sensor=SensorSettings(missed_detections="used")),
        "sensor.missed_detections = 'used': expected none for a team",
    ),
    "tracks of robots with different views": (
        lambda: replace(HALL, team=TeamSettings(agents=2, robots=(RobotSettings(view=SectorView(depth_m=1.0)),))),
        "team.robots[0].view = '[..]': expected the scenario's",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_wrong_settings_are_rejected(name):
    assert_rejected(*BAD[name])


@pytest.mark.parametrize(
    ("radio", "kind"),
    [({}, "perfect"), ({"loss": 1.0}, "silent"), ({"range_m": 9.0}, "lossy"), ({"delay_steps": 1}, "lossy")],
    ids=str,
)
def test_kinds_of_radio(radio, kind):
    team = TeamSettings(agents=3, radio=RadioSettings(**radio)).team()
    assert team is not None
    assert (team.agents, team.radio.kind) == (3, kind)
    assert TeamSettings(agents=1, radio=RadioSettings(**radio)).team() is None


def test_a_team_in_toml(tmp_path):
    path = tmp_path / "team.toml"
    path.write_text(
        "[scenario.team]\nagents = 4\nhalf_side_m = [9, 9]\n[scenario.team.radio]\nrange_m = 15\nloss = 0.5\n"
    )
    team = load_toml(Experiment, path).scenario.team
    assert team == TeamSettings(agents=4, half_side_m=(9.0, 9.0), radio=RadioSettings(range_m=15.0, loss=0.5))
    path.write_text(dumps_toml(Experiment(scenario=Scenario(team=team))))
    assert load_toml(Experiment, path).scenario.team == team
    assert "team" not in dumps_toml(Experiment())


def test_scenes_have_the_poses_of_all_robots(tmp_path):
    scenario = Scenario(team=TeamSettings(agents=3, half_side_m=(9.0, 9.0)), scenes=SceneSettings(targets_max=3))
    problem, path = scenario.problem(), tmp_path / "scenes.json"
    scenes = own_suite(scenario.scenes, problem)[:2]
    assert all(len(scene.others) == 2 for scene in scenes)
    write_scenes(path, scenes)
    assert read_scenes(path, problem.agent.space, scenario.scenes) == scenes
    episodes = scene_episodes(problem, scenario.scenes, scenes, 0, 1)
    assert episodes.team is not None
    assert episodes.team.poses[1].tolist() == [list(pose) for pose in scenes[1].others]
    lonely = [replace(scenes[0], others=())]
    assert_rejected(lambda: scene_episodes(problem, scenario.scenes, lonely, 0, 1), "others = 0: expected 2 poses")
    short = [Scene(id="a", agent=(0.0, 0.0, 0.0), targets=((1.0, 1.0),), others=((1.0, 2.0),))]
    assert_rejected(lambda: checked(short, problem.agent.space, scenario.scenes), "others[0] = [1.0, 2.0]: planar pose")


def test_a_single_robot_has_no_others():
    problem = Scenario().problem()
    assert "others" not in own_suite(SceneSettings(), problem)[0].record()
