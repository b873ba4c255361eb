"""Jobs of a suite of worlds: each done once, again where what it depends on has changed; sizes of the planner."""

from dataclasses import replace

import numpy as np
import pytest

from foveate.evaluation.held_out import HeldOut
from foveate.experiment.presets import PRESETS, PPOSettings
from foveate.experiment.run_folder import BEST, LAST, Outcome
from foveate.io.toml import save_toml
from foveate.simulation.records import Policy
from foveate.study import jobs as shared
from foveate.study import worlds
from foveate.study.worlds import WorldsStudy, reproduce_worlds, world_jobs, worlds_at, worlds_study

EXPERIMENT = PRESETS["paper"]
SHORTER = replace(EXPERIMENT, training=replace(EXPERIMENT.training, epochs=7))
CALLS: list[str] = []


class Nobody(Policy):
    """A policy that is never asked."""

    def __call__(self, observation, memory, key):
        raise AssertionError("nobody asks it")


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """No simulation: scores are made up, and trainings only leave their files behind."""

    def train(experiment, run, seed, resume, report):
        CALLS.append(f"train {run.name}")
        (run / BEST).parent.mkdir(parents=True, exist_ok=True)
        (run / LAST).write_text("")
        (run / BEST).write_text("weights")
        return Outcome(epochs=1, best_epoch=1, best_score=2.0, rollbacks=0, stopped="")

    def policy_scores(given, policies, report=lambda done: None):
        CALLS.append(" ".join(policies))
        report(len(policies))
        return {name: np.array([1.0, 2.0, 3.0]) for name in policies}

    def planned_scores(given, settings, count, report):
        CALLS.append(f"planner {settings.starts}")
        return np.array([4.0])

    CALLS.clear()
    monkeypatch.setattr(shared, "train", train)
    monkeypatch.setattr(shared, "load_run", lambda run: (EXPERIMENT, Nobody(), {}))
    monkeypatch.setattr(worlds, "held_out", lambda *_: object.__new__(HeldOut))
    monkeypatch.setattr(worlds, "heuristics_of", lambda experiment: {"still": None, "nearest": None})
    monkeypatch.setattr(worlds, "policy_scores", policy_scores)
    monkeypatch.setattr(worlds, "planned_scores", planned_scores)


def a_study(**changes) -> WorldsStudy:
    return worlds_study({"one": EXPERIMENT, "two": SHORTER}, **{"seeds": (0, 10), **changes})


def test_every_job_runs_once_and_is_loaded_again(tmp_path):
    notes = []
    scored, trained = reproduce_worlds(a_study(), tmp_path, lambda done, line: notes.append((done, line)))
    one = ["still nearest", "planner 64", "train one-0", "policy", "train one-10", "policy"]
    assert [*one, *(call.replace("one", "two") for call in one)] == CALLS
    assert (0, "one, heuristics: 2 of 2") in notes
    assert [(each.method, each.kind, each.training_seed) for each in scored[:5]] == [
        ("still", "heuristic", None),
        ("nearest", "heuristic", None),
        ("icr-64", "planner", None),
        ("policy", "policy", 0),
        ("policy", "policy", 10),
    ]
    assert scored[0].scores == (1.0, 2.0, 3.0)
    assert [(each.name, each.seed) for each in trained] == [("one", 0), ("one", 10), ("two", 0), ("two", 10)]
    CALLS.clear()
    assert reproduce_worlds(a_study(), tmp_path) == (scored, trained)
    assert CALLS == []


@pytest.mark.parametrize(
    ("changes", "again"),
    [
        ({"worlds": {"one": SHORTER}}, ["still nearest", "planner 64", "train one-0", "policy"]),
        ({"scene_seed": 7}, ["still nearest", "planner 64", "policy"]),
        ({"episodes": 9}, ["still nearest", "planner 64", "policy"]),
        ({"starts": 2}, ["planner 2"]),
        ({"seeds": (0, 1)}, ["train one-1", "policy"]),
    ],
)
def test_a_change_repeats_what_depends_on_it(changes, again, tmp_path):
    plain = worlds_study({"one": EXPERIMENT}, seeds=(0,))
    reproduce_worlds(plain, tmp_path)
    CALLS.clear()
    reproduce_worlds(replace(plain, **changes), tmp_path)
    assert again == CALLS


def test_other_weights_are_judged_again(tmp_path):
    plain = worlds_study({"one": EXPERIMENT}, seeds=(0,))
    reproduce_worlds(plain, tmp_path)
    (tmp_path / shared.TRAININGS / "one-0" / BEST).write_text("other weights")
    CALLS.clear()
    reproduce_worlds(plain, tmp_path)
    assert CALLS == ["policy"]


def test_a_world_without_a_planner_says_why(tmp_path, monkeypatch):
    monkeypatch.setattr(worlds, "planned_scores", lambda *_: "it has a schedule")
    plain = worlds_study({"one": EXPERIMENT}, seeds=(0,))
    for _ in range(2):  # computed, and loaded
        scored, _ = reproduce_worlds(plain, tmp_path)
        (planner,) = [each for each in scored if each.kind == "planner"]
        assert (planner.scores, planner.note) == ((), "it has a schedule")


def test_worlds_of_a_folder(tmp_path):
    save_toml(EXPERIMENT, tmp_path / "b.toml", "a world")
    save_toml(SHORTER, tmp_path / "a.toml", "another")
    (tmp_path / "README.md").write_text("not a world")
    assert worlds_at(tmp_path) == {"a": SHORTER, "b": EXPERIMENT}
    assert worlds_at(tmp_path, ["b"]) == {"b": EXPERIMENT}
    with pytest.raises(ValueError, match=r"--only c: expected names of .*: a, b"):
        worlds_at(tmp_path, ["c"])
    with pytest.raises(ValueError, match="holds no worlds"):
        worlds_at(tmp_path / "none")


def test_a_quick_suite_is_short():
    ppo = replace(EXPERIMENT, training=PPOSettings(algorithm="ppo", steps=1000))
    quick = worlds_study({"paper": EXPERIMENT, "tiny": SHORTER, "ppo": ppo}, quick=True)
    assert quick.seeds == (0,)
    assert quick.quick
    assert [quick.worlds[name].training.epochs for name in ("paper", "tiny")] == [50, 1]
    assert quick.worlds["ppo"].training.steps == 50
    assert worlds_study({}, quick=True, seeds=(1, 2)).seeds == (1, 2)
    with pytest.raises(ValueError, match="each once"):
        a_study(seeds=(1, 1))


def test_a_planner_of_64_starts_has_fewer_episodes_where_they_are_long():
    study = a_study()
    short, settings = study.planner(EXPERIMENT)
    scenes = replace(EXPERIMENT.scenario.scenes, steps=1000, targets_max=20)
    long = replace(EXPERIMENT, scenario=replace(EXPERIMENT.scenario, scenes=scenes))
    assert (short, settings.starts) == (32, 64)
    assert study.planner(long)[0] == 8


def test_jobs_have_files_of_their_own(tmp_path):
    names = [job.path.name for job in world_jobs(a_study(seeds=(0,)), tmp_path)]
    assert names == [
        f"{what}-{world}{end}.json"
        for world in ("one", "two")
        for what, end in (("heuristics", ""), ("planner", ""), ("training", "-0"), ("policy-0", ""))
    ]
