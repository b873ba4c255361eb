"""`foveate config`, `foveate presets`, `foveate train --set`, and unknown names on the command line."""

import json
import re
import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from helpers.commands import failure

from foveate.cli.main import COMMANDS, main
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.experiment.resolve import TRAINED
from foveate.experiment.run_folder import BEST, CONFIG, Outcome
from foveate.io.toml import load_toml
from foveate.names import PRESET_NAMES

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[Experiment]:
    """Experiments that `foveate train` would train; nothing is trained."""
    found: list[Experiment] = []

    def train(experiment, out, seed, resume, report) -> Outcome:
        found.append(experiment)
        return Outcome(epochs=1, best_epoch=1, best_score=0.5, rollbacks=0, stopped="")

    monkeypatch.setattr("foveate.cli.run.train.train", train)
    return found


def edited(source: Path, place: Path) -> Path:
    """A copy of a config.toml with another depth of the view, and with its old digest."""
    text = source.read_text(encoding="utf-8")
    assert 'digest = "' in text
    place.write_text(text.replace("depth_m = 2.0", "depth_m = 5.0"), encoding="utf-8")
    return place


def test_a_printed_preset_is_taken_as_it_is_and_edited(tmp_path: Path, capsys: Capture, begun: list[Experiment]):
    mine = tmp_path / "mine.toml"
    for name in PRESET_NAMES:
        assert main(["config", name]) == 0
        mine.write_text(capsys.readouterr().out, encoding="utf-8")
        assert load_toml(Experiment, mine) == PRESETS[name]
    assert main(["config", "true-view", "--set", "scenario.view.depth_m=5", "--set", "training.epochs=7"]) == 0
    printed = capsys.readouterr().out
    assert "digest" not in printed
    mine.write_text(printed.replace("epochs = 7", "epochs = 8"), encoding="utf-8")
    assert main(["train", "--config", str(mine), "--out", str(tmp_path / "run")]) == 0
    base = PRESETS["true-view"]
    view = replace(base.scenario.view, depth_m=5.0)
    assert begun == [
        replace(base, scenario=replace(base.scenario, view=view), training=replace(base.training, epochs=8))
    ]
    assert "was changed" not in capsys.readouterr().err


def test_set_changes_a_preset(tmp_path: Path, begun: list[Experiment], capsys: Capture):
    """Several values after one --set, and several of them; --epochs, an option of its own, comes last."""
    given = ["--set", "scenario.view.depth_m=5", "training.epochs=9", "--set=scenario.sensor.std_m=0.1"]
    assert main(["train", *given, "--epochs", "3", "--out", str(tmp_path / "run")]) == 0
    (found,) = begun
    assert (found.scenario.view, found.scenario.sensor) == (
        replace(PRESETS["paper"].scenario.view, depth_m=5.0),
        replace(PRESETS["paper"].scenario.sensor, std_m=0.1),
    )
    assert found.training.epochs == 3
    out = ("--out", str(tmp_path / "x"))
    assert "did you mean depth_m?" in failure(capsys, "train", "--set", "scenario.view.dept_m=5", *out)
    assert "--set and --resume" in failure(capsys, "train", "--set", "training.epochs=5", "--resume", "nowhere")


def test_an_edited_copy_is_taken_with_a_word_and_an_edited_run_refused(
    tmp_path: Path, begun: list[Experiment], capsys: Capture
):
    copy = edited(TRAINED / "paper" / CONFIG, tmp_path / "mine.toml")
    assert main(["train", "--config", str(copy), "--out", str(tmp_path / "run")]) == 0
    assert begun[0].scenario.view == replace(PRESETS["paper"].scenario.view, depth_m=5.0)
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.startswith(f"{copy}: was changed since foveate wrote it")
    run = Path(shutil.copytree(TRAINED / "paper", tmp_path / "paper"))
    edited(run / CONFIG, run / CONFIG)
    assert (run / BEST).exists()
    for command in (["evaluate", run], ["config", run], ["train", "--resume", run]):
        assert "does not fit its digest" in failure(capsys, *command)


def test_presets_are_listed_with_cards(tmp_path: Path, capsys: Capture):
    out = tmp_path / "cards.json"
    assert main(["presets", "--json", str(out)]) == 0
    printed, shipped = capsys.readouterr().out, {path.name for path in TRAINED.iterdir()}
    assert all(f"\n{name} " in printed for name in shipped)
    assert {card["name"] for card in json.loads(out.read_text(encoding="utf-8"))} == shipped
    assert main(["presets", "search", "pan"]) == 0
    printed = capsys.readouterr().out
    for subject in ("Data", "Score", "Limits", "Size", "Licence"):
        assert printed.count(f"\n{subject} ") == 2
    assert "did you mean pan?" in failure(capsys, "presets", "pann")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["tran"], "tran: no such command; did you mean train?"),
        (["train", "--presett", "x"], "--presett: no such option of foveate train; did you mean --preset?"),
        (["train", "--preset", "papper"], "--preset papper: expected one of paper, best"),
        (["train", "--preset=papper"], "did you mean paper?"),
        (["fit", "--goal", "see"], "did you mean seen?"),
        (["train", "--seed", "1", "--seed", "2"], "--seed: is given twice"),
        (["train", "-q", "-v"], "--quiet and --verbose: expected one of them"),
    ],
)
def test_unknown_names_are_one_line_with_the_nearest(given: list[str], words: str, capsys: Capture):
    assert words in failure(capsys, *given)


def test_known_names_pass(capsys: Capture):
    """Aliases, negations, underscores, and the former name of an option: wrong is only the run that does not exist."""
    for given in (["--closeness"], ["--normalised"], ["--no-wide"], ["--scene_seed", "3"], ["--initial-error=paper"]):
        assert "no such run folder" in failure(capsys, "evaluate", "nowhere", *given)


@pytest.mark.parametrize("columns", [60, 80, 140])
@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_is_wrapped_to_the_terminal(command: str, columns: int, capsys: Capture, monkeypatch: pytest.MonkeyPatch):
    """No line is longer, and prose has no ragged breaks: a line ends where the next word would not fit."""
    monkeypatch.setenv("COLUMNS", str(columns))
    with pytest.raises(SystemExit):
        main([command, "--help"] if command else ["--help"])
    usage, _, text = capsys.readouterr().out.partition("\n")
    assert usage.startswith("usage: foveate")
    lines = re.split(r"^ \w.*\n -+ *$", text, maxsplit=1, flags=re.MULTILINE)[0].splitlines()
    examples = [line for line in lines if line.strip().startswith("foveate ") and line.startswith("   ")]
    assert len(examples) == (COMMANDS[command].__doc__ or "").count("\n      foveate ") if command else 3
    prose = [line for line in lines if line.startswith(" ") and not line.startswith("   ")]
    assert prose
    assert max(map(len, prose)) <= columns
    width = min(columns, 100)
    for line, after in pairwise(lines):
        if line in prose and after in prose:
            assert len(f"{line} {after.split()[0]}") > width, line
