"""Windows of episodes visit the states of one whole rollout; rewards, densities and advantages by textbook formulas."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.episodes import training_episode
from scipy.stats import multivariate_normal

from foveate.experiment.learners import ActorCriticSettings
from foveate.learning.trajectories import Trajectory, advantages, log_density, play, rewards
from foveate.learning.windows import Ongoing, begin_ongoing, continued, cut, plays_whole, window_steps
from foveate.learning.worlds import World
from foveate.policies.pointer import Modes
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import ScheduleSettings
from foveate.simulation.records import TRUE, Arrivals, Episode
from foveate.simulation.rollout import rollout
from foveate.simulation.step import start

NETWORK = PointerSettings(
    kind="pointer", target_widths=(8, 8), heads=2, context_widths=(8,), mode_width=8, modes=1, tells_time=True
)
CROWD = Scenario(
    scenes=SceneSettings(
        targets_min=2, targets_max=3, steps=10, half_side_per_target_m=1.0, drift_m_s=(0.6, 0.6), birth_and_death=True
    ),
    schedule=ScheduleSettings(V=(((0.04, 0.0), (0.0, 0.04)), ((0.3, 0.0), (0.0, 0.1)), ((0.01, 0.0), (0.0, 0.01)))),
)
"""Targets come and go, and the sensor's noise has a period of three steps: a step must know its number."""
WINDOWS = ActorCriticSettings(algorithm="actor-critic", window=4, episodes=8, minibatches=2)


def test_density_is_that_of_a_mixture_of_gaussians():
    rng = np.random.default_rng(0)
    weight, means, std = rng.normal(size=4), rng.uniform(-1, 1, (4, 2)), np.array([0.3, 0.7])
    share = np.exp(weight) / np.exp(weight).sum()
    for action in rng.normal(size=(5, 2)):
        density = sum(
            p * multivariate_normal(m, np.diag(std**2)).pdf(action) for p, m in zip(share, means, strict=True)
        )
        expected = np.log(density * 2 * np.pi * np.prod(std))
        found = log_density(Modes(jnp.asarray(weight), jnp.asarray(means)), jnp.asarray(action), jnp.asarray(std))
        np.testing.assert_allclose(found, expected, rtol=1e-10)


def part_of(reward, counts, ends):
    """A trajectory of which only rewards and the end matter."""
    return Trajectory(None, None, None, *map(jnp.asarray, (reward, counts, ends)))


@pytest.mark.parametrize("discount", [1.0, 0.9])
@pytest.mark.parametrize("gae_lambda", [0.0, 0.7, 1.0])
def test_advantages_are_sums_of_temporal_differences(gae_lambda, discount):
    """Schulman 2016, equation 16, written as the double sum: an episode that ends, and one that a window cuts."""
    rng = np.random.default_rng(1)
    reward, value = rng.normal(size=7), rng.normal(size=8)
    for steps, has_end in ((4, True), (7, True), (7, False)):
        k = np.arange(7)
        after = value[1 : steps + 1].copy()
        if has_end and discount == 1.0:
            after[-1] = 0.0
        delta = reward[:steps] + discount * after - value[:steps]
        weight = discount * gae_lambda
        expected = [sum(weight ** (j - i) * delta[j] for j in range(i, steps)) for i in range(steps)]
        part = part_of(reward, k < steps, (k == steps - 1) & has_end)
        found = advantages(part, jnp.asarray(value), discount, gae_lambda)
        np.testing.assert_allclose(found[:steps], expected, rtol=1e-10)
        np.testing.assert_array_equal(found[steps:], 0)


def test_windows_are_as_few_and_as_equal_as_can_be():
    for steps in range(1, 40):
        scenes = SceneSettings(steps=steps)
        for window in (1, 4, 7, 40):
            length = window_steps(scenes, replace(WINDOWS, window=window))
            fewest = min(count for count in range(1, steps + 1) if count * window >= steps)
            shortest = min(size for size in range(1, steps + 1) if fewest * size >= steps)
            assert length == shortest
            assert plays_whole(scenes, replace(WINDOWS, window=window)) == (steps <= window)


def test_rewards_sum_to_the_objective():
    """And with a discount to that of (1 - g) sum g^k s_k+1, less a constant, for all but the terminal one."""
    rng, K, n = np.random.default_rng(2), 6, 3
    log_det, visible, first = rng.normal(size=(K, n)), rng.random((K, n)) < 0.5, 0.7
    inputs = jnp.zeros((K, n, 2))
    alone = Episode(jnp.zeros(3), jnp.zeros((n, 2)), jnp.array([True, True, False]), inputs, jnp.asarray(K))
    there = np.array([[1, 1, 0], [1, 1, 0], [0, 1, 1], [0, 1, 1], [1, 1, 1], [1, 1, 1], [1, 0, 0]], bool)
    crowd = replace(alone, arrivals=Arrivals(jnp.asarray(there), jnp.zeros((K + 1, n, 2))))
    for episode, present in ((alone, np.tile([True, True, False], (K, 1))), (crowd, there[1:] & there[:-1])):
        mean = {
            name: np.array([np.mean(row[who]) for row, who in zip(values, present, strict=True)])
            for name, values in (("mean", log_det), ("seen", visible.astype(float)))
        }

        def found(objective, discounted, whole=True, episode=episode):
            arrays = (jnp.asarray(log_det), jnp.asarray(visible), jnp.asarray(first))
            return np.asarray(rewards(*arrays, episode, objective, discounted, whole))

        for discounted in (False, True):
            np.testing.assert_allclose(found("terminal", discounted).sum(), mean["mean"][-1] - first, atol=1e-12)
            np.testing.assert_allclose(found("terminal", discounted)[2], mean["mean"][2] - mean["mean"][1], atol=1e-12)
        np.testing.assert_allclose(found("mean", False).sum(), mean["mean"].mean(), atol=1e-12)
        np.testing.assert_allclose(found("seen", False).sum(), mean["seen"].mean(), atol=1e-12)
        np.testing.assert_allclose(found("mean", False, whole=False).mean(), mean["mean"].mean(), atol=1e-12)
        np.testing.assert_allclose(found("seen", True, whole=False), mean["seen"], atol=1e-12)
        g = 0.8 ** np.arange(K)
        # The tail of the series, from the last step on, is as if the score stayed.
        endless = 0.2 * g @ mean["mean"] + 0.8**K * mean["mean"][-1] - first
        np.testing.assert_allclose(g @ found("mean", True), endless, atol=1e-12)


