"""The actor-critic against textbook formulas; it learns, by whole episodes and by windows, and resumes exactly."""

import functools
import json
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.errors import InputError
from foveate.experiment.checkpoint import load_run
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings
from foveate.experiment.run_folder import BEST, LAST, METRICS
from foveate.learning import actor_critic
from foveate.learning import loop as training
from foveate.learning.actor_critic import entropy, gather, loss, score_of
from foveate.learning.critic import Critic, Samples, judge, moments, rescaled, samples_of
from foveate.learning.learner import EpochReport
from foveate.learning.loop import advance_of, train
from foveate.learning.trajectories import advantages, log_density, play, rewards
from foveate.learning.validation import held_out_episodes, validate
from foveate.learning.worlds import World, worlds_of
from foveate.policies.attention import AttentionSettings
from foveate.policies.pointer import Modes
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import PROTOCOLS
from foveate.simulation.rollout import rollout
from foveate.simulation.step import start

NETWORK = PointerSettings(kind="pointer", target_widths=(16, 16), heads=2, context_widths=(16,), mode_width=16, modes=1)
TINY = Experiment(
    scenario=Scenario(
        scenes=SceneSettings(targets_min=1, targets_max=2, steps=5, half_side_per_target_m=1.5, drift_m_s=(0.1, 0.1))
    ),
    policy=NETWORK,
    training=ActorCriticSettings(
        algorithm="actor-critic", epochs=30, episodes=64, minibatches=2, held_out=64, check_every=10, learning_rate=3e-3
    ),
)
LONG = replace(
    TINY,
    scenario=replace(TINY.scenario, scenes=replace(TINY.scenario.scenes, steps=20)),
    training=replace(TINY.training, window=7, objective="seen", held_out=32),
)
"""Episodes of three windows."""
advancing = functools.cache(advance_of)
"""Tests of the same experiment share its compiled training."""


def settings(experiment: Experiment = TINY) -> ActorCriticSettings:
    assert isinstance(experiment.training, ActorCriticSettings)
    return experiment.training


def begun(experiment, policy=None):
    policy = experiment.new_policy(jax.random.key(0)) if policy is None else policy
    return actor_critic.begin(worlds_of(experiment), policy, settings(experiment), jax.random.key(1))


def test_entropy_is_that_of_the_choice_among_modes():
    weight = np.random.default_rng(0).normal(size=4)
    share = np.exp(weight) / np.exp(weight).sum()
    found = entropy(Modes(jnp.asarray(weight), jnp.zeros((4, 2))))
    np.testing.assert_allclose(found, -np.sum(share * np.log(share)), rtol=1e-12)


def test_modes_of_padding_change_neither_density_nor_entropy_nor_their_slopes():
    few = Modes(jnp.array([0.3, -0.2]), jnp.array([[0.1, 0.4], [-0.6, 0.2]]))
    padded = Modes(jnp.array([0.3, -1e9, -0.2]), jnp.array([[0.1, 0.4], [0.9, 0.9], [-0.6, 0.2]]))

    def worth(modes):
        return log_density(modes, jnp.array([0.2, 0.3]), jnp.array([0.4, 0.2])) + entropy(modes)

    np.testing.assert_allclose(*(jax.jit(worth)(modes) for modes in (padded, few)), rtol=1e-12)
    slope, expected = (jax.jit(jax.grad(worth))(modes) for modes in (padded, few))
    np.testing.assert_allclose(slope.log_weight[jnp.array([0, 2])], expected.log_weight, rtol=1e-12)
    np.testing.assert_allclose(slope.action[jnp.array([0, 2])], expected.action, rtol=1e-12)
    assert slope.log_weight[1] == 0
    assert np.all(slope.action[1] == 0)


