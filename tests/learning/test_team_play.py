"""Trajectories of a team: the reward is the team's, windows continue each other, and the critic sees all robots."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.rejections import assert_rejected
from helpers.worlds_of_detections import HALL

from foveate.experiment.checkpoint import load_run
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings, TrainingSettings
from foveate.learning.loop import train
from foveate.learning.team_play import own_rewards, play_team
from foveate.learning.trajectories import log_density
from foveate.learning.windows import cut
from foveate.learning.worlds import worlds_of
from foveate.policies.attention import AttentionSettings
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.agent import DifferentialDrive
from foveate.scenario.field_of_view import TriangleView
from foveate.scenario.kinds import RobotSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.team import RadioSettings, TeamSettings
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import TRUE
from foveate.simulation.rollout import rollout
from foveate.simulation.team.step import start

M, N, K = 2, 2, 6
FAST = RobotSettings(agent=DifferentialDrive(v_max_m_s=9.0), view=TriangleView(depth_m=1.0))
EXPERIMENT = Experiment(
    scenario=Scenario(
        scenes=SceneSettings(targets_min=N, targets_max=N, steps=K, half_side_per_target_m=1.5, drift_m_s=(0.1, 0.1)),
        team=TeamSettings(agents=M, radio=RadioSettings(loss=0.5, delay_steps=1, memory_steps=2)),
    ),
    policy=PointerSettings(
        kind="pointer", target_widths=(8, 8), heads=1, context_widths=(8,), mode_width=8, modes=1
    ),
    training=ActorCriticSettings(
        algorithm="actor-critic", epochs=1, episodes=4, minibatches=2, held_out=4, check_every=1, window=3
    ),
)  # fmt: skip


@pytest.fixture(scope="module")
def played():
    """An episode, played whole and in two windows, and rolled out by the deterministic policy."""
    (world,) = worlds_of(EXPERIMENT)
    policy = EXPERIMENT.new_policy(jax.random.key(4))
    policy = eqx.tree_at(lambda p: p.idle_layer.bias, policy, policy.idle_layer.bias.at[0].set(-1e3))
    # The log weights of a hundred heuristics: the likeliest mode is the only one.
    policy = replace(policy, preference=100.0 * policy.preference)

    @jax.jit
    def run(key):
        problem, episode = world.drawn(key)
        std = jnp.asarray(1e-9)
        how = (TRUE, "terminal", std, key)
        state = start(problem, episode, TRUE)
        whole = play_team(problem, policy, episode, *how, state, episode.horizon, False, True)[0]
        first, middle = play_team(
            problem, policy, cut(episode, jnp.array(0), 3), *how, state, episode.horizon, False, False
        )
        second = play_team(problem, policy, cut(episode, jnp.array(3), 3), *how, middle, episode.horizon, False, False)[
            0
        ]
        return whole, (first, second), rollout(problem, policy, episode, TRUE, key)

    whole, windows, trace = jax.tree.map(np.asarray, run(jax.random.key(2)))
    return world.problem, policy, whole, windows, trace


def test_every_robot_has_the_teams_reward(played):
    problem, _, whole, _, trace = played
    prior = np.linalg.slogdet(problem.prior_information)[1]
    expected = np.diff(trace.log_det.mean(axis=1), prepend=prior)
    np.testing.assert_allclose(whole.reward, np.repeat(expected[None], M, axis=0), atol=1e-6)
    assert whole.ends.tolist() == [[False] * (K - 1) + [True]] * M


def test_windows_continue_each_other(played):
    _, _, whole, (first, second), _ = played
    for part in ("action", "reward", "log_density"):
        joined = np.concatenate([getattr(first, part), getattr(second, part)], axis=1)
        np.testing.assert_allclose(joined, getattr(whole, part), atol=1e-9)


def test_the_critic_sees_the_tokens_of_all_robots(played):
    _, policy, whole, _, _ = played
    for m in range(M):
        own = whole.tokens.features[m]
        np.testing.assert_array_equal(whole.seen.features[1 - m][:, m * N : (m + 1) * N], own)
        modes = policy.modes(jax.tree.map(lambda x, m=m: jnp.asarray(x[m, 2]), whole.tokens))
        std = 1e-9 * jnp.asarray(whole.tokens.unit[m, 2])
        found = log_density(modes, jnp.asarray(whole.action[m, 2]), std)
        np.testing.assert_allclose(found, whole.log_density[m, 2], atol=1e-3)


@pytest.mark.slow
def test_the_reward_of_a_team_without_ids_is_the_gospa_that_its_filter_expects():
    scenario = replace(HALL, scenes=replace(HALL.scenes, steps=3), team=TeamSettings(agents=M))
    experiment = replace(EXPERIMENT, scenario=scenario, training=replace(EXPERIMENT.training, objective="gospa"))
    policy = experiment.new_policy(jax.random.key(4))
    policy = replace(policy, preference=100.0 * policy.preference)
    policy = eqx.tree_at(lambda p: p.idle_layer.bias, policy, policy.idle_layer.bias.at[0].set(-1e3))

    @jax.jit
    def run(key):
        problem, episode = worlds_of(experiment)[0].drawn(key)
        how = (TRUE, "gospa", jnp.asarray(1e-9), key, start(problem, episode, TRUE), episode.horizon, False, True)
        return play_team(problem, policy, episode, *how)[0], rollout(problem, policy, episode, TRUE, key)

    played, trace = run(jax.random.key(2))
    np.testing.assert_allclose(played.reward, np.repeat(-trace.expected_gospa[None, 1:] / 3, M, axis=0), atol=1e-6)


@pytest.mark.parametrize(
    ("objective", "discounted", "whole"),
    [("terminal", False, True), ("mean", False, True), ("mean", True, False), ("seen", False, True)],
)
def test_a_robot_with_assigned_targets_has_the_reward_of_its_own(objective, discounted, whole):
    """From the log det and the measurements of a rollout, target by target."""
    experiment = replace(EXPERIMENT, policy=replace(EXPERIMENT.policy, assignment="auction"))
    scenes = replace(experiment.scenario.scenes, targets_min=3, targets_max=3)
    experiment = replace(experiment, scenario=replace(experiment.scenario, scenes=scenes))
    policy = experiment.new_policy(jax.random.key(4))
    policy = eqx.tree_at(lambda p: p.idle_layer.bias, policy, policy.idle_layer.bias.at[0].set(-1e3))
    policy = replace(policy, preference=100.0 * policy.preference)
    (world,) = worlds_of(experiment)

    @jax.jit
    def run(key):
        problem, episode = world.drawn(key)
        how = (TRUE, objective, jnp.asarray(1e-9), key, start(problem, episode, TRUE), episode.horizon)
        played = play_team(problem, policy, episode, *how, discounted, whole)[0]
        return played, rollout(problem, policy, episode, TRUE, key)

    played, trace = jax.tree.map(np.asarray, run(jax.random.key(2)))
    prior = np.linalg.slogdet(world.problem.prior_information)[1]
    steps = len(trace.log_det)
    assert played.seen is None
    for k in range(steps):
        shown = played.tokens.present[:, k]
        assert shown.any(axis=1).all()
        for m in range(M):
            own = []
            for j in np.flatnonzero(shown[m]):
                now, before = trace.log_det[k, j], trace.log_det[k - 1, j] if k else prior
                own.append(trace.visible[k, j] if objective == "seen" else now - before)
            # Of a mean over the steps a growth counts in all that are left.
            share = {"terminal": 1.0, "seen": 1 / steps, "mean": 1.0 if discounted else (steps - k) / steps}
            expected = share[objective] * np.mean(own)
            assert played.reward[m, k] == pytest.approx(expected, abs=1e-6)


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.parametrize("robots", [None, (RobotSettings(), FAST)], ids=["alike", "different"])
def test_a_training_ends_with_a_policy_for_teams(robots, tmp_path):
    assert EXPERIMENT.scenario.team is not None
    scenario = replace(EXPERIMENT.scenario, team=replace(EXPERIMENT.scenario.team, robots=robots))
    outcome = train(replace(EXPERIMENT, scenario=scenario), tmp_path / "run")
    assert outcome.epochs == 1
    assert load_run(tmp_path / "run")[1].tells_team


@pytest.mark.parametrize("whole", [False, True])
def test_who_changes_targets_gains_nothing_by_it(whole):
    """Two robots with a target each, known well and badly, which they exchange; and one that is seen on the way."""
    log_det = jnp.array([[8.0, 0.0], [8.0, 0.0], [8.0, 1.0], [8.0, 1.0]])
    shown = jnp.array([[[True, False], [False, True]]] * 2 + [[[False, True], [True, False]]] * 2)
    left, nothing = jnp.array([4.0, 3.0, 2.0, 1.0]), jnp.zeros((4, 2), bool)
    how = (log_det, nothing, log_det[0], shown, left, jnp.asarray(4.0))
    found = own_rewards(*how, "mean", False, whole)
    np.testing.assert_allclose(found, np.array([[0.0, 0.0, 2.0, 0.0], [0.0] * 4]) / (4 if whole else 1))


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_training_with_assigned_targets_begins_with_a_single_robot(tmp_path):
    """It keeps the range of its features, which the training widens, and ends with a policy that assigns."""
    settings = replace(EXPERIMENT.policy, clips_features=True)
    single = replace(EXPERIMENT, scenario=replace(EXPERIMENT.scenario, team=None), policy=settings)
    train(single, tmp_path / "single")
    begins = replace(settings, assignment="hungarian", begin_with=str(tmp_path / "single"))
    train(replace(EXPERIMENT, policy=begins), tmp_path / "team")
    policy, before = load_run(tmp_path / "team")[1], load_run(tmp_path / "single")[1].feature_range
    assert policy.rule == "hungarian"
    assert (policy.feature_range[0] <= before[0] + 1e-6).all()
    assert (policy.feature_range[1] >= before[1] - 1e-6).all()
    assert (policy.feature_range != before).any()


def test_alone_a_policy_for_teams_has_no_memory_and_decides_as_without_mates():
    scenario = replace(EXPERIMENT.scenario, team=None)
    policy = EXPERIMENT.new_policy(jax.random.key(4))
    problem, key = scenario.problem(), jax.random.key(0)
    trace = rollout(problem, policy, training_episode(problem, scenario.scenes, key, noise=True), TRUE, key)
    assert np.isfinite(trace.action).all()
    assert trace.team is None


def test_the_gradient_of_a_soft_view_trains_no_team(tmp_path):
    single = replace(EXPERIMENT, policy=AttentionSettings(), training=TrainingSettings(epochs=1, episodes=2))
    assert_rejected(lambda: train(single, tmp_path / "run"), "scenario.team.agents = 2: expected 1, or training.algo")