@pytest.mark.slow
def test_windows_visit_the_states_of_the_whole_rollout(monkeypatch):
    """Without chance a window is a part of the rollout: same decisions, measurements and rewards."""
    monkeypatch.setattr(jax.random, "categorical", lambda key, logits: jnp.argmax(logits))
    problem, scenes, length = CROWD.problem(), CROWD.scenes, window_steps(CROWD.scenes, WINDOWS)
    policy = NETWORK.policy(problem, jax.random.key(4))
    assert length == 4, "three windows, of which the last goes beyond the end"

    @eqx.filter_jit
    def whole(key):
        episode = training_episode(problem, scenes, key, noise=True)
        return episode, start(problem, episode, TRUE), rollout(problem, policy, episode, TRUE, key)

    @eqx.filter_jit
    def window(episode, state, key):
        part = cut(episode, state.step, length)
        std = jnp.asarray(1e-9)
        return play(problem, policy, part, TRUE, "terminal", std, key, state, episode.horizon, True, False)

    for seed in range(3):
        episode, state, trace = whole(jax.random.key(seed))
        found = []
        for i in range(3):
            trajectory, state = window(episode, state, jax.random.key(seed + 10))
            found.append(trajectory)
            if i < 2:
                k = int(state.step)
                assert k == 4 * (i + 1)
                np.testing.assert_allclose(state.pose, trace.pose[k], atol=1e-6)
                np.testing.assert_allclose(state.mean, trace.mean[k], atol=1e-6)
                np.testing.assert_allclose(state.information[0], trace.information[k], rtol=1e-6)
                np.testing.assert_array_equal(state.present, trace.present[k])
        joined = jax.tree.map(lambda *parts: np.concatenate(parts), *(t._replace(tokens=()) for t in found))
        np.testing.assert_array_equal(joined.counts, np.arange(12) < 10)
        np.testing.assert_array_equal(joined.ends, np.arange(12) == 9)
        np.testing.assert_allclose(np.clip(joined.action[:10, [0, 2]], -1, 1), trace.action, atol=1e-6)
        both = np.asarray(trace.present[1:] & trace.present[:-1])
        score = [row[who].sum() / max(who.sum(), 1) for row, who in zip(np.asarray(trace.log_det), both, strict=True)]
        # Within a window, rewards are the growth of the score; at its start that of the beliefs that are there.
        for k in (1, 2, 3, 5, 6, 7, 9):
            np.testing.assert_allclose(joined.reward[k], score[k] - score[k - 1], atol=1e-5)
        np.testing.assert_array_equal(joined.reward[10:], 0)
        first, second = (np.asarray(found[i].tokens.features) for i in range(2))
        assert len(first) == length + 1
        np.testing.assert_allclose(first[-1], second[0], atol=1e-6, err_msg="what comes after a window begins the next")
        assert np.asarray(trace.visible).any(), "else nothing is measured"
        assert (~np.asarray(trace.present)).any(), "else nobody comes or goes"


def test_an_episode_that_has_ended_is_followed_by_a_new_one():
    problem, scenes = CROWD.problem(), CROWD.scenes
    first, fresh = (training_episode(problem, scenes, jax.random.key(i), noise=True) for i in (0, 1))
    state = replace(start(problem, first, TRUE), pose=jnp.array([1.0, 2.0, 3.0]))
    one = Ongoing(jax.random.key_data(jax.random.key(0)), state, jnp.asarray(8))
    world = World(problem=problem, scenes=scenes, objective="terminal")
    step = jax.jit(lambda last: continued(world, TRUE, one, last, jax.random.key(1)))
    for k in (7, 8, 9):
        after = step(replace(state, step=jnp.asarray(k)))
        begins = k >= 8
        np.testing.assert_array_equal(after.key_data, jax.random.key_data(jax.random.key(int(begins))))
        assert int(after.ends) == (10 if begins else 8)
        assert int(after.state.step) == (0 if begins else k)
        np.testing.assert_allclose(after.state.pose, fresh.pose if begins else state.pose)
        np.testing.assert_allclose(after.state.mean, fresh.mean if begins else first.mean)


def test_first_episodes_end_at_different_times():
    problem, scenes = CROWD.problem(), CROWD.scenes
    world = World(problem=problem, scenes=scenes, objective="terminal")
    assert begin_ongoing(world, replace(WINDOWS, window=10), jax.random.key(0)) is None
    ongoing = begin_ongoing(world, WINDOWS, jax.random.key(0))
    assert ongoing is not None
    np.testing.assert_array_equal(ongoing.ends, [4, 8, 10, 4, 8, 10, 4, 8])
    assert len(np.unique(np.asarray(ongoing.state.pose), axis=0)) == 8
    again = training_episode(problem, scenes, jax.tree.map(lambda x: x[3], ongoing).key, noise=True)
    np.testing.assert_allclose(ongoing.state.pose[3], again.pose, err_msg="the key is that of the episode")
    np.testing.assert_array_equal(ongoing.state.step, 0)