@pytest.mark.slow
@pytest.mark.parametrize(("protocol", "objectives"), [("surrogate", ["terminal"]), ("true", ["mean", "seen"])])
def test_the_return_equals_the_score_of_the_rollout(protocol, objectives):
    """With hardly any noise a try is the rollout of the policy, when all modes but one are out of reach."""
    problem, scenes = TINY.scenario.problem(), TINY.scenario.scenes
    policy = TINY.new_policy(jax.random.key(4))
    policy = eqx.tree_at(lambda p: p.idle_layer.bias, policy, policy.idle_layer.bias.at[0].set(1e3))

    @eqx.filter_jit
    def both(key):
        episode = training_episode(problem, scenes, key, noise=True)
        state, std = start(problem, episode, PROTOCOLS[protocol]), jnp.asarray(1e-9)
        how = (problem, policy, episode, PROTOCOLS[protocol])
        tries = [play(*how, name, std, key, state, episode.horizon, False, True)[0] for name in objectives]
        return episode, tries, rollout(*how, key)

    for seed in range(3):
        episode, tries, trace = both(jax.random.key(seed))
        n, K = int(np.sum(episode.present)), int(episode.horizon)
        log_det = np.asarray(trace.log_det)[:K, :n].mean(axis=1)
        prior = np.linalg.slogdet(np.asarray(problem.prior_information))[1]
        seen = np.asarray(trace.visible)[:K, :n].mean()
        expected = {"terminal": log_det[-1] - prior, "mean": log_det.mean(), "seen": seen}
        for trajectory, name in zip(tries, objectives, strict=True):
            value = expected[name]
            np.testing.assert_allclose(np.sum(trajectory.reward), value, atol=1e-6)
            driven = np.clip(trajectory.action[:K, [0, 2]], -1, 1)
            np.testing.assert_allclose(driven, trace.action[:K], atol=1e-6)
            world = World(problem=problem, scenes=scenes, objective=name)
            score = score_of(world, settings(), jax.tree.map(lambda x: x[None], trajectory))
            np.testing.assert_allclose(score, value + (prior if name == "terminal" else 0.0), atol=1e-6)


@pytest.mark.parametrize("objective", ["mean", "seen"])
def test_undiscounted_rewards_of_windows_are_the_scores_of_their_steps(objective):
    rng = np.random.default_rng(2)
    problem, scenes = TINY.scenario.problem(), TINY.scenario.scenes
    episode = eqx.filter_jit(training_episode)(problem, scenes, jax.random.key(2), noise=True)
    n, K = len(episode.present), len(episode.inputs)
    log_det, visible = rng.normal(size=(K, n)), rng.random((K, n)) < 0.5
    parts = (jnp.asarray(log_det), jnp.asarray(visible), jnp.zeros(()), episode, objective, False)
    steps, shares = (eqx.filter_jit(rewards)(*parts, shared) for shared in (False, True))
    present, horizon = np.asarray(episode.present), int(episode.horizon)
    expected = (log_det if objective == "mean" else visible)[:horizon, present].mean(axis=1)
    np.testing.assert_allclose(steps[:horizon], expected, rtol=1e-12)
    np.testing.assert_allclose(np.sum(shares[:horizon]), expected.mean(), rtol=1e-12)


def test_fewer_decisions_than_minibatches_are_refused():
    """They would leave every minibatch empty: a training that learns nothing."""
    one_step = replace(TINY, scenario=replace(TINY.scenario, scenes=replace(TINY.scenario.scenes, steps=1)))
    with pytest.raises(InputError, match=r"training.episodes = 8: expected episodes of 16 decisions in all"):
        begun(replace(one_step, training=replace(TINY.training, episodes=8, minibatches=8)))


