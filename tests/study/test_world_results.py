"""Results of a suite of worlds, of made-up scores."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy import stats

from foveate.experiment.presets import PRESETS
from foveate.experiment.run_folder import METRICS, Outcome, Validation
from foveate.study.jobs import Trained
from foveate.study.world_results import DATA, TABLE, publish_worlds, world_results
from foveate.study.worlds import Scored, worlds_study

RNG = np.random.default_rng(0)
BASE = RNG.normal(4.0, 1.0, 30)
SEEDS = {0: BASE + 1.0, 10: BASE + 1.4}
HEURISTICS = {"nearest": BASE + RNG.normal(0.0, 0.3, 30), "still": BASE - 3.0}
PLANNER = BASE[:8] + 2.2
STUDY = worlds_study({"hall": PRESETS["quadrotor"], "plane": PRESETS["paper"]}, seeds=(0, 10))


def scored(world: str, planner=PLANNER, note="") -> list[Scored]:
    def one(method, kind, scores, seed=None, note=""):
        values = tuple(np.asarray(scores).tolist())
        return Scored(world=world, method=method, kind=kind, training_seed=seed, scores=values, note=note)

    return [
        *(one(name, "heuristic", scores) for name, scores in HEURISTICS.items()),
        one("icr-64", "planner", planner, note=note),
        *(one("policy", "policy", scores, seed) for seed, scores in SEEDS.items()),
    ]


@pytest.fixture
def trained(tmp_path):
    """Trainings of 100 and 300 s in each world."""
    made = []
    for name in STUDY.worlds:
        for seed, seconds in ((0, 100.0), (10, 300.0)):
            run = tmp_path / f"{name}-{seed}"
            run.mkdir()
            numbers = {"objective": 0.0, "gradient_norm": 1.0, "held_out": 1.0, "at_limit": 0.0, "best": True}
            validation = Validation(epoch=1, epochs_per_s=1.0, elapsed_s=seconds, **numbers)
            (run / METRICS).write_text(json.dumps(asdict(validation)) + "\n")
            outcome = Outcome(epochs=1, best_epoch=1, best_score=1.0, rollbacks=0, stopped="")
            made.append(Trained(name=name, seed=seed, run=run, experiment=STUDY.worlds[name], outcome=outcome))
    return made


def test_numbers_of_a_world(trained):
    hall, plane = world_results(STUDY, [*scored("hall"), *scored("plane", (), "it has a schedule")], trained)
    ours = (SEEDS[0] + SEEDS[10]) / 2
    assert hall.objective == "mean"
    assert hall.mean == pytest.approx(ours.mean())
    assert hall.by_seed == pytest.approx([SEEDS[0].mean(), SEEDS[10].mean()])
    assert hall.ci95 == pytest.approx(stats.t.interval(0.95, 29, ours.mean(), stats.sem(ours)))
    assert [lead.method for lead in hall.heuristics] == ["nearest", "still"]
    lead = ours - HEURISTICS["nearest"]
    assert hall.heuristics[0].standard_errors == pytest.approx(lead.mean() / stats.sem(lead))
    assert hall.heuristics[1].difference == pytest.approx(4.2)
    assert hall.beats_heuristics
    way = (ours[:8] - HEURISTICS["nearest"][:8]).mean() / (PLANNER - HEURISTICS["nearest"][:8]).mean()
    assert hall.way == pytest.approx(way)
    assert hall.planner is not None
    assert hall.planner.difference == pytest.approx(-1.0)
    assert hall.reaches_planner is False
    assert hall.training_s == 200.0
    assert (plane.planner, plane.way, plane.reaches_planner) == (None, None, None)
    assert plane.no_planner == "it has a schedule"


@pytest.mark.parametrize(
    ("planner", "way", "reaches"),
    [
        (BASE[:8] + 1.21, True, True),  # 99 % of the way
        (BASE[:8] + 0.9, True, True),  # beyond it
        (HEURISTICS["nearest"][:8] - 1.0, False, True),  # the planner is worse than the heuristic
    ],
)
def test_a_planner_that_is_reached(planner, way, reaches, trained):
    hall = world_results(STUDY, [*scored("hall", planner), *scored("plane")], trained)[0]
    assert (hall.way is not None) == way
    assert hall.reaches_planner is reaches


def test_a_heuristic_that_is_not_clearly_beaten(trained):
    same = [
        replace(each, scores=tuple(SEEDS[0].tolist())) if each.method in ("policy", "still") else each
        for each in scored("hall")
    ]
    hall = world_results(STUDY, [*same, *scored("plane")], trained)[0]
    assert hall.heuristics[0].method == "still"
    assert hall.heuristics[0].standard_errors == 0.0
    assert not hall.beats_heuristics


def test_the_page_and_the_data(trained, tmp_path):
    results = world_results(STUDY, [*scored("hall"), *scored("plane", (), "it has a schedule")], trained)
    tables = publish_worlds(STUDY, tmp_path, results)
    page, data = (tmp_path / TABLE).read_text(), json.loads((tmp_path / DATA).read_text())
    assert "# The suite of worlds" in page
    nearest = HEURISTICS["nearest"].mean()
    assert f"| hall | nearest {nearest:.2f} |" in page
    assert tables[0].rows[1][4:6] == ("-", "-")
    assert tables[1].header == ("world", "objective", "nearest", "still")
    assert tables[2].rows[0][2:] == (f"{SEEDS[0].mean():.2f}", f"{SEEDS[10].mean():.2f}")
    hall, plane = data["worlds"]
    assert (hall["beats_heuristics"], hall["reaches_planner"], plane["reaches_planner"]) == (True, False, None)
    assert hall["planner"]["episodes"] == 8
    assert data["training_seeds"] == [0, 10]
