"""The actor-critic against textbook formulas and a problem of known value; it learns."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from foveate.experiment.checkpoint import load_run
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings
from foveate.learning import actor_critic
from foveate.learning.actor_critic import Samples, advantages, entropy, gather, log_density, loss, sample_trajectory
from foveate.learning.loop import train
from foveate.learning.validation import held_out_episodes, validate
from foveate.policies.attention import AttentionSettings
from foveate.policies.pointer import Modes, PointerSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import PROTOCOLS
from foveate.simulation.rollout import rollout

NETWORK = PointerSettings(
    kind="pointer", target_widths=(16, 16), heads=2, context_widths=(16,), mode_widths=(16,), modes=1
)
TINY = Experiment(
    scenario=Scenario(
        scenes=SceneSettings(targets_min=1, targets_max=2, steps=5, half_side_per_target_m=1.5, drift_m_s=(0.1, 0.1))
    ),
    policy=NETWORK,
    training=ActorCriticSettings(
        algorithm="actor-critic", epochs=40, episodes=64, minibatches=2, held_out=64, check_every=10, learning_rate=3e-3
    ),
)


def settings() -> ActorCriticSettings:
    assert isinstance(TINY.training, ActorCriticSettings)
    return TINY.training


def test_density_is_that_of_a_mixture_of_gaussians():
    rng = np.random.default_rng(0)
    weight, means, action_std = rng.normal(size=4), rng.uniform(-1, 1, (4, 2)), 0.3
    modes = Modes(jnp.asarray(weight), jnp.asarray(means))
    share = np.exp(weight) / np.exp(weight).sum()
    for action in rng.normal(size=(5, 2)):
        density = sum(
            p * multivariate_normal(m, action_std**2 * np.eye(2)).pdf(action) for p, m in zip(share, means, strict=True)
        )
        expected = np.log(density * 2 * np.pi * action_std**2)
        np.testing.assert_allclose(
            log_density(modes, jnp.asarray(action), jnp.asarray(action_std)), expected, rtol=1e-10
        )
    np.testing.assert_allclose(entropy(modes), -np.sum(share * np.log(share)), rtol=1e-12)


def test_modes_of_padding_change_neither_density_nor_entropy_nor_their_slopes():
    few = Modes(jnp.array([0.3, -0.2]), jnp.array([[0.1, 0.4], [-0.6, 0.2]]))
    padded = Modes(jnp.array([0.3, -1e9, -0.2]), jnp.array([[0.1, 0.4], [0.9, 0.9], [-0.6, 0.2]]))

    def worth(modes):
        return log_density(modes, jnp.array([0.2, 0.3]), jnp.asarray(0.4)) + entropy(modes)

    np.testing.assert_allclose(worth(padded), worth(few), rtol=1e-12)
    slope, expected = jax.grad(worth)(padded), jax.grad(worth)(few)
    np.testing.assert_allclose(slope.log_weight[jnp.array([0, 2])], expected.log_weight, rtol=1e-12)
    np.testing.assert_allclose(slope.action[jnp.array([0, 2])], expected.action, rtol=1e-12)
    assert slope.log_weight[1] == 0
    assert np.all(slope.action[1] == 0)


@pytest.mark.parametrize("gae_lambda", [0.0, 0.7, 1.0])
def test_advantages_are_sums_of_temporal_differences(gae_lambda):
    """Schulman 2016, equation 16, with no discount, written as the double sum; nothing after the horizon."""
    rng, horizon = np.random.default_rng(1), 4
    reward, value = rng.normal(size=7), rng.normal(size=7)
    counts = np.arange(7) < horizon
    after = np.append(value[1:horizon], 0.0)
    delta = reward[:horizon] + after - value[:horizon]
    expected = [sum(gae_lambda ** (k - i) * delta[k] for k in range(i, horizon)) for i in range(horizon)]
    found = advantages(jnp.asarray(reward), jnp.asarray(value), jnp.asarray(counts), gae_lambda)
    np.testing.assert_allclose(found[:horizon], expected, rtol=1e-10)
    np.testing.assert_array_equal(found[horizon:], 0)


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["surrogate", "true"])
def test_the_return_equals_the_score_of_the_rollout(protocol):
    """With hardly any noise a try is the rollout of the policy, when all modes but one are out of reach."""
    problem, scenes = TINY.scenario.problem(), TINY.scenario.scenes
    policy = NETWORK.policy(problem, jax.random.key(4))
    policy = eqx.tree_at(lambda p: p.idle_layers[0].bias, policy, policy.idle_layers[0].bias.at[0].set(1e3))

    @eqx.filter_jit
    def both(key, objective):
        episode = training_episode(problem, scenes, key, noise=True)
        trajectory = sample_trajectory(problem, policy, episode, PROTOCOLS[protocol], objective, jnp.asarray(1e-9), key)
        return episode, trajectory, rollout(problem, policy, episode, PROTOCOLS[protocol], key)

    for seed in range(3):
        for objective in ("terminal", "mean", "seen"):
            episode, trajectory, trace = both(jax.random.key(seed), objective)
            n, K = int(np.sum(episode.present)), int(episode.horizon)
            log_det = np.asarray(trace.log_det)[:K, :n].mean(axis=1)
            prior = np.linalg.slogdet(np.asarray(problem.prior_information))[1]
            expected = {
                "terminal": log_det[-1] - prior,
                "mean": log_det.mean(),
                "seen": np.asarray(trace.visible)[:K, :n].mean(),
            }
            np.testing.assert_allclose(np.sum(trajectory.reward), expected[objective], atol=1e-6)
            np.testing.assert_allclose(trajectory.action[:K], trace.action[:K], atol=1e-6)


@pytest.mark.slow
def test_loss_is_ppo_s_clipped_one():
    problem = TINY.scenario.problem()
    learner = actor_critic.begin(problem, NETWORK.policy(problem, jax.random.key(0)), settings(), jax.random.key(1))
    episode = training_episode(problem, TINY.scenario.scenes, jax.random.key(2), noise=True)
    action_std, rng = jnp.asarray(0.3), np.random.default_rng(3)
    policy, critic = learner.policy, learner.critic
    trajectory = eqx.filter_jit(sample_trajectory)(
        problem, policy, episode, PROTOCOLS["true"], "terminal", action_std, jax.random.key(5)
    )
    rows = len(trajectory.reward)
    old = np.asarray(trajectory.log_density) + rng.normal(0, 0.4, rows)  # as if the policy had moved on since
    advantage, returns, counts = rng.normal(size=rows), rng.normal(size=rows), np.arange(rows) % 3 > 0
    batch = Samples(trajectory.observation, trajectory.action, *map(jnp.asarray, (old, advantage, returns, counts)))
    value, modes = (jax.jit(jax.vmap(f))(trajectory.observation) for f in (critic, policy.modes))
    total = 0.0
    for i in np.flatnonzero(counts):
        ratio = np.exp(float(trajectory.log_density[i]) - old[i])
        gain = min(ratio * advantage[i], float(np.clip(ratio, 0.8, 1.2)) * advantage[i])
        choice = float(entropy(jax.tree.map(lambda x, i=i: x[i], modes)))
        total += (float(value[i]) - returns[i]) ** 2 - gain - settings().entropy_weight * choice
    found = eqx.filter_jit(loss)(policy, critic, batch, action_std, settings())
    np.testing.assert_allclose(found, total / counts.sum(), rtol=1e-9)


MIXED = replace(TINY.scenario.scenes, steps=None)
"""Episodes of three and of six steps in one batch."""


@pytest.mark.slow
def test_a_batch_mixes_both_protocols_and_masks_steps_after_the_end():
    """Mean return, counted steps and scale of advantages, from the trajectories one by one."""
    problem = TINY.scenario.problem()
    chosen = replace(settings(), protocols=("surrogate", "true"), episodes=12)
    learner = actor_critic.begin(problem, NETWORK.policy(problem, jax.random.key(0)), chosen, jax.random.key(1))
    action_std, key = jnp.asarray(0.3), jax.random.key(6)
    samples, returns = eqx.filter_jit(gather)(problem, MIXED, chosen, learner, action_std, key)
    prior = np.linalg.slogdet(np.asarray(problem.prior_information))[1]

    def one(scene_key, trajectory_key, name):
        episode = training_episode(problem, MIXED, scene_key, noise=True)
        return sample_trajectory(
            problem, learner.policy, episode, PROTOCOLS[name], "terminal", action_std, trajectory_key
        )

    each, advantage, counts = [], [], []
    for i, name in enumerate(chosen.protocols):
        scene_keys, trajectory_keys = (jax.random.split(k, 6) for k in jax.random.split(jax.random.fold_in(key, i)))
        trajectory = jax.jit(jax.vmap(partial(one, name=name)))(scene_keys, trajectory_keys)
        value = jax.jit(jax.vmap(jax.vmap(learner.critic)))(trajectory.observation)
        each += list(np.sum(trajectory.reward, axis=1))
        counts.append(np.asarray(trajectory.counts))
        of_all = jax.jit(jax.vmap(partial(advantages, gae_lambda=chosen.gae_lambda)))
        advantage.append(of_all(trajectory.reward, value, trajectory.counts))
    counts, advantage = np.concatenate(counts), np.concatenate(advantage)
    assert set(counts.sum(axis=1)) == {3, 6}
    np.testing.assert_allclose(returns, prior + np.mean(each), rtol=1e-9)
    np.testing.assert_array_equal(samples.counts.reshape(counts.shape), counts)
    real = advantage[counts]
    np.testing.assert_allclose(samples.advantage[counts.ravel()], (real - real.mean()) / real.std(), atol=1e-6)
    densities = [np.asarray(samples.log_density.reshape(counts.shape)[rows]) for rows in (slice(0, 6), slice(6, 12))]
    assert not np.allclose(*densities), "the halves are of different episodes"


@pytest.mark.slow
def test_learns(tmp_path):
    """Resuming as if undisturbed is tested in test_killed.py."""
    checks = []
    outcome = train(TINY, tmp_path / "a", seed=3, on_validation=lambda check, total: checks.append(check))
    assert outcome.epochs == 40
    assert checks[-1].held_out > checks[0].held_out + 0.3, "a tiny problem must be learned"
    assert abs(checks[-1].objective - checks[-1].held_out) < 1.5, "both are scores"
    experiment, policy, _ = load_run(tmp_path / "a")
    problem, keys = TINY.scenario.problem(), jax.random.split(jax.random.key(3), 4)
    episodes = held_out_episodes(TINY, problem, keys[1])
    score, _ = eqx.filter_jit(lambda policy: validate(TINY, problem, policy, episodes, keys[3]))(policy)
    assert experiment == TINY
    np.testing.assert_allclose(float(score), outcome.best_score, rtol=1e-5)


def test_wrong_settings(tmp_path):
    for change, message in (
        ({"protocols": ()}, "at least one"),
        ({"protocols": ("true", "true")}, "each once"),
        ({"protocols": ("true", "surrogate"), "episodes": 7}, "multiple"),
        ({"action_std": (0.3, 0.0)}, "action_std"),
        ({"gae_lambda": 1.5}, "gae_lambda"),
        ({"minibatches": 0}, "minibatches"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(settings(), **change)
    with pytest.raises(ValueError, match=r"expected policy\.kind = 'pointer'"):
        train(replace(TINY, policy=AttentionSettings()), tmp_path / "c")
    assert not (tmp_path / "c").exists(), "nothing is written for what cannot be trained"