@pytest.mark.slow
def test_loss_is_ppo_s_clipped_one():
    problem, learner = TINY.scenario.problem(), begun(TINY)
    policy, critic = learner.policy, replace(learner.critic, mean=jnp.array([2.0]), std=jnp.array([3.0]))
    action_std, rng = jnp.asarray(0.3), np.random.default_rng(3)

    @eqx.filter_jit
    def played(key):
        episode = training_episode(problem, TINY.scenario.scenes, key, noise=True)
        state = start(problem, episode, PROTOCOLS["true"])
        how = (PROTOCOLS["true"], "terminal", action_std, key, state, episode.horizon, False, True)
        return play(problem, policy, episode, *how)[0]

    trajectory = played(jax.random.key(5))
    tokens = jax.tree.map(lambda x: x[:-1], trajectory.tokens)
    rows = len(trajectory.reward)
    old = np.asarray(trajectory.log_density) + rng.normal(0, 0.4, rows)  # as if the policy had moved on since
    advantage, returns, counts = rng.normal(size=rows), rng.normal(size=rows), np.arange(rows) % 3 > 0
    batch = Samples(tokens, trajectory.action, *map(jnp.asarray, (old, advantage, returns, counts)))
    value, modes = (jax.jit(jax.vmap(f))(tokens) for f in (critic, policy.modes))
    total = 0.0
    for i in np.flatnonzero(counts):
        ratio = np.exp(float(trajectory.log_density[i]) - old[i])
        gain = min(ratio * advantage[i], float(np.clip(ratio, 0.8, 1.2)) * advantage[i])
        choice = float(entropy(jax.tree.map(lambda x, i=i: x[i], modes)))
        error = (float(value[i]) - 2.0) / 3.0 - returns[i]
        total += 0.5 * error**2 - gain - settings().entropy_weight * choice
    found = eqx.filter_jit(loss)(policy, critic, batch, action_std, settings())
    np.testing.assert_allclose(found, total / counts.sum(), rtol=1e-9)


MIXED = replace(TINY.scenario.scenes, steps=None)
"""Episodes of three and of six steps in one batch."""


@pytest.mark.slow
def test_a_batch_mixes_both_protocols_and_masks_steps_after_the_end():
    """Trajectories, counted steps, and the scale of advantages and returns, from the trajectories one by one."""
    chosen = replace(settings(), protocols=("surrogate", "true"), episodes=12)
    experiment = replace(TINY, scenario=replace(TINY.scenario, scenes=MIXED), training=chosen)
    (world,), problem, learner = worlds_of(experiment), experiment.scenario.problem(), begun(experiment)
    critic = replace(learner.critic, mean=jnp.array([1.0]), std=jnp.array([2.0]))
    action_std, keys = jnp.asarray(0.3), jax.random.split(jax.random.key(6), 12)

    @eqx.filter_jit
    def batch(keys):
        trajectory, ongoing = gather(world, chosen, learner.policy, action_std, keys, None)
        assert ongoing is None
        judged = judge(critic, trajectory, chosen, 1.0)
        return trajectory, judged, moments(judged), score_of(world, chosen, trajectory)

    @eqx.filter_jit
    def alone(key):
        scene_key, action_key = jax.random.split(key)
        episode = training_episode(problem, MIXED, scene_key, noise=True)
        tries = []
        for name in chosen.protocols:
            state = start(problem, episode, PROTOCOLS[name])
            how = (PROTOCOLS[name], "terminal", action_std, action_key, state, episode.horizon, False, True)
            tries.append(play(problem, learner.policy, episode, *how)[0])
        return tries, [jax.vmap(critic)(one.tokens) for one in tries]

    trajectory, judged, sums, score = batch(keys)
    each, expected_advantage, expected_return = [], [], []
    for i, key in enumerate(keys):
        tries, values = alone(key)
        one, value = tries[i >= 6], values[i >= 6]
        for name in ("action", "log_density", "reward", "counts", "ends"):
            np.testing.assert_allclose(getattr(trajectory, name)[i], getattr(one, name), atol=1e-9, err_msg=name)
        advantage = np.asarray(advantages(one, value, 1.0, chosen.gae_lambda))[np.asarray(one.counts)]
        expected_advantage.append(advantage)
        expected_return.append(advantage + np.asarray(value)[:-1][np.asarray(one.counts)])
        each.append(np.sum(one.reward))
    counts = np.asarray(trajectory.counts)
    assert set(counts.sum(axis=1)) == {3, 6}
    prior = np.linalg.slogdet(np.asarray(problem.prior_information))[1]
    np.testing.assert_allclose(score, prior + np.mean(each), rtol=1e-9)
    for row, parts in zip(np.asarray(sums), (expected_advantage, expected_return), strict=True):
        numbers = np.concatenate(parts)
        np.testing.assert_allclose(row, [len(numbers), numbers.sum(), (numbers**2).sum()], rtol=1e-9)
    real, returns = np.concatenate(expected_advantage), np.concatenate(expected_return)
    samples = samples_of(judged, critic, jnp.asarray(real.mean()), jnp.asarray(real.std()))
    np.testing.assert_array_equal(samples.counts, counts.ravel())
    np.testing.assert_allclose(samples.advantage[counts.ravel()], (real - real.mean()) / real.std(), atol=1e-6)
    np.testing.assert_allclose(samples.value_target[counts.ravel()], (returns - 1.0) / 2.0, atol=1e-9)


