"""The command line as a user meets it: help at once, one line for wrong input, files for programs, exit status."""

import json
import re
import resource
import runpy
import shlex
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from helpers.commands import check_contract, failure
from helpers.compilation import time_no_decision
from rich.cells import cell_len

import foveate
from foveate.cli.main import COMMANDS, main
from foveate.evaluation import rivals, verdict
from foveate.evaluation.verdict import verdict_of
from foveate.experiment.checkpoint import save_tree, write_config
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.experiment.run_folder import BEST, Outcome
from foveate.io.toml import load_toml

ROOT = Path(__file__).parents[2]
FORMATS = ROOT / "tests" / "formats"
PAGE = ROOT / "docs" / "recordings.md"
CSV = "time_s,track_id,x_m,y_m\n"
FEW = ("still", "nearest")
"""In place of all heuristics, which tests/evaluation/test_verdict.py judges."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three walkers that cross a square of 20 m, at 2 fixes a second, one of them late."""
    path = tmp_path_factory.mktemp("recording") / "walkers.csv"
    rows = []
    for k in range(60):
        t = 0.5 * k
        rows.append(f"{t},a,{-10 + t},{2}\n")
        rows.append(f"{t},b,{3},{10 - 0.7 * t}\n")
        if k >= 20:
            rows.append(f"{t},c,{5 - 0.5 * t},{-4}\n")
    path.write_text(CSV + "".join(rows))
    return path


