"""Strata of a batch: their counts, their shapes, and the distribution that they stand for."""

import itertools

import jax
import numpy as np
import pytest

from foveate.learning.strata import MAX_SHAPES, strata
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.episodes import training_episode

PAPER = SceneSettings()


@pytest.mark.parametrize("episodes", [6, 60, 1024, 7])
def test_every_number_of_targets_has_its_share(episodes):
    """Six numbers of targets, each a sixth; those left over are drawn, in scenes with the whole distribution."""
    found = strata(PAPER, episodes)
    targets = np.concatenate([stratum.targets for stratum in found])
    assert len(targets) == episodes
    np.testing.assert_array_equal(np.bincount(targets, minlength=9)[3:], episodes // 6)
    assert (targets == 0).sum() == episodes % 6
    for stratum in found:
        assert stratum.targets.max() <= stratum.scenes.targets_max
        if (stratum.targets == 0).any():
            assert stratum.scenes == PAPER
    assert strata(PAPER, 5)[0].targets.tolist() == [0] * 5, "too few for every number: all are drawn"


def test_shapes_are_few_and_share_the_work():
    """A small batch has one shape; the heaviest shape is as light as any division makes it (brute force)."""
    assert [len(strata(PAPER, episodes)) for episodes in (6, 48, 60, 1024, 10_000)] == [1, 1, 2, 4, MAX_SHAPES]

    def heaviest(ends):
        return max((high - low) * high * 3 * high for low, high in itertools.pairwise((2, *ends, 8)))

    for episodes, shapes in ((60, 2), (1024, 4)):
        ends = [stratum.scenes.targets_max for stratum in strata(PAPER, episodes)]
        assert heaviest(ends[:-1]) == min(map(heaviest, itertools.combinations(range(3, 8), shapes - 1)))
    one = SceneSettings(targets_min=4, targets_max=4)
    assert [(stratum.scenes, len(stratum.targets)) for stratum in strata(one, 1000)] == [(one, 1000)]


def test_episodes_have_the_distribution_of_the_scenario():
    """600 episodes, 100 of each number of targets: each has its targets, its steps and its region."""
    problem, seen = Scenario().problem(), {}
    for stratum in strata(PAPER, 600):
        keys = jax.random.split(jax.random.key(len(seen)), len(stratum.targets))
        make = jax.jit(
            jax.vmap(lambda key, n, scenes=stratum.scenes: training_episode(problem, scenes, key, False, targets=n))
        )
        episodes = make(keys, stratum.targets)
        present = np.asarray(episodes.present)
        np.testing.assert_array_equal(present.sum(axis=1), stratum.targets)
        np.testing.assert_array_equal(episodes.horizon, 3 * stratum.targets)
        for n in np.unique(stratum.targets):
            seen[int(n)] = np.abs(np.asarray(episodes.mean)[stratum.targets == n][:, :n]).max()
    assert list(seen) == list(range(3, 9))
    for n, farthest in seen.items():  # the box of 2 n, and an error of the first mean
        assert 1.9 * n < farthest < 2 * n + 3
