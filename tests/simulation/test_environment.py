"""The environment against `rollout`: the same step, the same scores, and new episodes in a batch."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.experiment.presets import QUADROTOR, TrainingSettings
from foveate.policies.attention import AttentionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import SensorSettings
from foveate.simulation import environment as under_test
from foveate.simulation.environment import Environment, begin, observation, renew, reset, step
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import SURROGATE, TRUE, Policy, Protocol
from foveate.simulation.rollout import rollout

SOFT = TrainingSettings(softness=((1.0, 0.4), (0.3, 0.25)), noise=True).protocol
PLANAR = Scenario(scenes=SceneSettings(targets_min=1, targets_max=3))
STREET = Scenario(
    scenes=SceneSettings(targets_min=1, targets_max=3, half_side_per_target_m=0.5, jitter_m_s=0.8, birth_and_death=True)
)
RANGING = Scenario(
    sensor=SensorSettings(measures="range-bearing", std_range_m=0.2, std_bearing_rad=0.05, range_growth_per_m=0.1),
    scenes=replace(PLANAR.scenes, initial_error="consistent"),
)
CASES = {
    "surrogate, no noise": (PLANAR, SURROGATE, False),
    "true": (PLANAR, TRUE, True),
    "two levels at the truth, targets that come and go": (STREET, SOFT, True),
    "true, ranges and bearings": (RANGING, TRUE, True),
    "true, in space": (QUADROTOR, TRUE, True),
}


fresh_episode = eqx.filter_jit(reset)


def environment_of(name: str) -> Environment:
    scenario, protocol, noise = CASES[name]
    return Environment(scenario.problem(), scenario.scenes, protocol, noise)


@eqx.filter_jit
def played(environment: Environment, key, policy: Policy):
    """One episode stepped with the policy's actions, and the same rolled out; what is after the horizon is padding."""
    episode = training_episode(environment.problem, environment.scenes, key, environment.noise)
    trace = rollout(environment.problem, policy, episode, environment.protocol, key)

    def one(moment, _):
        action, _ = policy(observation(environment, moment), (), key)
        moment, transition = step(environment, moment, action)
        return moment, (moment.predicted.pose, transition.reward, transition.done, transition.score)

    moment = begin(environment, episode, key)
    return episode.horizon, trace, moment.score, jax.lax.scan(one, moment, length=len(trace.action))[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_stepped_is_rolled_out(name: str):
    """`rollout` has textbook oracles of its own: what is stepped must be what it simulates."""
    environment = environment_of(name)
    policy = AttentionSettings().policy(environment.problem, jax.random.key(1))
    for seed in range(4):
        horizon, trace, first, stepped = played(environment, jax.random.key(seed), policy)
        poses, rewards, done, scores = (np.array(x)[:horizon] for x in stepped)
        np.testing.assert_allclose(poses, trace.pose[1 : horizon + 1], rtol=1e-9, atol=1e-9)
        assert done.tolist() == [False] * (int(horizon) - 1) + [True]
        assert float(rewards.sum()) == pytest.approx(float(scores[-1] - first), abs=1e-9)
        there = np.array(trace.present[1 : horizon + 1] & trace.present[:horizon])
        if environment.protocol != SOFT:  # the trace holds the log dets of the last level only
            expected = [
                np.mean(row[mask]) if mask.any() else 0.0
                for row, mask in zip(np.array(trace.log_det[:horizon]), there, strict=True)
            ]
            np.testing.assert_allclose(scores, expected, rtol=1e-9, atol=1e-9)


@eqx.filter_jit
def score_after_two(environment: Environment, key):
    moment = reset(environment, key)
    return jax.lax.fori_loop(0, 2, lambda _, m: step(environment, m, jnp.full(2, 0.3))[0], moment).score


@pytest.mark.slow
def test_scores_of_several_levels_are_their_mean():
    """Two soft levels, one by one and both: the score of both is the mean of their scores."""
    easy, hard = SURROGATE.levels[0], SOFT.levels[1]
    environments = [
        Environment(PLANAR.problem(), PLANAR.scenes, Protocol(levels), noise=False)
        for levels in ((easy,), (hard,), (easy, hard))
    ]
    last = [float(score_after_two(environment, jax.random.key(2))) for environment in environments]
    assert last[0] != pytest.approx(last[1], abs=1e-3)
    assert last[2] == pytest.approx((last[0] + last[1]) / 2, abs=1e-12)


@pytest.mark.slow
def test_a_first_score_is_that_of_the_prior():
    """Y_0 = 0.5 I in the plane: log det = 2 log 0.5, for any number of targets."""
    moment = fresh_episode(environment_of("surrogate, no noise"), jax.random.key(0))
    assert float(moment.score) == pytest.approx(2 * np.log(0.5), abs=1e-12)


@eqx.filter_jit
def batch(environment: Environment, keys, actions):
    def one(moments, now):
        moments, transition = jax.vmap(step, (None, 0, 0))(environment, moments, now)
        moments = renew(environment, moments, transition.done)
        return moments, (
            transition,
            jax.vmap(observation, (None, 0))(environment, moments),
            jax.random.key_data(moments.key),
        )

    return jax.lax.scan(one, jax.vmap(reset, (None, 0))(environment, keys), actions)[1]


@eqx.filter_jit
def alone(environment: Environment, key, actions):
    """One environment by itself: where its episode is over, what `reset` of its own key makes is taken."""

    def one(moment, action):
        moment, transition = step(environment, moment, action)
        fresh = reset(environment, moment.key)
        moment = jax.tree.map(lambda new, old: jnp.where(transition.done, new, old), fresh, moment)
        return moment, (transition, observation(environment, moment), jax.random.key_data(moment.key))

    return jax.lax.scan(one, reset(environment, key), actions)[1]


@pytest.mark.slow
def test_a_batch_is_its_environments_one_by_one(monkeypatch: pytest.MonkeyPatch):
    """Through several ends of episodes, also where more are over at once than are drawn at once."""
    monkeypatch.setattr(under_test, "RESETS_PER_CHUNK", 2)
    environment, count, steps = environment_of("two levels at the truth, targets that come and go"), 6, 20
    keys = jax.random.split(jax.random.key(7), count)
    actions = jax.random.uniform(jax.random.key(8), (steps, count, 2), minval=-1.2, maxval=1.2)
    batched = batch(environment, keys, actions)
    ends = np.array(batched[0].done)
    assert ends.sum() > 2 * count, "the test must go through fresh episodes of fresh episodes"
    assert ends.sum(axis=1).max() > 2, "and through more ends at once than a chunk has rows"
    assert np.array(batched[1].step)[ends].tolist() == [0] * ends.sum()
    for i in range(count):
        close(jax.tree.map(lambda part, i=i: part[:, i], batched), alone(environment, keys[i], actions[:, i]))


def close(one, other) -> None:
    """Equal to rounding, leaf by leaf."""
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)


def test_episodes_one_after_another_differ():
    environment = environment_of("surrogate, no noise")
    first = fresh_episode(environment, jax.random.key(0))
    second = fresh_episode(environment, first.key)
    assert not np.allclose(first.predicted.mean, second.predicted.mean)
    assert not np.allclose(first.episode.pose, second.episode.pose)


def test_a_protocol_that_needs_truth_is_rejected_without_it():
    for protocol in (TRUE, SOFT):
        with pytest.raises(ValueError, match="noise = False"):
            Environment(PLANAR.problem(), PLANAR.scenes, protocol, noise=False)