def of_the_page(command: str, places: dict[str, Path]) -> list[str]:
    """That command as docs/recordings.md has it, with the files in their places here, for 30 s in place of hours."""
    lines = re.findall(rf"^foveate ({command} .*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    instead = {name: str(place) for name, place in places.items()} | {"600": "20"}
    (line,) = [line for line in lines if any(name in line.split() for name in places)][:1]
    return [instead.get(word, word) for word in shlex.split(line)]


def make_small(config: Path) -> None:
    """Edit a fitted scenario, as people are to (nothing seals it): wide networks and long episodes take long."""
    text = config.read_text()
    for pattern, small in ((r"\[64, 64\]", "[4]"), (r"width = 64", "width = 4"), (r"^heads = 4", "heads = 1")):
        assert re.search(pattern, text, re.MULTILINE)
        text = re.sub(pattern, small, text, flags=re.MULTILINE)
    few = {"held_out": 2, "steps": 3, "update_epochs": 1, "minibatches": 2}
    text = re.sub(rf"^({'|'.join(few)}) = .*$", lambda found: f"{found[1]} = {few[found[1]]}", text, flags=re.MULTILINE)
    config.write_text(text)


@pytest.fixture(scope="module")
def run(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """fit -> train --config, with next to no training."""
    folder = tmp_path_factory.mktemp("runs")
    places = {"walkers.csv": recording, "walkers.toml": folder / "scenario.toml", "runs/walkers": folder / "run"}
    assert main(of_the_page("fit", places)) == 0
    make_small(folder / "scenario.toml")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verdict, "EPISODES", 2)
        patch.setattr(verdict, "LEAST_EPISODES", 2)
        patch.setattr(rivals, "HEURISTICS", FEW)
        patch.setattr(verdict, "planned_scores", lambda *_: "it takes too long for a test")
        assert main([*of_the_page("train", places), "--epochs", "2", "--episodes", "4"]) == 0
    return folder / "run"


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nothing is trained for."""
    return Path(shutil.copytree(FORMATS / "policy-gradient", tmp_path_factory.mktemp("stored") / "run"))


def test_help_needs_no_jax_and_names_every_command():
    code = "import sys\nfrom foveate.cli.main import main\ntry: main(['--help'])\nfinally: print('jax' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip().endswith("False")
    for command in ("train", "evaluate", "plan", "fit", "replay", "render", "view", "export"):
        assert command in done.stdout


def test_the_package_runs_as_a_module(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setattr(sys, "argv", ["foveate", "--version"])
    monkeypatch.delitem(sys.modules, "foveate.__main__", raising=False)  # another test may have imported every module
    with pytest.raises(SystemExit) as ended:
        runpy.run_module("foveate", run_name="__main__")
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"foveate {foveate.__version__}\n"


def test_module_runs_as_the_command():
    done = subprocess.run([sys.executable, "-m", "foveate", "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, f"foveate {foveate.__version__}\n")
    done = subprocess.run([sys.executable, "-m", "foveate", "fit", "none.csv"], capture_output=True, check=False)
    assert done.returncode == 2


def test_help_answers_at_once():
    """Under 0.5 s on a free machine: processor time, of the quickest of three, does not grow with other work on it."""

    def seconds() -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-m", "foveate", "--help"], capture_output=True, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    assert min(seconds() for _ in range(3)) < 0.5


@pytest.mark.parametrize("error", [ValueError("shapes (2,) and (3,)"), OverflowError("too large"), KeyError("x")])
def test_a_bug_shows_its_traceback(
    error: Exception, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    """Any exception but InputError and OSError: exit status 70, and a traceback with --debug only."""

    def fails(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("foveate.api.evaluate", fails)
    assert main(["evaluate", "paper"]) == 70
    said = capsys.readouterr().err
    assert f"this is a bug of foveate: {type(error).__name__}: {error}\n" in said
    assert f"version (foveate {foveate.__version__})" in said
    assert "Traceback" not in said
    assert main(["--debug", "evaluate", "paper"]) == 70
    assert "in fails\n" in capsys.readouterr().err


def test_debug_shows_where_wrong_input_was_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    missing = str(tmp_path / "missing.csv")
    assert main(["fit", missing, "--debug", "--out", str(tmp_path / "x.toml")]) == 2
    said = capsys.readouterr().err
    assert said.startswith("Traceback")
    assert said.strip().splitlines()[-1].startswith(f"foveate: {missing}: no such file")


def test_help_is_a_line_a_command_and_all_of_it_on_its_own_page(capsys: pytest.CaptureFixture[str]):
    for arguments in (["--help"], ["fit", "--help"]):
        with pytest.raises(SystemExit, match="0"):
            main(arguments)
    both = capsys.readouterr().out
    assert both.count("Fit a scenario to a recording") == 2
    assert both.count("The recording gives the number of targets") == 1
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"foveate {foveate.__version__}\n"


def test_help_of_every_command_fits_a_terminal_of_80_columns(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("COLUMNS", "80")
    for command in COMMANDS:
        with pytest.raises(SystemExit, match="0"):
            main([command, "--help"])
        said = capsys.readouterr().out
        assert not [line for line in said.splitlines() if cell_len(line) > 80], command
        assert not re.search(r"\{None\}|\[STR|--\S+ (STR|FLOAT)\b", said), f"{command}: a value without a name"


@pytest.mark.slow
def test_run_folder_holds_its_documented_files(run: Path):
    names = {path.name for path in run.iterdir()}
    assert {"config.toml", "metrics.jsonl", "checkpoint", "verdict.json"} <= names
    check_contract("verdict", run / "verdict.json")
    verdict = json.loads((run / "verdict.json").read_text())
    assert verdict["objective"] == "seen"
    assert {row["method"] for row in verdict["rows"]} == {"policy", *FEW}
    assert any(name.startswith("events.out.tfevents") for name in names)
    check = json.loads((run / "metrics.jsonl").read_text().splitlines()[-1])
    assert check["epoch"] == 2


def trained_at_once(experiment, out, seed, resume, report) -> Outcome:
    """A training that only leaves a policy."""
    (out / BEST).parent.mkdir(parents=True)
    (out / BEST).write_text("weights")
    return Outcome(epochs=1, best_epoch=1, best_score=0.5, rollbacks=0, stopped="")


@pytest.mark.parametrize(
    ("lead", "said"),
    [
        (1.0, ["The policy leads every heuristic clearly"]),
        (-1.0, ["no clear lead (2 standard errors) over: still.", "To continue:", "--epochs 2000", "--refine 15"]),
    ],
)
def test_a_training_ends_with_its_verdict(
    lead: float, said: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """A table and a sentence; where a heuristic is as good, how to continue. --no-verdict ends without."""
    policy = np.array([1.0, 2.0, 4.0])
    scores = {"policy": policy, "still": policy - lead}
    monkeypatch.setattr("foveate.cli.run.train.train", trained_at_once)
    monkeypatch.setattr("foveate.cli.run.train.judge_run", lambda run: verdict_of(PRESETS["paper"], scores, {}))
    assert main(["train", "--out", str(tmp_path / "a")]) == 0
    printed = capsys.readouterr().out
    assert "policy leads by" in printed
    assert all(words in printed for words in said)
    assert ("To continue" in printed) == (lead < 0)
    assert main(["train", "--out", str(tmp_path / "b"), "--no-verdict"]) == 0
    assert "policy leads by" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("world", "change", "said"),
    [
        ("pan", ("--set", "scenario.team.agents=2"), "policy+hungarian"),
        ("team-lossy", (), "train for longer"),
        ("team-discover", (), "policy+hungarian"),
        ("team-discover", ("--set", "scenario.team.radio.loss=0.5"), "train for longer"),
        ("discover-sparse", (), "train for longer"),
        ("pan", (), "--refine"),
    ],
)
def test_what_a_verdict_proposes_is_there_in_that_world(
    world: str,
    change: tuple[str, ...],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    """Single robots that know ids refine a policy's actions; teams assign targets where all know the same ones."""
    config = ROOT / "benchmarks" / "worlds" / f"{world}.toml"
    experiment = load_toml(Experiment, config)
    scores = {"policy": np.array([1.0, 2.0, 4.0]), "still": np.array([2.0, 3.0, 5.0])}
    monkeypatch.setattr("foveate.cli.run.train.train", trained_at_once)
    monkeypatch.setattr("foveate.cli.run.train.judge_run", lambda run: verdict_of(experiment, scores, {}))
    assert main(["train", "--config", str(config), *change, "--out", str(tmp_path / "a")]) == 0
    printed = capsys.readouterr().out
    assert said in printed
    assert ("--refine" in printed) == (said == "--refine")
    assert ("policy+hungarian" in printed) == (said == "policy+hungarian")


def test_an_interrupted_verdict_leaves_the_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def interrupted(run):
        raise KeyboardInterrupt

    monkeypatch.setattr("foveate.cli.run.train.train", trained_at_once)
    monkeypatch.setattr("foveate.cli.run.train.judge_run", interrupted)
    assert main(["train", "--out", str(tmp_path / "a")]) == 130
    assert f"the training is complete; the verdict follows with  foveate train --resume {tmp_path / 'a'}" in (
        capsys.readouterr().err
    )


@pytest.mark.slow
def test_evaluate_writes_rows_that_keep_the_contract(stored: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    time_no_decision(monkeypatch)
    scenes = tmp_path / "scenes.json"
    rows = [
        {"id": "two", "agent": [0, 0, 0.5], "targets": [[1, 1], [-5, 2]], "drift": [[0.1, 0], [0, 0]], "horizon": 4},
        {"id": "none", "agent": [0, 0, 0], "targets": []},
    ]
    scenes.write_text(json.dumps({"format": "foveate-scenes", "version": 1, "scenes": rows}))
    out = tmp_path / "out.json"
    again = tmp_path / "scenes-again.json"
    arguments = ["--scenes", str(scenes), "--method", "policy", "nearest", "--episodes", "2"]
    assert main(["evaluate", str(stored), *arguments, "--json", str(out), "--write-scenes", str(again)]) == 0
    data = json.loads(out.read_text())
    assert len(data["rows"]) == 2 * 2 * 2 * 2
    assert {row["score"] for row in data["rows"] if row["targets"] == 0} == {None}
    assert {cell["motion"] for cell in data["summary"]} == {"biased"}
    check_contract("evaluate", out)
    check_contract("scenes", again)


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One scene of two targets, three steps long."""
    path = tmp_path_factory.mktemp("scenes") / "scenes.json"
    row = {"id": "two", "agent": [0, 0, 0.5], "targets": [[3, 1], [-5, 2]], "horizon": 3}
    path.write_text(json.dumps({"format": "foveate-scenes", "version": 1, "scenes": [row]}))
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "method"),
    [
        (("--omniscient", "--starts", "4", "--iterations", "5"), "omniscient"),
        (("--open-loop", "--starts", "2", "--iterations", "2", "--episodes", "2"), "icr-2-open"),
        (("--refine", "2"), "refine-2"),
    ],
)
def test_plan_writes_rows_that_keep_the_contract(
    options: tuple[str, ...], method: str, stored: Path, scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    if method == "refine-2":
        time_no_decision(monkeypatch)
    out = tmp_path / "out.json"
    arguments = [
        "plan",
        "--scenes",
        str(scenes),
        "--run",
        str(stored),
        *options,
        "--protocol",
        "true",
        "--json",
        str(out),
    ]
    assert main(arguments) == 0
    rows = json.loads(out.read_text())["rows"]
    assert {row["method"] for row in rows} == {method}
    assert {row["protocol"] for row in rows} == {"true"}
    assert all(0 < row["step_time_s"] < 60 for row in rows)
    check_contract("evaluate", out)
    if method == "omniscient":
        assert len(list((tmp_path / "cache" / "foveate" / "plans").iterdir())) == 1
        first = out.read_bytes()
        assert main(arguments) == 0
        assert out.read_bytes() == first


def test_plan_rejects_scenes_that_do_not_fit(
    stored: Path, scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    plan = ("plan", "--scenes", str(scenes))
    assert "--starts 0: expected >= 1" in failure(capsys, *plan, "--starts", "0")
    assert "--iterations 0" in failure(capsys, *plan, "--iterations", "0")
    assert "--window 0" in failure(capsys, *plan, "--window", "0")
    assert "--window 5" in failure(capsys, *plan, "--window", "5", "--omniscient")
    assert "give one of them" in failure(capsys, *plan, "--preset", "best", "--run", str(stored))
    assert "--episodes 0" in failure(capsys, *plan, "--episodes", "0")
    assert "--refine 3: expected the policy to refine" in failure(capsys, *plan, "--refine", "3")
    assert "--refine 0" in failure(capsys, *plan, "--run", str(stored), "--refine", "0")
    assert "no other option" in failure(capsys, *plan, "--run", str(stored), "--refine", "3", "--starts", "2")
    assert "--omniscient" in failure(capsys, *plan, "--omniscient", "--open-loop")
    assert "give one of them" in failure(capsys, *plan, "--run", str(stored), "--config", str(stored / "config.toml"))
    assert "expected a preset (paper" in failure(capsys, *plan, "--preset", "nobody")
    assert "nowhere" in failure(capsys, *plan, "--run", str(tmp_path / "nowhere"))
    assert "no such file" in failure(capsys, "plan", "--scenes", str(tmp_path / "missing.json"))
    assert "is an input" in failure(capsys, *plan, "--json", str(scenes))


@pytest.mark.slow
def test_replay_writes_its_files(run: Path, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    time_no_decision(monkeypatch)
    out = tmp_path / "replay"
    places = {"walkers.csv": recording, "runs/walkers": run, "runs/walkers/replay": out}
    assert main([*of_the_page("replay", places), "--method", "policy", "still"]) == 0
    assert {path.name for path in out.iterdir()} == {"replay.json", "replay.png", "replay.gif"}
    rows = json.loads((out / "replay.json").read_text())["rows"]
    assert [row["method"] for row in rows] == ["policy", "still"]
    assert [row["targets"] for row in rows] == [3, 3]
    check_contract("replay", out / "replay.json")


def test_wrong_input_is_one_line(stored: Path, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    bad = tmp_path / "bad.csv"
    bad.write_text(CSV + "0,a,1,nan\n")
    config = tmp_path / "bad.toml"
    config.write_text('[scenario.view]\nshape = "triangle"\ndepth_m = 0.0\n')
    unknown = tmp_path / "unknown.toml"
    unknown.write_text("[training]\nepoch = 3\n")
    assert "nowhere" in failure(capsys, "evaluate", "nowhere")
    assert "presets are paper" in failure(capsys, "evaluate", "nowhere")
    assert "expected one of" in failure(capsys, "evaluate", str(stored), "--method", "psychic")
    assert "--episodes 0" in failure(capsys, "evaluate", str(stored), "--episodes", "0")
    many = str(10**30)  # more than any array or counter holds
    assert f"--episodes {many}: expected <=" in failure(capsys, "evaluate", str(stored), "--episodes", many)
    assert f"--episodes = {many}: expected <=" in failure(capsys, "train", "--episodes", many)
    assert f"--window = {many}: expected <=" in failure(capsys, "train", "--window", many)
    assert f"--starts {many}: expected <=" in failure(capsys, "plan", "--starts", many)
    assert "bad.csv" in failure(capsys, "replay", str(stored), str(bad))
    assert "--agent-start 1,2" in failure(capsys, "replay", str(stored), str(recording), "--agent-start", "1,2")
    assert "bad.csv: expected keys" in failure(capsys, "replay", str(stored), str(recording), "--map", str(bad))
    assert "no.yaml: no such file" in failure(capsys, "fit", str(recording), "--out", "x", "--map", "no.yaml")
    assert "--map: expected a --recording" in failure(capsys, "view", str(stored), "--map", str(bad))
    assert "spans" in failure(capsys, "replay", str(stored), str(recording), "--start", "1000")
    assert "depth_m = 0.0" in failure(capsys, "train", "--config", str(config), "--out", str(tmp_path / "x"))
    assert "epochs" in failure(capsys, "train", "--config", str(unknown), "--out", str(tmp_path / "x"))
    assert not (tmp_path / "x").exists()
    assert "exists already" in failure(capsys, "train", "--out", str(stored))
    assert "exists already" in failure(capsys, "fit", str(recording), "--out", str(stored / "config.toml"))
    assert "no folder" in failure(capsys, "evaluate", str(stored), "--json", str(tmp_path / "no" / "x.json"))
    assert "--scene-seed -1" in failure(capsys, "evaluate", str(stored), "--scene-seed", "-1")
    twice = ("--method", "still", "--method", "random")
    assert "--method: is given twice" in failure(capsys, "evaluate", str(stored), *twice)
    assert "--seed and --resume" in failure(capsys, "train", "--resume", str(stored), "--seed", "5")
    assert "--tau" in failure(capsys, "fit", str(recording), "--out", str(tmp_path / "f.toml"), "--tau", "0")


@pytest.mark.slow
def test_a_recording_in_space_is_fitted_and_replayed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    """A recording with z, its fit, its scenes, its replay and pictures of both, by an untrained network."""
    time_no_decision(monkeypatch)
    recording, config, run = tmp_path / "birds.csv", tmp_path / "birds.toml", tmp_path / "run"
    rows = [f"{0.5 * k},a,{-5 + 0.5 * k},2,{1 + 0.1 * k}\n{0.5 * k},b,1,{4 - 0.4 * k},2\n" for k in range(24)]
    recording.write_text("time_s,track_id,x_m,y_m,z_m\n" + "".join(rows))
    assert main(["fit", str(recording), "--out", str(config), "--view-depth", "5"]) == 0
    text = config.read_text()
    assert 'kind = "quadrotor"' in text
    assert 'kind = "constant_velocity"' in text
    make_small(config)
    experiment = load_toml(Experiment, config)
    (run / BEST).parent.mkdir(parents=True)
    write_config(run, experiment)
    save_tree(run / BEST, experiment.new_policy(jax.random.key(0)), experiment, "policy", {})
    arguments = ["--method", "policy", "--protocol", "true", "--json", str(tmp_path / "out.json")]
    assert main(["evaluate", str(run), *arguments]) == 0
    check_contract("evaluate", tmp_path / "out.json")
    assert {row["targets"] for row in json.loads((tmp_path / "out.json").read_text())["rows"]} == {1, 2}
    out = tmp_path / "replay"
    assert main(["replay", str(run), str(recording), "--method", "policy", "--out", str(out)]) == 0
    check_contract("replay", out / "replay.json")
    assert main(["render", str(run), "--out", str(tmp_path / "course.png")]) == 0
    assert (tmp_path / "course.png").read_bytes().startswith(b"\x89PNG")
    assert "planar" in failure(capsys, "evaluate", str(run), "--scenes", "table1")


def test_render_names_unsupported_input(stored: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    gif = str(tmp_path / "x.gif")
    assert ".gif, .mp4, .png" in failure(capsys, "render", str(stored), "--out", str(tmp_path / "x.txt"))
    assert "no such scene" in failure(capsys, "render", str(stored), "--out", gif, "--scene", "nobody")
    two = ("--scenes", "table1", "--scene", "biased-3-00", "biased-5-00")
    assert "one scene" in failure(capsys, "render", str(stored), "--out", gif, *two)
    assert "--method all" in failure(capsys, "render", str(stored), "--out", gif, "--method", "all")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.torch
def test_ppo_trains_a_run_that_evaluates(
    scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    """A config of PPO with hardly any training; its result is evaluated without torch, and cannot be resumed."""
    pytest.importorskip("stable_baselines3", reason="needs the extra ppo")
    config, run = tmp_path / "small.toml", tmp_path / "run"
    small = "held_out = 4\nenvironments = 4\nrollout_steps = 8\nbatch = 16\npasses = 1\n"
    config.write_text(f'[training]\nalgorithm = "ppo"\n{small}')
    train = ("train", "--config", str(config))
    monkeypatch.setattr(verdict, "EPISODES", 4)
    monkeypatch.setattr(rivals, "HEURISTICS", FEW)
    monkeypatch.setattr(verdict, "planned_scores", lambda *_: "it takes too long for a test")
    assert main([*train, "--steps", "50", "--out", str(run)]) == 0
    said = capsys.readouterr().out
    assert "best of 2 iterations" in said
    assert "No planner: it takes too long for a test." in said
    check_contract("verdict", run / "verdict.json")
    check = json.loads((run / "metrics.jsonl").read_text().splitlines()[-1])
    assert check["env_steps"] == 64
    assert any(path.name.startswith("events.out.tfevents") for path in run.iterdir())
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    assert main(["evaluate", str(run), "--scenes", str(scenes), "--json", str(tmp_path / "out.json")]) == 0
    check_contract("evaluate", tmp_path / "out.json")
    assert "cannot be resumed" in failure(capsys, "train", "--resume", str(run))
    assert "expected steps" in failure(capsys, *train, "--epochs", "3", "--out", str(tmp_path / "x"))
    assert "pip install 'foveate[ppo]'" in failure(capsys, *train, "--out", str(tmp_path / "x"))
    assert not (tmp_path / "x").exists()


def test_an_algorithm_needs_its_own_counts(stored: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = ("--out", str(tmp_path / "x"))
    assert "steps 10: this algorithm" in failure(capsys, "train", "--steps", "10", *out)
    assert "expected steps" in failure(capsys, "train", "--algorithm", "ppo", "--episodes", "10", *out)
    assert "steps = 0: expected >= 1" in failure(capsys, "train", "--algorithm", "ppo-tuned", "--steps", "0", *out)
    assert "--algorithm and --resume" in failure(capsys, "train", "--algorithm", "ppo", "--resume", str(stored))
    assert not (tmp_path / "x").exists()


def test_a_damaged_checkpoint_is_named(stored: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):

    copy = tmp_path / "copy"
    shutil.copytree(stored, copy)
    best = copy / "checkpoint" / "best.npz"
    best.write_bytes(best.read_bytes()[:-100])
    assert "best.npz" in failure(capsys, "evaluate", str(copy))


def test_fit_reads_tables_of_other_tools_and_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Two ships in degrees; an id that is switched, and what is refused in one line."""

    def row(name: str, k: int, north: int) -> str:
        latitude = 47.6 + 0.0009 * k * north + 0.1 * (name == "B")
        return f"{name},2026-03-29T00:{k // 3:02d}:{20 * (k % 3):02d}Z,{latitude},-122.34"

    lines = [row(name, k, north) for k in range(60) for name, north in (("A", 1), ("B", 0 if k < 30 else -1))]
    ships, out, report = tmp_path / "ships.csv", tmp_path / "ships.toml", tmp_path / "ships.html"
    ships.write_text("MMSI,BaseDateTime,LAT,LON\n" + "\n".join(lines) + "\n")
    columns = "time=BaseDateTime,id=MMSI,lat=LAT,lon=LON"
    assert f"--columns {columns}" in failure(capsys, "fit", str(ships), "--out", str(out))
    options = ["--columns", columns, "--tau", "20", "--view-depth", "800", "--sensor-std-m", "10"]
    assert main(["fit", str(ships), *options, "--out", str(out), "--report", str(report)]) == 0
    said = capsys.readouterr().out
    assert "positions are metres from latitude 47.6" in said
    assert "95th percentile 5.00 m/s" in said  # 0.0009 degrees, 100 m in 20 s
    assert "latitude_deg = 47.6" in out.read_text()
    assert "<img" in report.read_text()
    wrong = ["fit", str(ships), "--columns", "time=1", "--out", str(tmp_path / "other.toml")]
    assert "--columns" in failure(capsys, *wrong)


def test_a_port_in_use_and_a_missing_ffmpeg_are_said_before_anything_is_imported(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
):
    monkeypatch.setattr("foveate.cli.main.import_module", lambda name: pytest.fail(f"{name} was imported"))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert f"--port {port}: is in use" in failure(capsys, "view", "paper", "--port", port)
    monkeypatch.setattr("foveate.cli.common.shutil.which", lambda name: None)
    monkeypatch.setattr("foveate.cli.common.find_spec", lambda name: None)
    assert "ffmpeg is missing" in failure(capsys, "render", "paper", "--out", tmp_path / "a.mp4")
