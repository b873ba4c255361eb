"""GOSPA against Stone Soup's, and a case by hand."""

import datetime

import numpy as np
import pytest

from foveate.evaluation.gospa import gospa, mean_gospa


def test_parts_by_hand():
    """One pair 3 m apart, one target and two tracks alone; c = 10: 9, 50 and 100."""
    found = gospa(np.array([[0.0, 3.0], [50.0, 0.0], [60.0, 0.0]]), np.array([[0.0, 0.0], [0.0, 40.0]]), 10.0)
    np.testing.assert_allclose(found, [np.sqrt(159.0), 3.0, np.sqrt(50.0), 10.0])


def test_a_pair_at_the_distance_c_is_a_target_and_a_track_alone():
    found = gospa(np.array([[10.0, 0.0]]), np.array([[0.0, 0.0]]), 10.0)
    np.testing.assert_allclose(found, [10.0, 0.0, np.sqrt(50.0), np.sqrt(50.0)])


def test_nothing_is_nothing():
    assert gospa(np.zeros((0, 2)), np.zeros((0, 2)), 1.0) == (0.0, 0.0, 0.0, 0.0)


def test_padding_does_not_count_in_the_mean():
    position, target = np.zeros((2, 2, 2)), np.zeros((2, 3, 2))
    reported, alive = np.array([[True, False], [False, False]]), np.array([[True, False, False], [True, True, False]])
    np.testing.assert_allclose(mean_gospa(position, reported, target, alive, 2.0), [1.0, 0.0, 1.0, 0.0])


@pytest.mark.parametrize("d", [2, 3])
def test_gospa_is_stone_soups(d):
    metrics = pytest.importorskip("stonesoup.metricgenerator.ospametric")
    from stonesoup.types.state import State

    rng, now = np.random.default_rng(d), datetime.datetime(2000, 1, 1)
    theirs = metrics.GOSPAMetric(p=2, c=4.0)
    for _ in range(30):
        estimates, targets = (rng.uniform(-6, 6, (rng.integers(0, 7), d)) for _ in range(2))
        if not len(estimates) or not len(targets):
            continue
        mine = gospa(estimates, targets, 4.0)
        states = [[State(point, timestamp=now) for point in points] for points in (estimates, targets)]
        found = theirs.compute_gospa_metric(*states)
        found = found[0] if isinstance(found, tuple) else found
        value = found.value
        np.testing.assert_allclose(mine.gospa, value["distance"], rtol=1e-9)
        squares = [value["localisation"], value["missed"], value["false"]]
        np.testing.assert_allclose(np.square(mine[1:]), squares, rtol=1e-9, atol=1e-9)
