"""Gradients of an episode's score: segments that are recomputed, and windows that truncate backpropagation."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.episodes import training_episode

from foveate.experiment.presets import TrainingSettings
from foveate.learning.learner import episode_score
from foveate.learning.policy_gradient import objective
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.records import Backpropagation, Policy
from foveate.simulation.rollout import log_dets

STEPS = 5
SCENARIO = Scenario(scenes=SceneSettings(targets_min=2, targets_max=2, steps=STEPS))
PROBLEM = SCENARIO.problem()
EPISODE = training_episode(PROBLEM, SCENARIO.scenes, jax.random.key(4), noise=False)
KEY = jax.random.key(0)


class Changing(Policy):
    """The tanh of weights times what is seen of the first target; at each step by its own row of weights."""

    weights: jax.Array

    def __call__(self, observation, memory, key):
        seen = jnp.concatenate([observation.mean[0], observation.pose])
        return jnp.tanh(0.1 * self.weights[observation.step] @ seen + memory), memory + 0.01

    def start(self, observation):
        return 0.1 * observation.mean[1, 0]


WEIGHTS = jnp.asarray(np.random.default_rng(1).normal(size=(STEPS, 2, 5)))


@pytest.fixture(scope="module")
def plain():
    """Derivative of each log det by the weights of each step: (K, K, ...), with everything stored."""
    scores = jax.jit(jax.jacrev(lambda w: jnp.mean(log_dets(PROBLEM, Changing(w), EPISODE, SOFT, KEY), axis=-1)))
    return np.asarray(scores(WEIGHTS))


SOFT = TrainingSettings().protocol


@jax.jit
def scored(weights):
    """The log dets of each step."""
    return log_dets(PROBLEM, Changing(weights), EPISODE, SOFT, KEY)


@pytest.mark.slow
@pytest.mark.parametrize("segment", [2, 9])
def test_segments_that_are_run_again_give_the_same_gradient(plain, segment):
    def last(w):
        return jnp.mean(log_dets(PROBLEM, Changing(w), EPISODE, SOFT, KEY, Backpropagation(segment=segment))[-1])

    value, gradient = jax.jit(jax.value_and_grad(last))(WEIGHTS)
    assert value == pytest.approx(float(jnp.mean(scored(WEIGHTS)[-1])), 1e-12)
    assert np.abs(plain[-1]).max() > 1e-3
    np.testing.assert_allclose(gradient, plain[-1], rtol=1e-9, atol=1e-12)


def windowed(objective_, window):
    settings = TrainingSettings(objective=objective_, window=window, segment=2)
    value, gradient = jax.jit(jax.value_and_grad(lambda w: objective(PROBLEM, Changing(w), EPISODE, settings, KEY)))(
        WEIGHTS
    )
    log_det = scored(WEIGHTS)
    assert value == pytest.approx(float(episode_score(log_det, EPISODE, objective_ == "terminal")), 1e-12)
    return np.asarray(gradient)


def test_a_window_differentiates_a_decision_up_to_its_end(plain):
    """Weights of step k act on scores from k on; with windows of 2, on those up to the end of k's own window."""
    ends = [1, 1, 3, 3, 4]
    expected = np.stack([plain[ends[k], k] for k in range(STEPS)])
    np.testing.assert_allclose(windowed("terminal", 2), expected, rtol=1e-9, atol=1e-12)
    mean = np.stack([plain[k : ends[k] + 1, k].sum(axis=0) / STEPS for k in range(STEPS)])
    np.testing.assert_allclose(windowed("mean", 2), mean, rtol=1e-9, atol=1e-12)
    assert not np.allclose(expected[0], plain[-1][0], rtol=1e-3), "further on it would be another one"


def test_a_window_as_long_as_the_episode_is_exact(plain):
    np.testing.assert_allclose(windowed("terminal", STEPS), plain[-1], rtol=1e-9, atol=1e-12)


def test_differentiation_settings_are_checked():
    for name in ("micro_batch", "segment", "window"):
        with pytest.raises(ValueError, match=f"{name} = 0: expected >= 1"):
            TrainingSettings(**{name: 0})
    assert eqx.tree_equal(TrainingSettings(segment=3, window=6).backpropagation, Backpropagation(segment=3, window=6))