def test_the_critic_is_on_a_running_scale_of_its_returns():
    critic = begun(TINY).critic
    assert isinstance(critic, Critic)
    first = rescaled(critic, jnp.array([5.0]), jnp.array([2.0]))
    np.testing.assert_allclose([first.mean, first.std], [[5.0], [2.0]], rtol=1e-5)
    second = rescaled(first, jnp.array([7.0]), jnp.array([4.0]))
    np.testing.assert_allclose([second.mean, second.std], [[5.1], [2.1]], rtol=1e-5)


def distracted(experiment):
    """A policy that idles nine times of ten: there is something to learn, where a heuristic does well already."""
    policy = experiment.new_policy(jax.random.key(0))
    return eqx.tree_at(lambda p: p.idle_layer.bias, policy, policy.idle_layer.bias.at[0].set(6.5))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["whole episodes", pytest.param("windows", marks=pytest.mark.exhaustive)])
def test_learns(name):
    """By windows, too, which the next test trains and resumes."""
    experiment = {"whole episodes": TINY, "windows": LONG}[name]
    key = jax.random.key(2)
    learner = begun(experiment, distracted(experiment))
    assert (learner.ongoing == (None,)) == (name == "whole episodes")
    episodes = held_out_episodes(experiment, jax.random.key(3))
    score = eqx.filter_jit(lambda policy: validate(experiment, policy, episodes, key)[0])
    before, advance = float(score(learner.policy)), advancing(experiment)
    with jax.default_matmul_precision("highest"):  # as `train` does, so that both run the same compiled program
        learner, report = advance(jnp.array(30), learner, key)
    assert bool(report.finite)
    assert int(learner.epoch) == 30
    after = float(score(learner.policy))
    assert after > before + (0.5 if name == "whole episodes" else 0.1), "a tiny problem must be learned"


class Interrupted(Exception):
    pass


def stop(check, total):
    raise Interrupted


def arrays(path):
    with np.load(path) as found:
        return {name: found[name].tobytes() for name in found.files if name != "header"}


