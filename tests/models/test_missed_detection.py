"""Beliefs after missed detections, against scipy's truncated normal, rejection sampling, and a consistent NEES."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm, truncnorm

from foveate.evaluation.evaluate import evaluate_traces, prepare
from foveate.evaluation.metrics import chi_square_band
from foveate.models.belief import Belief
from foveate.models.missed_detection import condition_on_missed_detection, standard_points
from foveate.planning.named import heuristic_policy
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene, SceneSettings
from foveate.scenario.sensor import SensorSettings
from foveate.simulation.records import TRUE


def gaussian(mean, covariance) -> Belief:
    return Belief(jnp.asarray(mean, float), jnp.asarray(np.linalg.inv(covariance), float))


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_points_stand_for_a_standard_normal(dimension):
    """Weights, mean and covariance to rounding; along any direction the weighted steps follow the normal's curve."""
    points, weights = standard_points(dimension)
    np.testing.assert_allclose([weights.sum(), *(weights @ points)], [1, *[0] * dimension], atol=1e-12)
    np.testing.assert_allclose(points.T @ (weights[:, None] * points), np.eye(dimension), atol=1e-12)
    for direction in np.random.default_rng(0).normal(size=(20, dimension)):
        along = points @ direction / np.linalg.norm(direction)
        order = np.argsort(along)
        assert np.abs(np.cumsum(weights[order]) - norm.cdf(along[order])).max() < 0.07


@pytest.mark.parametrize("share", [0.5, 0.2, 0.1, 0.06])
def test_the_remaining_belief_is_consistent_for_any_share(share):
    """Half-planes of 24 directions in view, but for a share of the belief: NEES (2 is honest) of a truth that is a
    truncated normal, with scipy's moments.
    """
    far = truncnorm(norm.isf(share), np.inf)
    belief, found = gaussian([0.0, 0.0], np.eye(2)), []
    for angle in np.linspace(0, 2 * np.pi, 24, endpoint=False):
        along = np.array([np.cos(angle), np.sin(angle)])
        left = condition_on_missed_detection(
            belief, jnp.eye(2), lambda points, along=along: points @ along < norm.isf(share)
        )
        error = far.mean() * along - np.asarray(left.mean)
        truth = np.eye(2) + (far.var() - 1) * np.outer(along, along) + np.outer(error, error)
        found.append(np.trace(np.asarray(left.information) @ truth))
    assert np.median(found) == pytest.approx(2.0, abs=0.1)
    assert 1.7 < min(found) <= max(found) < 2.4


def test_a_belief_almost_entirely_in_view_is_unchanged():
    belief = gaussian([0.0, 0.0], np.eye(2))
    left = condition_on_missed_detection(belief, jnp.eye(2), lambda points: points[:, 0] < norm.isf(0.01))
    np.testing.assert_array_equal(left.information, belief.information)


@pytest.mark.parametrize("edge", [-1.0, 0.0, 0.7])
def test_half_a_plane_in_view_leaves_a_truncated_normal(edge):
    """Everything with x < edge is in view; std 1.5 along x, where mean and variance are scipy's; y stays as it was."""
    belief = gaussian([0.3, -2.0], np.diag([1.5**2, 0.4**2]))
    left = condition_on_missed_detection(belief, jnp.eye(2), lambda points: points[:, 0] < edge)
    expected = truncnorm((edge - 0.3) / 1.5, np.inf, loc=0.3, scale=1.5)
    covariance = np.linalg.inv(left.information)
    np.testing.assert_allclose(left.mean, [expected.mean(), -2.0], atol=0.03)
    np.testing.assert_allclose(np.diag(covariance), [expected.var(), 0.16], rtol=0.08)
    assert abs(covariance[0, 1]) < 0.02


def test_states_correlated_with_the_position_move_along():
    """Correlated position and velocity, a disc in view: moments of those of 400,000 samples that are outside."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(4, 4)) * [[1.0], [1.0], [0.5], [0.5]]
    mean, covariance = np.array([0.5, 0.2, 1.0, -1.0]), root @ root.T + 0.1 * np.eye(4)
    samples = rng.multivariate_normal(mean, covariance, 400_000)
    outside = samples[np.hypot(*samples[:, :2].T) > 1.0]
    left = condition_on_missed_detection(
        gaussian(mean, covariance), jnp.eye(2, 4), lambda points: jnp.hypot(*points.T) <= 1.0
    )
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(left.mean / scale, outside.mean(axis=0) / scale, atol=0.03)
    found = np.linalg.inv(left.information) / np.outer(scale, scale)
    np.testing.assert_allclose(found, np.cov(outside.T) / np.outer(scale, scale), atol=0.04)


@pytest.mark.parametrize("inside", [False, True])
def test_an_empty_or_full_view_gives_no_information(inside):
    """Nothing in view: no detection was expected. All of it: the belief was wrong."""
    belief = gaussian([0.3, -2.0], np.diag([2.0, 1.0]))
    left = condition_on_missed_detection(belief, jnp.eye(2), lambda points: jnp.full(len(points), inside))
    np.testing.assert_array_equal(left.mean, belief.mean)
    np.testing.assert_array_equal(left.information, belief.information)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("missed_detections", "steps", "is_honest"), [(None, 1, False), ("used", 1, True), ("used", 12, True)]
)
def test_a_filter_that_uses_missed_detections_is_consistent(missed_detections, steps, is_honest):
    """Targets around an agent that stands still; those count that were believed in view and were never detected."""
    scenario = Scenario(
        sensor=SensorSettings(missed_detections=missed_detections), scenes=SceneSettings(initial_error="consistent")
    )
    problem, places = scenario.problem(), np.random.default_rng(0).uniform(-1, 1, (300, 20, 2)) * [4, 5] + [1, 0]
    still = ((0.0, 0.0),) * 20
    scenes = [
        Scene(id=str(i), agent=(0.0, 0.0, 0.0), targets=tuple(map(tuple, one.tolist())), drift=still, horizon=steps)
        for i, one in enumerate(places)
    ]
    suite = prepare(problem, replace(scenario.scenes, jitter_m_s=0.0), scenes, seed=0)
    trace = evaluate_traces(suite, heuristic_policy("still", problem, 2.0), TRUE)
    error = trace.mean[:, -1] - np.asarray(suite.truth.state)[:, -1]
    nees = np.einsum("eni,enij,enj->en", error, trace.information[:, -1], error)
    missed = np.asarray(problem.sensor.view.contains(jnp.asarray(trace.mean[:, 0]))) & ~trace.visible.any(axis=1)
    low, high = chi_square_band(2, int(missed.sum()))
    assert missed.sum() > 200
    assert (low < nees[missed].mean() < high) == is_honest
