"""Settings of the region: what cannot be kept is rejected in one line, and a world without it says nothing of it."""

import pytest
from helpers.rejections import assert_rejected

from foveate.experiment.experiment import Experiment
from foveate.io.toml import dumps_toml, load_toml
from foveate.scenario.region import RegionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.target import LinearTarget

EYE = ((1.0, 0.0), (0.0, 1.0))
TURNED = LinearTarget(kind="linear", A=EYE, B=EYE, W=EYE, Z=EYE[::-1], prior=EYE)
YARD = RegionSettings(low_m=(-5.0, -5.0), high_m=(5.0, 5.0))
STILL = SceneSettings(drift_m_s=(0.0, 0.0))

BAD = {
    "crossed": (lambda: RegionSettings(low_m=(0.0, 0.0), high_m=(1.0, 0.0)), "high_m = (1.0, 0.0): expected > low_m"),
    "of two sizes": (lambda: RegionSettings(low_m=(0.0, 0.0), high_m=(1.0,)), "high_m = (1.0,): expected 2 numbers"),
    "gaining": (
        lambda: RegionSettings(low_m=(0.0,), high_m=(1.0,), restitution=1.5),
        "restitution = 1.5: expected 0 to 1",
    ),
    "of another space": (
        lambda: Scenario(region=RegionSettings(low_m=(0.0,) * 3, high_m=(1.0,) * 3)),
        "region.low_m = (0.0, 0.0, 0.0): expected 2 numbers, one per axis",
    ),
    "without a position": (lambda: Scenario(target=TURNED, scenes=STILL, region=YARD), "region.targets = 'bounce'"),
    "with births": (lambda: Scenario(scenes=SceneSettings(birth_and_death=True), region=YARD), "expected 'free'"),
    "no distance": (lambda: Scenario(keep_off_m=0.0), "keep_off_m = 0.0: expected > 0"),
}


@pytest.mark.parametrize("name", BAD)
def test_wrong_settings_are_rejected(name):
    assert_rejected(*BAD[name])


def test_free_targets_may_be_born_and_have_any_state():
    free = RegionSettings(low_m=(-5.0, -5.0), high_m=(5.0, 5.0), targets="free")
    assert Scenario(scenes=SceneSettings(birth_and_death=True), region=free).problem().bounds_targets is False
    assert Scenario(target=TURNED, scenes=STILL, region=free).problem().bounds_agent is True


def test_a_world_in_toml(tmp_path):
    path = tmp_path / "world.toml"
    path.write_text(
        "[scenario]\nkeep_off_m = 1\n[scenario.region]\nlow_m = [-5, -5]\nhigh_m = [5, 5]\nrestitution = 0.4\n"
        "[scenario.agent]\ncommands = [[0, -1], [0, 1], [2, 0]]\n"
    )
    scenario = load_toml(Experiment, path).scenario
    assert (scenario.keep_off_m, scenario.region.restitution) == (1.0, 0.4)
    assert scenario.agent.commands == ((0.0, -1.0), (0.0, 1.0), (2.0, 0.0))
    path.write_text(dumps_toml(Experiment(scenario=scenario)))
    assert load_toml(Experiment, path).scenario == scenario
    assert not {"region", "keep_off_m", "commands"} & set(dumps_toml(Experiment()).replace("[", " ").split())
