"""Closeness, paired differences and tables from rows made by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from foveate.evaluation.bounds import with_normalised_scores
from foveate.evaluation.evaluate import Row
from foveate.evaluation.summary import summarise
from foveate.io.tables import markdown
from foveate.study.comparison import Part, as_json, compare
from foveate.study.tables import tables

SCENES = 8
CELLS = (("unbiased", 3), ("biased", 5))
FLOORS = {("unbiased", 3): -1.0, ("biased", 5): -2.0}


def rows(method: str, scores: np.ndarray, protocol: str = "true", seconds: float = 1e-3) -> tuple[Row, ...]:
    """One row for each of `scores` (cell, scene)."""
    numbers = {"seen_fraction": 0.5, "seen_step_fraction": 0.25, "longest_unseen_s": 3.0, "entropy": 0.1}
    numbers |= {"rmse_m": 0.2, "nees": 2.0, "step_time_s": seconds, "episode": 0, "seed": 0}
    numbers |= {"rmse_seen_m": 0.1, "rmse_unseen_m": 0.4, "nees_seen": 1.5, "nees_unseen": 2.5}
    return tuple(
        Row(scene=f"{motion}-{n}-{i}", score=float(scores[c, i]), motion=motion, targets=n, method=method,
            protocol=protocol, **numbers)
        for c, (motion, n) in enumerate(CELLS)
        for i in range(scores.shape[1])
    )  # fmt: skip


RNG = np.random.default_rng(0)
BASE = RNG.normal(4.0, 2.0, (2, SCENES))
SEEDS = {0: BASE + 0.5, 10: BASE + RNG.normal(0, 0.3, (2, SCENES))}
OTHER = BASE + RNG.normal(1.0, 0.7, (2, SCENES))
ORACLE = np.full((2, SCENES), 9.0)


@pytest.fixture(scope="module")
def comparison():
    def part(method, family, scores, seed=None):
        return Part(method=method, family=family, training_seed=seed, protocol="true", rows=rows(method, scores))

    parts = [
        part("omniscient", "omniscient", ORACLE),
        *(part("net", "trained", scores, seed) for seed, scores in SEEDS.items()),
        part("other", "planned", OTHER),
    ]
    return compare(parts, "net", FLOORS, 2)


def test_a_scene_counts_once_however_many_seeds(comparison):
    mean = (SEEDS[0] + SEEDS[10]) / 2
    (cell, _) = [cell for cell in comparison.summary if cell.method == "net"]
    assert (cell.motion, cell.targets, cell.episodes) == ("unbiased", 3, 2 * SCENES)
    assert cell.mean == pytest.approx(mean[0].mean())
    expected = stats.t.interval(0.95, SCENES - 1, loc=mean[0].mean(), scale=stats.sem(mean[0]))
    assert cell.ci95 == pytest.approx(expected)


def test_closeness_runs_from_the_floor_to_the_omniscient(comparison):
    for cell in comparison.summary:
        low = FLOORS[cell.motion, cell.targets]
        assert cell.normalised_score == pytest.approx((cell.mean - low) / (9.0 - low))
    (overall,) = [one for one in comparison.overall if one.method == "omniscient"]
    assert overall.normalised_score == pytest.approx(1.0)
    (other,) = [one for one in comparison.overall if one.method == "other"]
    means = OTHER.mean(axis=1)
    assert other.normalised_score == pytest.approx(((means[0] + 1) / 10 + (means[1] + 2) / 11) / 2)
    assert other.mean == pytest.approx(means.mean())


def test_differences_are_paired_by_scene_and_corrected_over_cells(comparison):
    found = [one for one in comparison.differences if one.method == "other"]
    difference = OTHER - (SEEDS[0] + SEEDS[10]) / 2
    p = [stats.wilcoxon(row).pvalue for row in difference]
    assert [one.mean for one in found] == pytest.approx(difference.mean(axis=1).tolist())
    assert [one.p for one in found] == pytest.approx(p)
    larger = max(2 * min(p), max(p))
    assert sorted(one.p_holm for one in found) == pytest.approx(sorted([min(2 * min(p), 1.0), min(larger, 1.0)]))
    assert [one.scenes for one in found] == [SCENES] * 2
    for one, row in zip(found, difference, strict=True):
        assert one.ci95 == pytest.approx(stats.t.interval(0.95, SCENES - 1, loc=row.mean(), scale=stats.sem(row)))
    assert "net" not in {one.method for one in comparison.differences}


def test_order_of_the_rows_does_not_matter(comparison):
    shuffled = [replace(part, rows=part.rows[::-1]) for part in comparison.parts]
    again = compare(shuffled, "net", FLOORS, 2)
    for one in comparison.differences:
        (same,) = [o for o in again.differences if (o.method, o.motion) == (one.method, one.motion)]
        assert same.mean == pytest.approx(one.mean)
        assert same.p == pytest.approx(one.p)


def test_tables_say_it(comparison):
    found = tables(comparison, "true")
    text = markdown("Made up", {"scenes": "8"}, found, {"a.png": "a picture"})
    scores = found[0]
    assert scores.header[2:4] == ("3 unbiased", "5 biased")
    assert [row[0] for row in scores.rows] == ["omniscient", *sorted(("net", "other"), key=lambda m: -{
        "net": (SEEDS[0] + SEEDS[10]).mean() / 2, "other": OTHER.mean()}[m])]  # fmt: skip
    (mine,) = [row for row in scores.rows if row[0] == "other"]
    half = stats.t.ppf(0.975, SCENES - 1) * stats.sem(OTHER[0])
    assert mine[2] == f"{OTHER[0].mean():.2f} ± {half:.2f}"
    assert mine[-1] == "1.0"
    spread = next(row for row in found[-1].rows if row[1] == "std over seeds")
    assert spread[2] == f"{np.std([SEEDS[0][0].mean(), SEEDS[10][0].mean()], ddof=1):.2f}"
    assert text.startswith("# Made up\n")
    assert "![a picture](a.png)" in text
    for table in found:
        assert {len(row) for row in table.rows} == {len(table.header)}
    lines = text.splitlines()
    assert lines.count("| method | kind | 3 unbiased | 5 biased |") == 6
    assert sum(line.startswith("| other | planned |") for line in lines) == 8


def test_tables_say_whether_the_filter_knows_its_errors():
    """NEES 2 is within every band of 24 and 40 targets, 1.5 and 2.5 only within those of few."""
    given = tuple(replace(row, nees_seen=1.0, seen_fraction=1.0, nees_unseen=None) for row in rows("net", BASE))
    part = Part(method="net", family="trained", training_seed=None, protocol="true", rows=given,
                initial_error="consistent")  # fmt: skip
    found = {table.title: table for table in tables(compare([part], "net", FLOORS, 2), "true")}
    nees = found["true, consistent first errors: NEES by cell"]
    low, high = stats.chi2.interval(0.95, 2 * 3 * SCENES) / np.array(3 * SCENES)
    assert nees.rows[0][2] == f"2.00 ({low:.2f} to {high:.2f}) / 1.00* / -"
    (line,) = found["true, consistent first errors: what was seen, and whether the filter knows its errors"].rows
    assert line[2:] == ("100%", "25.0%", "3.0", "0.20", "0.10", "0.40", "2.00", "1.00", "-", "0 of 2")


def test_json_keeps_the_training_seed(comparison):
    data = as_json([comparison], {"quick": True})
    assert data["quick"] is True
    assert len(data["rows"]) == 4 * 2 * SCENES
    assert {row["training_seed"] for row in data["rows"] if row["method"] == "net"} == {0, 10}
    assert {row["training_seed"] for row in data["rows"] if row["method"] == "other"} == {None}


def test_without_an_omniscient_there_is_no_closeness():
    cells = summarise(rows("net", BASE), 2)
    assert [cell.normalised_score for cell in with_normalised_scores(cells, [], FLOORS)] == [None, None]
    low = summarise(rows("omniscient", np.array([[-1.0] * SCENES, [-2.0] * SCENES])), 2)
    assert [cell.normalised_score for cell in with_normalised_scores(cells, low, FLOORS)] == [None, None]
