"""Metrics by hand, by brute force and by scipy."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.distance import mahalanobis
from scipy.stats import chi2, multivariate_normal

from foveate.evaluation import metrics
from foveate.evaluation.metrics import chi_square_band, longest_run, measures
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene
from foveate.simulation.records import Trace


def brute_force_run(column):
    best = 0
    for start in range(len(column)):
        for stop in range(start + 1, len(column) + 1):
            if column[start:stop].all():
                best = max(best, stop - start)
    return best


def test_longest_run():
    rng = np.random.default_rng(0)
    for share in (0.0, 0.3, 0.8, 1.0):
        for steps in (1, 2, 12):
            flags = rng.random((steps, 7)) < share
            np.testing.assert_array_equal(
                longest_run(flags, np.ones(len(flags))), [brute_force_run(c) for c in flags.T]
            )


@pytest.mark.parametrize("dof", [1, 2, 3, 4, 6])
@pytest.mark.parametrize("count", [5, 30, 1000])
def test_chi_square_band(dof, count):
    expected = np.array(chi2.interval(0.95, dof * count)) / count
    np.testing.assert_allclose(chi_square_band(dof, count), expected, rtol=0.05 if dof * count < 20 else 2e-3)


def test_chi_square_band_of_a_single_episode_is_a_band():
    for dof in (1, 2, 4):
        low, high = chi_square_band(dof, 1)
        expected = chi2.interval(0.95, dof)
        assert 0 <= low < high
        np.testing.assert_allclose(low, expected[0], atol=0.05)
        np.testing.assert_allclose(high, expected[1], rtol=0.03)


def traces(count, *arrays):
    """The same trace of `count` episodes."""
    return jax.tree.map(lambda x: np.stack([x] * count), Trace(*map(jnp.asarray, arrays)))


def test_measures_by_hand():
    """Two targets, of which the second is never seen; three of five steps count, a third column is padding."""
    scene = Scene(id="s", agent=(0.0,) * 3, targets=((0.0, 0.0),) * 2, drift=((0.0, 0.0),) * 2, horizon=3)
    visible = np.array([[0, 0, 1], [0, 0, 1], [1, 0, 1], [1, 1, 1], [1, 1, 1]], bool)
    information = np.tile(np.eye(2), (6, 3, 1, 1)) * 1e6
    information[3, 0], information[3, 1] = np.diag([4.0, 1.0]), np.diag([1.0, 9.0])
    mean, truth = np.full((6, 3, 2), 77.0), np.zeros((6, 3, 2))
    mean[3, :2] = [[0.5, 1.0], [3.0, -0.5]]
    truth[3, :2] = [[0.0, 0.0], [3.0, 0.5]]
    log_det = np.full((5, 3), 1e9)
    log_det[:2, :2] = [[1.0, 0.0], [2.0, 3.0]]
    log_det[2, :2] = [np.log(4), np.log(9)]
    # A second episode, of one target for five steps, changes nothing of the first.
    other = Scene(id="t", agent=(0.0,) * 3, targets=((0.0, 0.0),), drift=((0.0, 0.0),), horizon=5)
    arrays = (np.zeros((6, 3)), np.zeros((5, 2)), mean, information, log_det, visible, np.ones((6, 3), bool))
    problem = replace(Scenario(), tau_s=0.5).problem()
    found, second = measures(problem, traces(2, *arrays), np.stack([truth, truth]), [scene, other])
    entropies = [multivariate_normal(np.zeros(2), np.linalg.inv(information[3, j])).entropy() for j in range(2)]
    expected = {
        "score": (np.log(4) + np.log(9)) / 2,
        "entropy": np.mean(entropies),
        "seen_fraction": 0.5,
        "seen_step_fraction": 1 / 6,
        "longest_unseen_s": 3 * 0.5,
        "rmse_m": np.sqrt((0.25 + 1.0 + 1.0) / 2),
        "nees": ((4 * 0.25 + 1.0) + 9.0 * 1.0) / 2,
        "rmse_seen_m": np.sqrt(1.25),
        "rmse_unseen_m": 1.0,
        "nees_seen": 2.0,
        "nees_unseen": 9.0,
    }
    assert found.pop("objective") is None
    assert found.pop("contacts") is None, "there are no obstacles"
    assert found == pytest.approx(expected, abs=1e-12)
    over_steps = {"terminal": expected["score"], "mean": (6 + np.log(4) + np.log(9)) / 6, "seen": 1 / 6}
    for objective, value in over_steps.items():
        scored = measures(problem, traces(2, *arrays), np.stack([truth, truth]), [scene, other], objective)
        assert scored[0]["objective"] == pytest.approx(value)
    assert (second["score"], second["seen_step_fraction"], second["longest_unseen_s"]) == (1e9, 3 / 5, 2 * 0.5)
    assert second["rmse_m"] == pytest.approx(77 * np.sqrt(2))
    assert second["rmse_unseen_m"] is None


def test_measures_without_targets():
    scene = Scene(id="s", agent=(0.0,) * 3, targets=(), drift=(), horizon=2)
    shapes = ((3, 3), (2, 2), (3, 1, 2), (3, 1, 2, 2), (2, 1))
    arrays = (*map(np.zeros, shapes), np.zeros((2, 1), bool), np.zeros((3, 1), bool))
    (found,) = measures(Scenario().problem(), traces(1, *arrays), np.zeros((1, 3, 1, 2)), [scene], "mean")
    names = ("score", "objective", "entropy", "rmse_seen_m", "rmse_unseen_m", "nees_seen", "nees_unseen", "contacts")
    nothing = dict.fromkeys(names)
    zeros = dict.fromkeys(("seen_fraction", "seen_step_fraction", "longest_unseen_s", "rmse_m", "nees"), 0.0)
    assert found == nothing | zeros


def test_nees_is_the_squared_mahalanobis_distance():
    rng = np.random.default_rng(1)
    error, root = rng.normal(size=(4, 5, 3)), rng.normal(size=(4, 5, 3, 3))
    information = root @ root.swapaxes(-1, -2)
    found = metrics.nees(error, information)
    for index in np.ndindex(4, 5):
        assert found[index] == pytest.approx(mahalanobis(error[index], np.zeros(3), information[index]) ** 2)


def test_mean_log_det_counts_the_targets_present():
    log_det = np.array([[1.0, 2.0, 3.0], [4.0, 50.0, 6.0], [7.0, np.nan, 9.0], [1.0, 1.0, 1.0]])
    present = np.array([[1, 1, 0], [1, 1, 1], [0, 0, 1], [0, 0, 0]], bool)
    np.testing.assert_allclose(metrics.mean_log_det(log_det, present), [1.5, 20.0, 9.0, np.nan])


def test_effective_count_gives_the_variance_of_a_weighted_mean():
    weights = np.array([5, 1, 3, 20, 2])
    samples = np.random.default_rng(2).standard_normal((200_000, len(weights)))
    variance = np.var(samples @ weights / weights.sum())
    assert 1 / variance == pytest.approx(metrics.effective_count(weights), rel=0.02)
    assert metrics.effective_count(np.ones(7)) == 7.0
    assert metrics.effective_count(np.zeros(0)) == 1.0
