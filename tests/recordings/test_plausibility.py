"""Warnings about a recording that contradicts its scenario."""

from helpers.recordings import TAU

from foveate.recordings.plausibility import warnings_for
from foveate.recordings.replay import prepare_replay
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.target import DriftTarget


def test_warnings_name_the_contradiction(scenario, recording):
    ready = prepare_replay(scenario, recording, [0.0, 0.0, 0.0], 2.0)
    said = " ".join(warnings_for(scenario, recording, ready.slots, 2.0))
    assert "up to 4 targets at once" in said
    tight = Scenario(
        tau_s=TAU, target=DriftTarget(process_std_m=0.001), scenes=SceneSettings(targets_max=9, known_drift=False)
    )
    said = " ".join(warnings_for(tight, recording, ready.slots, 2.0))
    assert "W claims" in said
    assert "at once" not in said
