"""Marginal association probabilities against the sum over all assignments, and Stone Soup's belief propagation."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.models.detections.association import ITERATIONS, Association, associate


def all_assignments(missed, pair, unclaimed):
    """Marginals by the definition: every way to give each track one detection or none, no detection to two."""
    n, m = pair.shape
    total, none, both, free = 0.0, np.zeros(n), np.zeros((n, m)), np.zeros(m)
    for choice in itertools.product(range(-1, m), repeat=n):
        used = [j for j in choice if j >= 0]
        if len(used) > len(set(used)):
            continue
        left = [j for j in range(m) if j not in used]
        weight = np.prod([missed[i] if j < 0 else pair[i, j] for i, j in enumerate(choice)]) * np.prod(unclaimed[left])
        total += weight
        free[left] += weight
        for i, j in enumerate(choice):
            if j < 0:
                none[i] += weight
            else:
                both[i, j] += weight
    return none / total, both / total, free / total


def weights(rng, n, m, detection, clutter, std=1.0, width=6.0):
    """Weights of tracks and detections at random places of a square: existences, a Gaussian of each distance."""
    tracks, points = rng.uniform(0, width, (n, 2)), rng.uniform(0, width, (m, 2))
    points[: min(n, m)] = (tracks + rng.normal(0, std, tracks.shape))[: min(n, m)]
    existence = rng.uniform(0.2, 1.0, n)
    squared = ((tracks[:, None] - points) ** 2).sum(axis=-1) / std**2
    density = np.exp(-0.5 * squared) / (2 * np.pi * std**2)
    return 1 - existence * detection, existence[:, None] * detection * density, np.full(m, clutter / width**2)


def found(missed, pair, unclaimed, iterations=ITERATIONS):
    """Marginals by messages, padded to 4 tracks and 4 detections so that all is compiled once."""
    n, m = pair.shape
    padded = np.ones(4), np.zeros((4, 4)), np.zeros(4)
    padded[0][:n], padded[1][:n, :m], padded[2][:m] = missed, pair, unclaimed
    result = jax.jit(associate, static_argnums=3)(*map(jnp.asarray, padded), iterations)
    return Association(result.missed[:n], result.pair[:n, :m], result.unclaimed[:m])


@pytest.mark.parametrize(("detection", "clutter"), [(0.9, 1.0), (0.6, 2.0), (0.98, 0.3)])
def test_marginals_are_those_of_all_assignments(detection, clutter):
    """To 1e-2 in four of five scenes and in the mean; loops cost up to 0.25 in single pairs of crowded ones."""
    rng, means, worst = np.random.default_rng(0), [], []
    for _ in range(60):
        given = weights(rng, rng.integers(1, 5), rng.integers(1, 5), detection, clutter, width=10.0)
        error = [np.abs(a - b).ravel() for a, b in zip(found(*given), all_assignments(*given), strict=True)]
        means.append(np.concatenate(error).mean())
        worst.append(np.concatenate(error).max())
    assert np.quantile(worst, 0.8) < 0.001
    assert np.mean(means) < 0.005
    assert np.max(worst) < 0.25


def test_one_track_or_one_detection_has_no_loop_and_is_exact():
    rng = np.random.default_rng(1)
    for n, m in [(1, 4), (4, 1), (1, 1)]:
        given = weights(rng, n, m, 0.9, 1.0)
        for mine, exact in zip(found(*given), all_assignments(*given), strict=True):
            np.testing.assert_allclose(mine, exact, rtol=1e-9, atol=1e-12)


def test_exact_where_one_assignment_dominates():
    rng = np.random.default_rng(2)
    given = weights(rng, 4, 4, 0.95, 0.5, std=0.05, width=40.0)
    for mine, exact in zip(found(*given), all_assignments(*given), strict=True):
        np.testing.assert_allclose(mine, exact, atol=1e-9)


def test_without_misses_and_clutter_the_only_pair_is_certain():
    result = found(np.zeros(2), np.diag([3.0, 1e-5]), np.zeros(2))
    np.testing.assert_allclose(result.pair, np.eye(2), atol=1e-9)
    np.testing.assert_allclose(result.missed, 0.0, atol=1e-9)


def test_a_detection_that_nothing_explains_changes_nothing():
    result = found(np.array([0.5]), np.array([[0.0]]), np.array([0.0]))
    np.testing.assert_allclose(result.missed, 1.0)
    assert np.isfinite(np.concatenate([np.ravel(part) for part in result])).all()


def test_the_unit_of_a_density_does_not_matter():
    missed, pair, unclaimed = weights(np.random.default_rng(3), 4, 4, 0.9, 1.0)
    for mine, other in zip(found(missed, pair, unclaimed), found(missed, 1e9 * pair, 1e9 * unclaimed), strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-9)


def test_messages_are_stone_soups():
    probability = pytest.importorskip("stonesoup.dataassociator.probability")
    rng = np.random.default_rng(4)
    for _ in range(10):
        missed, pair, unclaimed = weights(rng, 4, 3, 0.9, 1.0)
        likelihood = np.column_stack([missed, pair / unclaimed]) / missed[:, None]
        theirs = probability.JPDAwithLBP._loopy_belief_propagation(likelihood, 1000, 1e-10)
        mine = found(missed, pair, unclaimed, iterations=200)
        np.testing.assert_allclose(np.column_stack([mine.missed, mine.pair]), theirs, atol=1e-7)
