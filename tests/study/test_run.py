"""Jobs of a study: done once, resumed, done again when what they depend on has changed."""

import json
from dataclasses import dataclass, replace

import pytest

from foveate.errors import InputError
from foveate.evaluation.evaluate import Row
from foveate.experiment.presets import PRESETS
from foveate.experiment.run_folder import Outcome
from foveate.simulation.records import Policy
from foveate.simulation.suites import Cell, suite
from foveate.study import jobs as reproduction
from foveate.study import study
from foveate.study.jobs import JOBS, TRAININGS
from foveate.study.methods import FULL, QUICK, Learned, Method, Training, paper_methods
from foveate.study.run import jobs, reproduce
from foveate.study.study import Study

EXPERIMENT = PRESETS["paper"]
SHORTER = replace(EXPERIMENT, training=replace(EXPERIMENT.training, epochs=7))
CALLS: list[str] = []
WEIGHTS = [""]


class Named(Policy):
    """A policy that has nothing but a name."""

    name: str

    def __call__(self, observation, memory, key):
        raise AssertionError("nobody asks it")


@dataclass(frozen=True, kw_only=True)
class MadeUp(Method):
    """Rows without a simulation; says when it is asked for them."""

    family: str = "made up"
    starts: int = 1

    def rows(self, benchmark, protocol, policy, on_progress):
        CALLS.append(f"{self.name} {protocol} {policy and policy.name}")
        on_progress(len(benchmark.suite.scenes))
        numbers = {"score": 1.5, "seen_fraction": 0.5, "seen_step_fraction": 0.25, "longest_unseen_s": 3.0}
        numbers |= {"entropy": 0.1, "rmse_m": 0.2, "nees": 2.0, "step_time_s": 1e-3}
        numbers |= {"rmse_seen_m": 0.1, "rmse_unseen_m": 0.4, "nees_seen": 1.5, "nees_unseen": 2.5}
        names = {"method": self.name, "protocol": protocol, "episode": 0, "seed": 0}
        return [
            Row(scene=scene.id, motion=scene.motion, targets=len(scene.targets), **names, **numbers)
            for scene in benchmark.suite.scenes
        ]

    def settings(self, protocol):
        return {"starts": self.starts}


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Two scenes of one target, trainings that only leave their files behind."""

    def two_scenes(problem, seed):
        return suite(EXPERIMENT.scenario.scenes, problem, seed, [Cell(1, False), Cell(1, True)], 3)

    def train(experiment, run, seed, resume, report):
        CALLS.append(f"train {run.name} resume={resume}")
        (run / "checkpoint").mkdir(parents=True, exist_ok=True)
        (run / reproduction.LAST).write_text("")
        (run / reproduction.BEST).write_text(WEIGHTS[0])
        return Outcome(epochs=1, best_epoch=1, best_score=2.0, rollbacks=0, stopped="")

    CALLS.clear()
    WEIGHTS[:] = [""]
    monkeypatch.setattr(study, "table1", two_scenes)
    monkeypatch.setattr(reproduction, "train", train)
    monkeypatch.setattr(reproduction, "load_run", lambda run: (EXPERIMENT, Named(run.name), {}))


def a_study(experiment=EXPERIMENT, starts=1, **changes) -> Study:
    methods = (
        MadeUp(name="planner", starts=starts),
        MadeUp(name="policy", training=Training(name="net", experiment=experiment)),
    )
    return Study(**{"methods": methods, "reference": "policy", "seeds": (0, 10), "scenes_per_cell": 2, **changes})


def test_jobs_follow_their_dependencies(tmp_path):
    assert [job.path.name for job in jobs(a_study(seeds=(5,)), tmp_path)] == [
        "rows-planner-surrogate.json",
        "rows-planner-true.json",
        "training-net-5.json",
        "rows-policy-5-surrogate.json",
        "rows-policy-5-true.json",
    ]
    two = (Learned(name="one", training=Training(name="net", experiment=EXPERIMENT)), *a_study().methods)
    assert len(jobs(a_study(methods=two, seeds=(0,)), tmp_path)) == 7


def test_every_job_runs_once_and_is_loaded_again(tmp_path):
    reports = []
    found = reproduce(a_study(), tmp_path, lambda done, what: reports.append((done, what)))
    parts, trained = found.parts, found.trained
    assert CALLS == [
        "planner surrogate None",
        "planner true None",
        "train net-0 resume=False",
        "policy surrogate net-0",
        "policy true net-0",
        "train net-10 resume=False",
        "policy surrogate net-10",
        "policy true net-10",
    ]
    assert [(part.method, part.training_seed, part.protocol) for part in parts[:3]] == [
        ("planner", None, "surrogate"),
        ("planner", None, "true"),
        ("policy", 0, "surrogate"),
    ]
    assert {row.scene for row in parts[0].rows} == {f"{word}-1-0{i}" for word in ("unbiased", "biased") for i in (0, 1)}
    assert [(one.name, one.seed, one.outcome.best_score) for one in trained] == [("net", 0, 2.0), ("net", 10, 2.0)]
    assert [done for done, _ in reports] == sorted(done for done, _ in reports)
    assert (0, "planner, surrogate: 4 of 4 episodes") in reports
    CALLS.clear()
    times = {path: path.stat().st_mtime_ns for path in (tmp_path / JOBS).iterdir()}
    assert reproduce(a_study(), tmp_path) == found
    assert CALLS == []
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / JOBS).iterdir()} == times


def test_interrupted_after_a_job_it_resumes_from_there(tmp_path):
    def stop(done, what):
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reproduce(a_study(), tmp_path, stop)
    assert CALLS == ["planner surrogate None"]
    first = tmp_path / JOBS / "rows-planner-surrogate.json"
    before = first.stat().st_mtime_ns
    CALLS.clear()
    reproduce(a_study(), tmp_path)
    assert CALLS[0] == "planner true None"
    assert "planner surrogate None" not in CALLS
    assert first.stat().st_mtime_ns == before


def cut_short(tmp_path, monkeypatch):
    """A study that was interrupted in the middle of a training."""
    whole = reproduction.train

    def stop(*given):
        whole(*given)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(reproduction, "train", stop)
        with pytest.raises(KeyboardInterrupt):
            reproduce(a_study(seeds=(0,)), tmp_path)
    CALLS.clear()
    return whole


def test_a_training_that_was_cut_short_resumes(tmp_path, monkeypatch):
    cut_short(tmp_path, monkeypatch)
    reproduce(a_study(seeds=(0,)), tmp_path)
    assert CALLS[0] == "train net-0 resume=True"


def test_another_version_trains_again_and_does_not_resume(tmp_path, monkeypatch):
    cut_short(tmp_path, monkeypatch)
    monkeypatch.setattr(reproduction, "__version__", "99")
    reproduce(a_study(seeds=(0,)), tmp_path)
    assert "train net-0 resume=False" in CALLS
    CALLS.clear()
    monkeypatch.setattr(reproduction, "__version__", "100")
    reproduce(a_study(seeds=(0,)), tmp_path)
    assert "train net-0 resume=False" in CALLS


def test_a_training_that_cannot_be_resumed_is_done_again(tmp_path, monkeypatch):
    whole = cut_short(tmp_path, monkeypatch)

    def reject(experiment, run, seed, resume, report):
        if resume:
            raise InputError("last.npz: holds other arrays")
        return whole(experiment, run, seed, resume, report)

    monkeypatch.setattr(reproduction, "train", reject)
    said = []
    reproduce(a_study(seeds=(0,)), tmp_path, say=said.append)
    assert CALLS[0] == "train net-0 resume=False"
    assert "holds other arrays" in said[0]


def test_rows_are_those_of_the_stored_weights(tmp_path):
    reproduce(a_study(seeds=(0,)), tmp_path)
    (tmp_path / TRAININGS / "net-0" / reproduction.BEST).unlink()
    CALLS.clear()
    WEIGHTS[0] = "other"
    reproduce(a_study(seeds=(0,)), tmp_path)
    assert CALLS == ["train net-0 resume=False", "policy surrogate net-0", "policy true net-0"]


def test_a_training_without_a_policy_is_reported(tmp_path, monkeypatch):
    nothing = Outcome(epochs=1, best_epoch=0, best_score=-float("inf"), rollbacks=0, stopped="not finite")
    monkeypatch.setattr(reproduction, "train", lambda *given: nothing)
    with pytest.raises(ValueError, match=r"net-0: no validation was finite.*not finite"):
        reproduce(a_study(seeds=(0,)), tmp_path)


@dataclass(frozen=True, kw_only=True)
class Wrong(MadeUp):
    """Leaves a scene out, or calls itself something else."""

    how: str = ""

    def rows(self, benchmark, protocol, policy, on_progress):
        rows = super().rows(benchmark, protocol, policy, on_progress)
        return rows[1:] if self.how == "missing" else [replace(row, method="me") for row in rows]


@pytest.mark.parametrize(("how", "message"), [("missing", "gave 3 rows"), ("name", "name another method")])
def test_rows_of_another_suite_or_method_are_rejected(tmp_path, how, message):
    with pytest.raises(ValueError, match=message):
        reproduce(a_study(methods=(Wrong(name="mine", how=how),), reference="mine"), tmp_path)
    assert not list((tmp_path / JOBS).iterdir())


def test_two_methods_of_one_file_are_rejected(tmp_path):
    (_, policy) = a_study().methods
    with pytest.raises(ValueError, match=r"rows-policy-0-surrogate\.json is another method's"):
        jobs(a_study(methods=(policy, MadeUp(name="policy-0"))), tmp_path)


@pytest.mark.parametrize(
    ("change", "again"),
    [
        ({"starts": 2}, ["planner surrogate None", "planner true None"]),
        ({"experiment": SHORTER}, ["train net-0 resume=False", "policy surrogate net-0", "policy true net-0"]),
        ({"scene_seed": 7}, [f"{who} {how}" for who, how in (
            ("planner surrogate", "None"), ("planner true", "None"),
            ("policy surrogate", "net-0"), ("policy true", "net-0"))]),
        ({"seeds": (0, 3)}, ["train net-3 resume=False", "policy surrogate net-3", "policy true net-3"]),
    ],
)  # fmt: skip
def test_other_settings_are_computed_again(tmp_path, change, again):
    reproduce(a_study(seeds=(0,)), tmp_path)
    CALLS.clear()
    said = []
    reproduce(a_study(**{"seeds": (0,), **change}), tmp_path, say=said.append)
    assert again == CALLS
    if "seeds" not in change:
        assert sum("made with other settings" in line for line in said) == len(again)


def test_a_changed_revision_or_version_computes_again(tmp_path, monkeypatch):
    (planner, _) = a_study().methods
    reproduce(a_study(methods=(planner,), reference="planner"), tmp_path)
    reproduce(a_study(methods=(replace(planner, revision=2),), reference="planner"), tmp_path)
    assert len(CALLS) == 4
    monkeypatch.setattr(reproduction, "__version__", "99")
    reproduce(a_study(methods=(replace(planner, revision=2),), reference="planner"), tmp_path)
    assert len(CALLS) == 6


@pytest.mark.parametrize("content", ["", "{}", '{"key": ', "[1]"])
def test_a_damaged_job_is_computed_again(tmp_path, content):
    reproduce(a_study(), tmp_path)
    CALLS.clear()
    said = []
    path = tmp_path / JOBS / "rows-planner-true.json"
    whole = path.read_text()
    path.write_text(content)
    reproduce(a_study(), tmp_path, say=said.append)
    assert CALLS == ["planner true None"]
    assert len(said) == 1
    assert str(path) in said[0]
    assert path.read_text() == whole


def test_a_run_folder_that_is_gone_is_trained_again(tmp_path):
    reproduce(a_study(seeds=(0,)), tmp_path)
    CALLS.clear()
    (tmp_path / TRAININGS / "net-0" / reproduction.BEST).unlink()
    (tmp_path / TRAININGS / "net-0" / reproduction.LAST).unlink()
    reproduce(a_study(seeds=(0,)), tmp_path)
    assert CALLS == ["train net-0 resume=False"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"reference": "nobody"}, "reference nobody: expected one of the methods planner, policy"),
        ({"seeds": ()}, "at least one"),
        ({"seeds": (1, 1)}, "each once"),
        ({"methods": (MadeUp(name="../policy"),), "reference": "../policy"}, "expected letters"),
        ({"methods": (MadeUp(name="policy"), MadeUp(name="policy"))}, "policy: is given twice"),
        (
            {
                "methods": (
                    MadeUp(name="policy", training=Training(name="net", experiment=EXPERIMENT)),
                    MadeUp(name="other", training=Training(name="net", experiment=SHORTER)),
                )
            },
            "net: means two experiments",
        ),
    ],
)
def test_an_invalid_study_is_rejected(changes, message):
    with pytest.raises(ValueError, match=message):
        a_study(**changes)


def test_the_papers_methods_hold_every_kind():
    for budget in (FULL, QUICK):
        methods = {method.name: method for method in paper_methods(budget)}
        assert {"omniscient", "paper", "refine-15", "icr", "nearest", "uncertain", "lawnmower"} <= set(methods)
        assert budget.reference in methods
        refined = methods["refine-15"].training
        assert refined is methods[budget.reference].training
        # What stands in the keys of jobs can be written as JSON.
        assert json.dumps([method.settings("true") for method in methods.values()])
    assert {"best", "icr-16"} <= {method.name for method in paper_methods(FULL)}
    short = {method.name: method for method in paper_methods(QUICK)}["paper"].training
    assert short is not None
    assert short.experiment.training.epochs < EXPERIMENT.training.epochs
