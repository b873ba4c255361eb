"""The Python, commands and files that a reader copies from a page run; sizes are made smaller here."""

import re
import runpy
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from helpers.compilation import time_no_decision
from PIL import Image

import foveate
from foveate.cli.main import main
from foveate.evaluation.verdict import verdict_of, write_verdict
from foveate.experiment.checkpoint import load_run, save_tree, write_config
from foveate.experiment.experiment import Experiment
from foveate.experiment.first_policy import first_policy
from foveate.experiment.presets import PRESETS
from foveate.experiment.run_folder import BEST, Outcome
from foveate.io.records import from_table
from foveate.recordings.formats import load_recording
from foveate.scenario.scenes import read_scenes
from foveate.simulation.suites import table1

ROOT = Path(__file__).parents[1]
PAGES = sorted(path for folder in (".", "docs", "docs/api") for path in (ROOT / folder).glob("*.md"))
FENCE = re.compile(r"^ *```(\w*)\n(.*?)^ *```", re.DOTALL | re.MULTILINE)
IDS = [str(page.relative_to(ROOT)) for page in PAGES]

EPOCHS, EPISODES = 1, 8
"""Size of a training on a page."""
RUN_ELSEWHERE = {
    "deploy.md": "tests/deploy/onnx/test_export.py",
    "detections.md": "tests/deploy/test_detections.py",
    "gymnasium.md": "tests/gym/test_envs.py",
    "pictures.md": "tests/plotting/test_simulated.py",
    "stonesoup.md": "tests/stonesoup/test_manager.py",
    "training.md": "tests/test_api.py",
    "README.md": "tests/test_docs.py",
}
"""Python of these pages is run by the test of what it is about."""
RUN_HERE = {
    "tutorial.md",
    "space.md",
    "any.md",
    "cameras.md",
    "sensors.md",
    "comparison.md",
    "api.md",
    "ros.md",
    "obstacles.md",
    "teams.md",
}
QUOTED = {"equations.md"}
"""Lines of the code itself, which tests/test_docs.py finds there."""


def blocks(page: Path, *kinds: str) -> list[str]:
    """The code of a page in these languages, in order."""
    return [code for kind, code in FENCE.findall(page.read_text(encoding="utf-8")) if kind in kinds]


def commands(page: Path) -> Iterator[list[str]]:
    """Commands of the shell blocks of a page, one a line, without comments and where their output goes."""
    for block in blocks(page, "sh"):
        for line in block.splitlines():
            if words := shlex.split(line.partition(" > ")[0], comments=True):
                yield words


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The commands that the command line understood, none of which runs."""
    found: list[Any] = []
    monkeypatch.setattr("foveate.cli.main._run", lambda command: found.append(command) or 0)
    return found


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_command_of_a_page_is_understood(page: Path, asked: list[Any]):
    """By the command line itself, by the Makefile, by pyproject.toml. What they do is tested with each of them."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    for words in commands(page):
        match words:
            case ["foveate", *arguments]:
                assert main(arguments) == 0, words
                assert asked.pop()
            case ["make", target, *_]:
                assert re.search(rf"^{target}:", makefile, re.MULTILINE), words
            case ["python", "-m", "pip", "install", place]:
                assert set(place.removeprefix(".[").removesuffix("]").split(",")) <= set(extras), words
            case ["python", file, *_]:
                assert (ROOT / file).is_file(), words
            case ["source", ".venv/bin/activate"]:
                pass
            case _:
                pytest.fail(f"{page.name}: no test knows {shlex.join(words)}")
    text = page.read_text(encoding="utf-8")
    named = {name for group in re.findall(r"foveate\[([\w,]+)\]", text) for name in group.split(",")}
    assert named <= set(extras)


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_file_of_a_page_is_read(page: Path, tmp_path: Path):
    """Scenes, recordings and configurations; and a block in a language that no test here takes would be missed."""
    known = {"sh", "python", "toml", "json", "csv", "text", "bibtex"}
    assert {kind for kind, _ in FENCE.findall(page.read_text(encoding="utf-8"))} <= known
    scenario = PRESETS["paper"].scenario
    for text in blocks(page, "json"):
        (tmp_path / "scenes.json").write_text(text, encoding="utf-8")
        assert read_scenes(tmp_path / "scenes.json", scenario.problem().agent.space, scenario.scenes)
    for text in blocks(page, "csv"):
        (tmp_path / "recording.csv").write_text(text, encoding="utf-8")
        assert load_recording(tmp_path / "recording.csv").tracks
    for text in blocks(page, "toml"):
        assert from_table(Experiment, tomllib.loads(text), page.name)


def test_the_python_of_every_page_runs_somewhere():
    pages = {page.name for page in PAGES if blocks(page, "python")}
    assert pages == {*RUN_ELSEWHERE, *RUN_HERE, *QUOTED}
    for name, test in RUN_ELSEWHERE.items():
        assert name in (ROOT / test).read_text(encoding="utf-8")


