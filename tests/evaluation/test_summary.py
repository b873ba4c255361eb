"""Cells of rows: means by numpy, intervals and bands by scipy."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy.stats import chi2
from scipy.stats import t as student

from foveate.evaluation.evaluate import Row
from foveate.evaluation.summary import summarise


def row(scene, score, nees, seen):
    numbers = {"seen_fraction": seen, "seen_step_fraction": seen / 2, "rmse_m": 2 * seen, "nees": nees}
    names = {"method": "m", "protocol": "true", "motion": "biased", "targets": 4, "episode": 0, "seed": 0}
    numbers |= {"rmse_seen_m": None, "rmse_unseen_m": 2 * seen, "nees_seen": None, "nees_unseen": nees}
    return Row(scene=scene, score=score, entropy=0.0, longest_unseen_s=seen, step_time_s=1.0, **numbers, **names)


def test_summary_statistics():
    rng = np.random.default_rng(1)
    scenes = [f"s{i}" for i in range(12) for _ in range(3)]
    score, nees, seen = rng.normal(3, 2, 36), rng.chisquare(2, 36), rng.random(36)
    given = [row(*values) for values in zip(scenes, score.tolist(), nees.tolist(), seen.tolist(), strict=True)]
    given = [replace(one, episode=i % 3, objective=2.0 * one.score) for i, one in enumerate(given)]
    (cell,) = summarise(given, state_size=2)
    (twice,) = summarise(given + given, state_size=2)
    assert twice.nees_band == cell.nees_band, "the same noise twice, as for two training seeds, adds no information"
    means = score.reshape(12, 3).mean(axis=1)
    half = student.ppf(0.975, 11) * means.std(ddof=1) / np.sqrt(12)
    names = ("mean", "std", "seen_fraction", "seen_step_fraction", "longest_unseen_s", "rmse_m", "nees")
    expected = [score.mean(), score.std(ddof=1), *(seen.mean() * np.array([1, 0.5, 1, 2])), nees.mean()]
    found = [getattr(cell, name) for name in names]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    np.testing.assert_allclose(cell.ci95, [score.mean() - half, score.mean() + half], rtol=1e-10)
    np.testing.assert_allclose(cell.nees_band, np.array(chi2.interval(0.95, 2 * 4 * 36)) / (4 * 36), rtol=2e-3)
    assert cell.episodes == 36
    assert cell.objective == pytest.approx(2 * score.mean())
    assert summarise([replace(one, objective=None) for one in given], 2)[0].objective is None
    (single,) = summarise(given[:1], state_size=2)
    assert (single.std, single.ci95) == (0.0, (single.mean, single.mean))
    order = [row_.method for row_ in (replace(given[0], method="b"), replace(given[0], method="a"))]
    assert [c.method for c in summarise([replace(given[0], method=m) for m in order], 2)] == ["b", "a"]
    assert asdict(cell)["ci95"] == cell.ci95


def test_targets_seen_and_never_seen_are_separate():
    """Every target counts once in NEES, every episode once in RMSE; a group that is empty has no numbers."""
    one = replace(row("a", 1.0, 2.0, 0.0), seen_fraction=1.0, nees_seen=1.0, nees_unseen=None, rmse_seen_m=0.1)
    other = replace(row("b", 1.0, 2.0, 0.0), seen_fraction=0.25, nees_seen=4.0, nees_unseen=3.0, rmse_seen_m=0.3)
    one, other = replace(one, rmse_unseen_m=None), replace(other, rmse_unseen_m=5.0)
    (cell,) = summarise([one, other], state_size=2)
    assert cell.nees_seen == pytest.approx((4 * 1.0 + 1 * 4.0) / 5)
    assert (cell.nees_unseen, cell.rmse_unseen_m) == (3.0, 5.0)
    assert cell.rmse_seen_m == pytest.approx(0.2)
    np.testing.assert_allclose(cell.nees_seen_band, np.array(chi2.interval(0.95, 2 * 5)) / 5, rtol=0.02)
    np.testing.assert_allclose(cell.nees_unseen_band, np.array(chi2.interval(0.95, 2 * 3)) / 3, rtol=0.05)
    (twice,) = summarise([one, other, one, other], state_size=2)
    assert twice.nees_seen_band == pytest.approx(cell.nees_seen_band)
    (single,) = summarise([one], state_size=2)
    assert single.nees_unseen is single.nees_unseen_band is single.rmse_unseen_m is None
