"""Intervals and tests against scipy, closed forms and tables worked by hand."""

import numpy as np
import pytest
from scipy import stats

from foveate.evaluation.statistics import holm, mean_interval, paired


@pytest.mark.parametrize("count", [2, 5, 30])
def test_interval_is_students(count):
    values = np.random.default_rng(count).normal(3.0, 2.0, count)
    expected = stats.t.interval(0.95, count - 1, loc=values.mean(), scale=stats.sem(values))
    np.testing.assert_allclose(mean_interval(values), expected, rtol=1e-10)


def test_interval_holds_the_mean_95_times_of_100():
    draws = np.random.default_rng(0).normal(1.0, 1.0, (4000, 4))
    inside = [low < 1.0 < high for low, high in map(mean_interval, draws)]
    # 0.95 with a sampling error of 0.0034; the normal interval would hold it in 86 % of cases.
    assert abs(np.mean(inside) - 0.95) < 0.011


def test_one_value_has_no_interval():
    assert mean_interval([2.5]) == (2.5, 2.5)


def test_signed_rank_by_hand():
    """Five pairs, all larger: of 2^5 sign patterns one is as extreme on each side, p = 2 / 32."""
    second = np.array([1.0, 2.0, -3.0, 0.5, 7.0])
    found = paired(second + np.arange(1, 6) / 10, second)
    assert found.p == pytest.approx(2 / 32)
    assert found.mean == pytest.approx(0.3)
    half = 2.7764451 * np.sqrt(0.025) / np.sqrt(5)  # t of 4 degrees of freedom, from a table
    assert found.ci95 == pytest.approx((0.3 - half, 0.3 + half), rel=1e-6)


def test_direction_matters_to_the_mean_and_not_to_p():
    rng = np.random.default_rng(1)
    first, second = rng.normal(0.4, 1, 20), rng.normal(0, 1, 20)
    there, back = paired(first, second), paired(second, first)
    assert there.mean == pytest.approx(-back.mean)
    assert there.p == pytest.approx(back.p)
    assert there.p == pytest.approx(stats.wilcoxon(first, second).pvalue)


def test_nothing_differs():
    found = paired([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    assert (found.mean, found.ci95, found.p) == (0.0, (0.0, 0.0), 1.0)


def test_holm_by_hand():
    """Sorted .005 x4, .01 x3, .03 x2, .04 x1: .02, .03, .06, and .04 raised to .06."""
    np.testing.assert_allclose(holm([0.01, 0.04, 0.03, 0.005]), [0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, 0.7]) == [1.0, 1.0]
    assert holm([]) == []