def fresh(folder: Path, preset: str) -> None:
    """A run folder with the initial weights of a preset."""
    left_untrained(PRESETS[preset], folder)


def left_untrained(experiment: Experiment, out: Path, *_: object) -> Outcome:
    """What a training leaves in its run folder, with the weights that it begins with."""
    (out / BEST).parent.mkdir(parents=True)
    write_config(out, experiment)
    save_tree(out / BEST, first_policy(experiment, jax.random.key(0)), experiment, "policy", {})
    return Outcome(epochs=EPOCHS, best_epoch=0, best_score=0.0, rollbacks=0, stopped="")


def judged(run: Path, quiet: bool) -> foveate.Verdict:
    """A verdict without the seconds that it takes."""
    scores = {"policy": np.array([2.0, 3.0]), "uncertain": np.array([1.0, 2.0])}
    verdict = verdict_of(load_run(run)[0], scores, {})
    write_verdict(run, verdict)
    return verdict


@pytest.fixture
def reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A reader's folder, with the examples, small sizes, and initial weights for those of presets (see `fresh`)."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    train, own = foveate.train, foveate.experiment.resolve.own_suite
    monkeypatch.setattr(
        "foveate.api.train",
        lambda experiment, **options: train(experiment, **{**options, "epochs": EPOCHS, "episodes": EPISODES}),
    )
    monkeypatch.setattr("foveate.api.judge_run", judged)
    monkeypatch.setattr("foveate.experiment.resolve.table1", lambda *given: table1(*given)[:2])
    monkeypatch.setattr("foveate.experiment.resolve.own_suite", lambda *given: own(*given)[:2])
    monkeypatch.setattr("foveate.experiment.learners.ValidationSettings.held_out", 4)
    monkeypatch.setattr("foveate.experiment.resolve.TRAINED", tmp_path / "trained")
    monkeypatch.chdir(tmp_path)
    time_no_decision(monkeypatch)
    return tmp_path


