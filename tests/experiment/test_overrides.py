"""Settings changed by their dotted keys: read as strictly as a file with these changes."""

from dataclasses import replace
from pathlib import Path

import pytest

from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.experiment.overrides import with_changes
from foveate.experiment.presets import PRESETS
from foveate.io.toml import load_toml

PAPER = PRESETS["paper"]


def test_changes_equal_those_of_a_file(tmp_path: Path):
    file = tmp_path / "e.toml"
    file.write_text(
        '[scenario]\ntau_s = 0.5\n[scenario.view]\nshape = "cone"\ndepth_m = 5\n'
        '[scenario.agent]\nkind = "quadrotor"\n[scenario.target]\nkind = "constant_velocity"\n'
        "[scenario.scenes]\ndrift_m_s = [0.1, 0, 1e-3]\ncentre_m = [0, 0, 1]\nhalf_side_m = [4, 4, 1]\n"
    )
    given = [
        *("scenario.view.depth_m=5", "scenario.view.shape=cone", "scenario.tau_s = 0.5"),
        *("scenario.agent.kind=quadrotor", 'scenario.target={kind = "constant_velocity"}'),
        *("scenario.scenes.drift_m_s=[0.1, 0, 1e-3]", "scenario.scenes.centre_m=[0,0,1]"),
        "scenario.scenes.half_side_m=[4,4,1]",
    ]
    assert with_changes(PAPER, given) == load_toml(Experiment, file)
    assert with_changes(PAPER, []) is PAPER


def test_a_change_of_a_key_keeps_its_neighbours():
    changed = with_changes(PRESETS["true-view"], ["training.epochs=7", 'training.objective="mean"'])
    assert changed == replace(
        PRESETS["true-view"], training=replace(PRESETS["true-view"].training, epochs=7, objective="mean")
    )


def test_a_key_without_a_value_is_left_out():
    begun = with_changes(PRESETS["any"], ["policy.begin_with=any", "policy.assignment=auction"])
    assert begun.policy != PRESETS["any"].policy
    assert with_changes(begun, ["policy.begin_with=", "policy.assignment = "]) == PRESETS["any"]


def test_naming_the_same_kind_again_clears_nothing():
    pan = PRESETS["pan"]
    assert with_changes(pan, ["scenario.agent.kind=body", "scenario.view.shape=sector"]) == pan


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("scenario.view.dept_m=5", "--set: scenario.view.dept_m = 5: unknown key; did you mean depth_m?"),
        ("scenario.veiw.depth_m=5", "--set: scenario.veiw = {'depth_m': 5}: unknown key; did you mean view?"),
        ("scenario.view.depth_m=five", "--set: scenario.view.depth_m = 'five': expected a finite number"),
        ("scenario.view.depth_m=nan", "--set: scenario.view.depth_m = nan: expected a finite number"),
        ("scenario.view.shape=cube", "--set: scenario.view.shape = 'cube': expected one of"),
        ("training.epochs=0", "--set: training: epochs = 0: expected >= 1"),
        ("training.epochs=", "--set: training.epochs = None: expected a whole number"),
        ("policy.begn_with= ", "--set: policy.begn_with = None: unknown key"),
        ("scenario.tau_s.x=1", "--set: scenario.tau_s = {'x': 1}: expected a finite number"),
        ("training.epochs", "--set training.epochs: expected KEY=VALUE"),
        ("=5", "--set =5: expected KEY=VALUE"),
        ("training..epochs=5", "--set training..epochs=5: expected KEY=VALUE"),
        ("training.epochs=1\nseed=2", "--set: training.epochs = '1\\nseed=2': expected a whole number"),
    ],
)
def test_wrong_changes_are_named(change: str, words: str):
    with pytest.raises(InputError) as raised:
        with_changes(PAPER, [change])
    assert str(raised.value).startswith(words)
