"""Normalised scores and paired differences of made-up rows, against scipy."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.comparisons import BASE, LOWEST, OTHER, SCENES, SEEDS, made_up, rows
from scipy import stats

from foveate.evaluation.bounds import with_normalised_scores
from foveate.evaluation.summary import summarise
from foveate.study.comparison import as_json, compare


@pytest.fixture(scope="module")
def comparison():
    return made_up()


def test_a_scene_counts_once_however_many_seeds(comparison):
    mean = (SEEDS[0] + SEEDS[10]) / 2
    (cell, _) = [cell for cell in comparison.summary if cell.method == "net"]
    assert (cell.motion, cell.targets, cell.episodes) == ("unbiased", 3, 2 * SCENES)
    assert cell.mean == pytest.approx(mean[0].mean())
    expected = stats.t.interval(0.95, SCENES - 1, loc=mean[0].mean(), scale=stats.sem(mean[0]))
    assert cell.ci95 == pytest.approx(expected)


def test_normalised_score_runs_from_the_lower_bound_to_the_oracle(comparison):
    for cell in comparison.summary:
        low = LOWEST[cell.motion, cell.targets]
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
    again = compare(shuffled, "net", LOWEST, 2)
    for one in comparison.differences:
        (same,) = [o for o in again.differences if (o.method, o.motion) == (one.method, one.motion)]
        assert same.mean == pytest.approx(one.mean)
        assert same.p == pytest.approx(one.p)


def test_json_keeps_the_training_seed(comparison):
    data = as_json([comparison], {"quick": True})
    assert data["quick"] is True
    assert len(data["rows"]) == 4 * 2 * SCENES
    assert {row["training_seed"] for row in data["rows"] if row["method"] == "net"} == {0, 10}
    assert {row["training_seed"] for row in data["rows"] if row["method"] == "other"} == {None}


def test_without_an_omniscient_there_is_no_normalised_score():
    cells = summarise(rows("net", BASE), 2)
    assert [cell.normalised_score for cell in with_normalised_scores(cells, [], LOWEST)] == [None, None]
    low = summarise(rows("omniscient", np.array([[-1.0] * SCENES, [-2.0] * SCENES])), 2)
    assert [cell.normalised_score for cell in with_normalised_scores(cells, low, LOWEST)] == [None, None]