@pytest.fixture
def untrained(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trainings end before their first iteration: that of the demo, and those of tests/test_api.py, are real."""
    monkeypatch.setattr("foveate.learning.train.train", left_untrained)


def run_python(page: Path) -> dict[str, Any]:
    """Run the Python of a page, block after block, as a reader types it; return its names."""
    names: dict[str, Any] = {}
    for block in blocks(page, "python"):
        exec(compile(block, page.name, "exec"), names)
    return names


@pytest.mark.slow
@pytest.mark.usefixtures("untrained")
def test_the_tutorial_runs(reader: Path, capsys: pytest.CaptureFixture[str]):
    onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")
    page = ROOT / "docs" / "tutorial.md"
    fresh(reader / "trained" / "true-view", "true-view")
    left = run_python(page)
    said = capsys.readouterr().out
    assert left["tracker"].ids == ("anna", "ben")
    assert np.abs(left["v"]) <= 1.5
    assert np.abs(left["w"]) <= 1.2
    assert "drive at" in said
    assert "uncertain" in said
    assert "The policy leads every heuristic clearly" in said
    config = tomllib.loads((reader / "runs" / "mine" / "config.toml").read_text(encoding="utf-8"))
    assert config["scenario"]["view"] == {"shape": "sector", "depth_m": 5.0, "angle_deg": 70.0}
    (words,) = [words for words in commands(page) if words[:2] == ["foveate", "export"]]
    assert main(words[1:]) == 0
    session = onnxruntime.InferenceSession(reader / "mine.onnx")
    assert {"mean", "pose"} <= {value.name for value in session.get_inputs()}


@pytest.mark.slow
def test_the_page_of_the_python_functions_runs():
    assert run_python(ROOT / "docs" / "api.md")["foveate"] is foveate


@pytest.mark.slow
def test_the_page_on_space_runs(reader: Path):
    fresh(reader / "trained" / "quadrotor", "quadrotor")
    left = run_python(ROOT / "docs" / "space.md")
    assert left["policy"].axes == ("vx", "vy", "vz", "wz")
    assert np.isfinite(left["command"]).all()


@pytest.mark.slow
@pytest.mark.usefixtures("untrained")
def test_the_page_on_any_robot_runs(reader: Path, capsys: pytest.CaptureFixture[str]):
    fresh(reader / "trained" / "any", "any")
    left = run_python(ROOT / "docs" / "any.md")
    assert left["policy"].scenario == left["mine"].scenario == left["scenario"]
    assert "decides for 2 to 6 targets" in capsys.readouterr().out
    config = tomllib.loads((reader / "runs" / "mine" / "config.toml").read_text(encoding="utf-8"))
    assert config["policy"]["begin_with"] == "any"


@pytest.mark.slow
def test_the_page_on_cameras_runs(reader: Path):
    for preset in ("pan", "pan-tilt"):
        fresh(reader / "trained" / preset, preset)
    left = run_python(ROOT / "docs" / "cameras.md")
    assert (left["camera"].axes, left["head"].axes) == (("wz",), ("wy", "wz"))
    assert np.abs([left["turn_rate"], left["w_y"], left["w_z"]]).max() <= 1.0


@pytest.mark.slow
def test_the_page_on_ros_runs():
    decision = run_python(ROOT / "docs" / "ros.md")["decision"]
    assert decision.stopped == ""
    assert np.abs(decision.twist).tolist() == [0, 0, 0, 0, 0, pytest.approx(np.abs(decision.twist[5]))]


@pytest.mark.slow
def test_the_page_on_obstacles_runs(reader: Path, capsys: pytest.CaptureFixture[str]):
    pytest.importorskip("gymnasium", reason="needs the extra gym")
    fresh(reader / "trained" / "any", "any")
    left = run_python(ROOT / "docs" / "obstacles.md")
    assert (reader / "rooms.png").stat().st_size > 10_000
    assert left["info"]["contacts"] in (0, 1)
    said = capsys.readouterr().out
    assert "contacts" in said
    assert "(16,) (4,)" in said


@pytest.mark.slow
def test_the_page_on_teams_runs(reader: Path):
    fresh(reader / "trained" / "any", "any")
    (reader / "team.toml").write_text("[scenario.team]\nagents = 4\n", encoding="utf-8")
    result = run_python(ROOT / "docs" / "teams.md")["result"]
    assert {row.agents for row in result.rows} == {4}
    assert len({row.method for row in result.rows}) == 2


@pytest.mark.slow
def test_the_page_on_the_comparison_runs(reader: Path, capsys: pytest.CaptureFixture[str]):
    run_python(ROOT / "docs" / "comparison.md")
    assert "NearAndUncertain on table1" in capsys.readouterr().out


@pytest.mark.slow
def test_the_demo_runs(reader: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """One epoch, and two scenes a cell; the table is whole, and the pictures are there.

    Both policies are in the figure, on the same scenes.
    """
    fresh(reader / "trained" / "true-view", "true-view")
    monkeypatch.setattr(
        "foveate.experiment.resolve.table1",
        lambda *given: [scene for scene in table1(*given) if scene.id.endswith(("-00", "-01"))],
    )
    monkeypatch.setenv("JAX_NUM_CPU_DEVICES", "1")
    runpy.run_path(str(ROOT / "examples" / "demo.py"))["main"](EPOCHS)
    said = capsys.readouterr().out
    assert [line.split()[:2] for line in said.splitlines() if "%" in line] == [
        [motion, targets] for motion in ("unbiased", "biased") for targets in "357"
    ]
    assert {"paper.json", "true-view.json", "trajectories.png", "learning_curve.png"} <= {
        path.name for path in (reader / "runs" / "demo").iterdir()
    }


@pytest.mark.slow
def test_two_methods_side_by_side_are_animated(tmp_path: Path):
    runpy.run_path(str(ROOT / "examples" / "side_by_side.py"))["main"](str(tmp_path / "two.gif"))
    with Image.open(tmp_path / "two.gif") as picture:
        assert picture.size == (800, 460)
        assert getattr(picture, "n_frames", 1) > 15


def test_the_tracker_of_sensors_begins_a_belief_where_the_page_says():
    left = run_python(ROOT / "docs" / "sensors.md")
    np.testing.assert_allclose(left["tracker"].mean, [[0.0, 3.0]], atol=0.01)


def test_a_row_of_the_tutorials_table_is_measured_again():
    """A heuristic, which needs no training, in the 30 scenes of two targets."""
    page = ROOT / "docs" / "tutorial.md"
    (defined,) = [block for block in blocks(page, "python") if block.startswith("scenario =")]
    names: dict[str, Any] = {"foveate": foveate}
    with jax.enable_x64(False):  # as everywhere outside of these tests
        exec(compile(defined, page.name, "exec"), names)
        scenario = names["scenario"]
        nearest = foveate.heuristic("nearest", scenario)
        scenes = [each for each in foveate.own_suite(scenario.scenes, scenario.problem()) if len(each.targets) == 2]
        (cell,) = foveate.evaluate(nearest, scenes, protocol="true", progress=False).summary
    (row,) = re.findall(r"^\| `nearest` \| 2 \| (.*) \|$", page.read_text(encoding="utf-8"), re.MULTILINE)
    shown = [float(text.removesuffix(" %")) for text in row.split(" | ")]
    measured = [cell.mean, 100 * cell.seen_fraction, 100 * cell.seen_step_fraction, cell.nees]
    assert (np.abs(np.subtract(shown, measured)) < [0.006, 0.6, 0.6, 0.06]).all()
