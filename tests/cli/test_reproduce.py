"""`foveate reproduce` and `evaluate --normalised` as a user meets them, on a suite that takes seconds."""

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.commands import check_contract, failure
from helpers.compilation import time_no_decision

from foveate.cli.main import main
from foveate.evaluation import oracle, rivals
from foveate.experiment.presets import PRESETS
from foveate.planning.named import heuristic_policy
from foveate.planning.shooting import PlanSettings
from foveate.policies.attention import AttentionSettings
from foveate.simulation.suites import Cell, suite
from foveate.study import publish as publication
from foveate.study import study
from foveate.study.methods import Fixed, Learned, Training
from foveate.study.run import reproduce

OWN = Path(__file__).parents[2] / "examples" / "own_method.py"
TINY = replace(
    PRESETS["paper"],
    policy=AttentionSettings(agent_widths=(4,), target_widths=(4,), out_widths=(4,)),
    training=replace(PRESETS["paper"].training, epochs=2, episodes=2, held_out=2, check_every=1),
)
FEW = PlanSettings(starts=1, iterations=2)


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Two scenes a cell, a training of two epochs, no omniscience: what is nearest is the best there is."""

    def scenes(problem, seed=2023):
        return suite(TINY.scenario.scenes, problem, seed, [Cell(3, False), Cell(3, True)], 2)

    def nearest(experiment):
        return heuristic_policy("nearest", experiment.scenario.problem(), 2.0)

    omniscient = Fixed(name="omniscient", family="omniscient", make=nearest)
    methods = (omniscient, Learned(name="paper", training=Training(name="paper", experiment=TINY)))
    time_no_decision(monkeypatch)
    monkeypatch.setattr(study, "table1", scenes)
    monkeypatch.setattr(study, "paper_methods", lambda budget: methods)
    monkeypatch.setattr(oracle, "OMNISCIENT", {"surrogate": FEW, "true": FEW})
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XLA_FLAGS", "")


@pytest.mark.slow
def test_reproduce_from_an_empty_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "a" / "out"
    arguments = ["reproduce", "--quick", "--out", str(out), "--add", f"{OWN}:METHOD"]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    assert "QUICK LOOK" in printed
    assert "near-uncertain" in printed
    files = {path.name for path in out.iterdir() if path.is_file() and path.suffix}
    pictures = {"learning.png", "pareto.png", "trajectories-surrogate.png", "trajectories-true.png"}
    assert files == {"table.md", "table.json", *pictures}
    for name in pictures:
        assert (out / name).read_bytes().startswith(b"\x89PNG")
    text = (out / "table.md").read_text()
    assert "QUICK LOOK" in text.splitlines()[0]
    for name in pictures:
        assert f"]({name})" in text
    _check_data(json.loads((out / "table.json").read_text()))
    times = {path: path.stat().st_mtime_ns for path in (out / "units").glob("*.json")}
    assert len(times) == 7
    assert main(arguments) == 0
    assert {path: path.stat().st_mtime_ns for path in (out / "units").glob("*.json")} == times
    check_contract("evaluate", out / "table.json")


@pytest.mark.slow
def test_reproduce_for_the_true_view(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    """Both initial errors, the true protocol alone, a scenario that differs; the contract holds."""
    omniscient, learned = study.paper_methods(study.QUICK)
    uncertain = Fixed(
        name="uncertain", make=lambda experiment: heuristic_policy("uncertain", experiment.scenario.problem(), 2.0)
    )
    methods = (omniscient, replace(learned, name=study.TRUE_VIEW), uncertain)
    monkeypatch.setattr(study, "true_view_methods", lambda budget: methods)
    monkeypatch.setattr(study, "FACTORS", tuple(replace(one, values=one.values[1:3]) for one in study.FACTORS))
    monkeypatch.setattr(study, "QUICK", replace(study.QUICK, factors=("V",)))
    out = tmp_path / "out"
    assert main(["reproduce", "--suite", "true-view", "--quick", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "initial errors as in the paper" in printed
    assert "consistent initial errors" in printed
    data = json.loads((out / "table.json").read_text())
    assert (data["suite"], data["reference"]) == ("true-view", study.TRUE_VIEW)
    for part, count in (("rows", 3 * 4 * 2), ("summary", 3 * 2 * 2), ("overall", 3 * 2)):
        assert len(data[part]) == count
        assert {one["initial_error"] for one in data[part]} == {"paper", "consistent"}
        assert {one["protocol"] for one in data[part]} == {"true"}
    still = [[r["rmse_m"] for r in data["rows"] if r["initial_error"] == error] for error in ("paper", "consistent")]
    assert sum(still[0]) < sum(still[1]), "a first error of 0.2 m is less than one of 1.4 m"
    robustness = json.loads((out / "robustness.json").read_text())
    (factor,) = robustness["factors"]
    assert (robustness["protocol"], robustness["training_seeds"]) == ("true", data["training_seeds"])
    assert {"foveate", "scenario", "scene_seed", "noise_seed", "trainings"} <= set(robustness)
    assert "Scenarios that differ" in (out / "table.md").read_text()
    assert {(one["method"], one["value"]) for one in factor["verdicts"]} == {
        (name, value) for name in (study.TRUE_VIEW, "uncertain") for value in (0.1, 0.2)
    }
    assert (out / "robustness.png").read_bytes().startswith(b"\x89PNG")
    assert len(list((out / "units").glob("*.json"))) == 1 + 3 * 2 + 2
    check_contract("evaluate", out / "table.json")
    _check_moving_pictures(out, data["rows"], monkeypatch)


def _check_moving_pictures(out: Path, rows: list[dict], monkeypatch: pytest.MonkeyPatch) -> None:
    """In a full study the best and the worst scene of each cell are animated."""
    animated: dict[str, str] = {}
    monkeypatch.setattr(
        publication, "animate", lambda data, path: animated.update({path.name: data.title.split(" on ")[1]})
    )
    asked = replace(study.true_view_study(True), quick=False)
    results = reproduce(asked, out, lambda *_: None, lambda *_: None)
    publication.publish(asked, out, results)
    for motion in ("unbiased", "biased"):
        scores = {
            row["scene"]: row["score"]
            for row in rows
            if (row["method"], row["motion"], row["initial_error"]) == (study.TRUE_VIEW, motion, "paper")
        }
        assert scores[animated[f"3-{motion}-easy.gif"]] == max(scores.values())
        assert scores[animated[f"3-{motion}-hard.gif"]] == min(scores.values())


def _check_data(data: dict) -> None:
    """The rules of the contract, and the story of the rows."""
    assert data["quick"] is True
    assert len(data["rows"]) == 3 * 2 * 4
    for row in data["rows"]:
        assert {"scene", "seed", "method", "protocol", "targets", "entropy", "step_time_s"} <= set(row)
        for name in ("score", "seen_fraction", "seen_step_fraction", "longest_unseen_s", "rmse_m", "nees"):
            assert isinstance(row[name], int | float)
            assert math.isfinite(row[name])
        assert row["training_seed"] == (0 if row["method"] == "paper" else None)
    for cell in data["summary"]:
        assert cell["protocol"] in ("surrogate", "true")
        assert cell["motion"] in ("unbiased", "biased")
        assert len(cell["ci95"]) == 2
    own = [cell for cell in data["summary"] if cell["method"] == "omniscient"]
    assert [cell["normalised_score"] for cell in own] == [1.0] * 4
    assert {one["method"] for one in data["differences"]} == {"omniscient", "near-uncertain"}
    assert all(one["p"] <= one["p_holm"] <= 1 for one in data["differences"])
    assert [(one["name"], one["seed"], one["epochs"]) for one in data["trainings"]] == [("paper", 0, 2)]


def test_an_interrupt_prints_how_to_continue(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Fixed, "rows", interrupted)
    assert main(["reproduce", "--quick", "--out", str(tmp_path / "out")]) == 130
    assert "the same command resumes" in " ".join(capsys.readouterr().err.split())


WORLD = """[scenario.scenes]
targets_min = 1
targets_max = 2
steps = 3
[policy]
agent_widths = [4]
target_widths = [4]
out_widths = [4]
[training]
epochs = 40
episodes = 4
held_out = 4
check_every = 1
"""


@pytest.mark.slow
def test_the_suite_of_worlds(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    """Two worlds, one of which no planner can plan in: a page, JSON, and a second run that does nothing again.

    Two heuristics stand for all, which tests/evaluation/test_verdict.py judges.
    """
    few = ("still", "nearest")
    monkeypatch.setattr(rivals, "HEURISTICS", few)
    folder, out, result = tmp_path / "worlds", tmp_path / "out", tmp_path / "result.json"
    folder.mkdir()
    (folder / "plain.toml").write_text(WORLD)
    (folder / "scheduled.toml").write_text(f"[scenario.schedule]\ntau_s = [1.0, 0.5]\n{WORLD}")
    arguments = ["reproduce", "--suite", "worlds", "--quick", "--worlds", str(folder), "--out", str(out)]
    assert main([*arguments, "--json", str(result)]) == 0
    printed = capsys.readouterr().out
    assert "QUICK LOOK" in printed
    assert result.read_bytes() == (out / "worlds.json").read_bytes()
    data = json.loads(result.read_text())
    assert (data["quick"], data["training_seeds"]) == (True, [0])
    plain, scheduled = data["worlds"]
    assert (plain["world"], scheduled["world"]) == ("plain", "scheduled")
    assert {lead["method"] for lead in plain["heuristics"]} == set(few)
    assert plain["planner"]["method"] == "icr-4"
    assert scheduled["planner"] is None
    assert "schedule" in scheduled["no_planner"]
    page = (out / "worlds.md").read_text()
    assert "| plain |" in page
    assert "| scheduled |" in page
    assert (out / "trainings" / "plain-0" / "metrics.jsonl").read_text().count("\n") == 2, "a twentieth of 40 epochs"
    times = {path: path.stat().st_mtime_ns for path in (out / "units").glob("*.json")}
    assert len(times) == 2 * 4
    assert main([*arguments, "--only", "plain"]) == 0
    assert {path: path.stat().st_mtime_ns for path in (out / "units").glob("*.json")} == times
    assert [world["world"] for world in json.loads((out / "worlds.json").read_text())["worlds"]] == ["plain"]


def test_worlds_that_are_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    suite = ("reproduce", "--suite", "worlds", "--out", str(tmp_path / "out"), "--worlds", str(tmp_path))
    assert "holds no worlds: expected --worlds FOLDER" in failure(capsys, *suite)
    (tmp_path / "plain.toml").write_text(WORLD)
    assert "--only other: expected names of" in failure(capsys, *suite, "--only", "plain", "other")
    assert "methods are not added to worlds" in failure(capsys, *suite, "--add", f"{OWN}:METHOD")
    assert "each once" in failure(capsys, *suite, "--seeds", "1", "1")
    assert "expected --suite worlds" in failure(capsys, "reproduce", "--only", "plain")
    assert not (tmp_path / "out").exists()


def test_wrong_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "file").write_text("")
    (tmp_path / "own.py").write_text("METHOD = 3\n")
    out = ("--out", str(tmp_path / "out"))
    assert "--scene-seed -1" in failure(capsys, "reproduce", "--scene-seed", "-1", *out)
    assert "--seeds -1" in failure(capsys, "reproduce", "--seeds", "0", "-1", *out)
    assert "each once" in failure(capsys, "reproduce", "--quick", "--seeds", "1", "1", *out)
    assert "is no folder" in failure(capsys, "reproduce", "--quick", "--out", str(tmp_path / "file"))
    assert "FILE.py:NAME" in failure(capsys, "reproduce", "--quick", "--add", "nowhere.py:METHOD", *out)
    assert "expected a foveate.Method" in failure(
        capsys, "reproduce", "--quick", "--add", f"{tmp_path}/own.py:METHOD", *out
    )
    assert "expected a foveate.Method" in failure(
        capsys, "reproduce", "--quick", "--add", f"{tmp_path}/own.py:NONE", *out
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_evaluate_prints_normalised_scores(tmp_path: Path):
    scenes, out = tmp_path / "scenes.json", tmp_path / "out.json"
    row = {"id": "one", "agent": [0, 0, 0.5], "targets": [[4.6, 2.5], [9, 9]], "horizon": 3}
    scenes.write_text(json.dumps({"format": "foveate-scenes", "version": 1, "scenes": [row]}))
    arguments = ["--scenes", str(scenes), "--method", "nearest", "--protocol", "true", "--normalised"]
    assert main(["evaluate", "paper", *arguments, "--json", str(out)]) == 0
    plan = tmp_path / "plan.json"
    options = ["--omniscient", "--starts", "1", "--iterations", "2", "--protocol", "true"]
    assert main(["plan", "--scenes", str(scenes), *options, "--json", str(plan)]) == 0
    ours, best = (json.loads(path.read_text())["summary"][0] for path in (out, plan))
    lowest = -2 * math.log(2 + 0.05**2 * 3)
    assert ours["normalised_score"] == pytest.approx((ours["mean"] - lowest) / (best["mean"] - lowest))
    check_contract("evaluate", out)