@pytest.mark.slow
def test_a_training_by_windows_resumes_as_if_undisturbed(monkeypatch, tmp_path):
    """Also: it is not worse than its untrained policy, and the file holds the policy of its score."""
    monkeypatch.setattr(training, "advance_of", advancing)
    outcome = train(LONG, tmp_path / "a", seed=3)
    lines = [json.loads(line) for line in (tmp_path / "a" / METRICS).read_text().splitlines()]
    assert [line["epoch"] for line in lines] == [0, 10, 20, 30]
    assert outcome.best_score == max(line["held_out"] for line in lines) >= lines[0]["held_out"]
    assert lines[-1]["env_steps"] == 30 * 64 * 7
    assert lines[0]["objective"] is None
    with pytest.raises(Interrupted):
        train(LONG, tmp_path / "b", seed=3, on_validation=stop)
    assert any(".ongoing." in name for name in arrays(tmp_path / "b" / LAST))
    assert train(LONG, tmp_path / "b", seed=3, resume=True) == outcome
    for path in (BEST, LAST):
        assert arrays(tmp_path / "a" / path) == arrays(tmp_path / "b" / path)
    experiment, policy, _ = load_run(tmp_path / "a")
    keys = jax.random.split(jax.random.key(3), 4)
    episodes = held_out_episodes(LONG, keys[1])
    score, _ = eqx.filter_jit(lambda policy: validate(LONG, policy, episodes, keys[3]))(policy)
    assert experiment == LONG
    np.testing.assert_allclose(float(score), outcome.best_score, rtol=1e-9)


def test_a_training_never_ends_below_its_untrained_policy(monkeypatch, tmp_path):
    """Without learning and validation: the best preference begins, and is kept where all that follows is worse."""
    scores = iter([1.0, 3.0, 2.0, 0.0, 0.0, 0.0, 3.0, 2.5, 2.9, 2.0])  # of six preferences, untrained, three checks

    def advance(count, learner, key):
        worse = jax.tree.map(lambda x: x + 1.0 if eqx.is_inexact_array(x) else x, learner.policy)
        learner = eqx.tree_at(lambda x: (x.policy, x.epoch), learner, (worse, learner.epoch + count))
        return learner, EpochReport(jnp.array(1.0), jnp.array(1.0), jnp.array(True))

    monkeypatch.setattr(training, "compiled", lambda simulate, quick: simulate)
    monkeypatch.setattr(training, "held_out_episodes", lambda experiment, key: None)
    monkeypatch.setattr(training, "advance_of", lambda experiment: advance)
    monkeypatch.setattr(training, "validate", lambda *args: (jnp.array(next(scores)), jnp.array(0.0)))
    outcome = train(TINY, tmp_path / "a", seed=3)
    assert (outcome.best_epoch, outcome.best_score, outcome.epochs) == (0, 3.0, 30)
    np.testing.assert_allclose(load_run(tmp_path / "a")[1].preference, (1.0, 0.0))


def test_sizes_of_an_iteration():
    scenes = SceneSettings(targets_min=3, targets_max=8)  # 9 to 24 steps
    chosen = ActorCriticSettings(algorithm="actor-critic")
    assert chosen.trajectories(scenes) == 248  # 4096 / 16.5, in two shards
    assert chosen.decisions(scenes) == 4092
    assert chosen.discount_of(scenes) == 1.0
    assert replace(chosen, discount=0.9).discount_of(scenes) == 0.9
    long = SceneSettings(steps=100)
    assert chosen.trajectories(long) == 82  # two windows of 50
    assert chosen.decisions(long) == 4100
    assert chosen.discount_of(long) == 0.98
    both = replace(chosen, protocols=("true", "surrogate"), episodes=10)
    assert both.trajectories(scenes) == 12, "each shard has as many of each"


def test_wrong_settings(tmp_path):
    for change, message in (
        ({"protocols": ()}, "at least one"),
        ({"protocols": ("true", "true")}, "each once"),
        ({"protocols": ("true", "surrogate"), "episodes": 7}, "multiple"),
        ({"action_std": (0.3, 0.0)}, "action_std"),
        ({"gae_lambda": 1.5}, "gae_lambda"),
        ({"discount": 0.0}, r"discount = 0\.0: expected > 0"),
        ({"discount": 1.1}, r"discount = 1\.1"),
        ({"window": 0}, "window = 0"),
        ({"minibatches": 0}, "minibatches"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(settings(), **change)
    with pytest.raises(ValueError, match=r"expected policy\.kind = 'pointer'"):
        train(replace(TINY, policy=AttentionSettings()), tmp_path / "c")
    assert not (tmp_path / "c").exists(), "nothing is written for what cannot be trained"
