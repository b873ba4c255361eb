"""Worlds of a training: its own, or those of random robots, learned from together."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.learning import actor_critic, worlds
from foveate.learning.loop import advance_of
from foveate.learning.validation import held_out_episodes, validate
from foveate.learning.worlds import RANDOM, informed, most_targets, worlds_of
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.target import VelocityTarget
from foveate.simulation.episodes import training_episode

ANY = PRESETS["any"]
FEW = SceneSettings(targets_min=1, targets_max=2, steps=5, half_side_per_target_m=1.5, drift_m_s=(0.1, 0.1))


def test_an_experiment_has_its_own_world():
    experiment = PRESETS["quadrotor"]
    (world,) = worlds_of(experiment)
    assert (world.scenes, world.objective, world.robots) == (experiment.scenario.scenes, "mean", None)
    problems = []

    @jax.jit
    def drawn(key):
        problem, episode = world.drawn(key)
        problems.append(problem)
        return episode

    episode = drawn(jax.random.key(3))
    assert problems[0] is world.problem
    problem, scenes = experiment.scenario.problem(), experiment.scenario.scenes
    expected = training_episode(problem, scenes, jax.random.key(3), True)  # operation by operation
    np.testing.assert_allclose(episode.mean, expected.mean, atol=1e-12)


@pytest.mark.parametrize("number", range(len(RANDOM)))
def test_every_episode_of_a_random_world_has_its_own_robot(number):
    world = worlds_of(ANY)[number]
    robots, episodes = world.held_out(jax.random.split(jax.random.key(0), 3))
    assert robots is not None
    for of in (lambda p: p.agent.upper[:, -1], lambda p: p.sensor.V[:, 0, 0], lambda p: p.prior_information[:, 0, 0]):
        assert len(np.unique(np.asarray(of(robots)))) == 3
    for leaf in jax.tree.leaves((robots, episodes)):
        assert np.isfinite(np.asarray(leaf, float)).all()
    one, again = (jax.jit(world.drawn)(jax.random.key(5))[0] for _ in range(2))
    np.testing.assert_array_equal(one.agent.upper, again.agent.upper, err_msg="the robot is that of the episode's key")


def test_a_policy_is_told_the_objective_and_the_end_of_a_random_world():
    policy, training = ANY.new_policy(jax.random.key(0)), ANY.training
    for world in worlds_of(ANY):
        network = informed(policy, world, training)
        assert network.objective == world.objective
        assert network.tells_time == (world.scenes.horizon(world.scenes.targets_max) <= training.window)
    (own,) = worlds_of(PRESETS["pan"])
    assert informed(policy, own, training) is policy


@pytest.mark.slow
def test_all_worlds_are_learned_from_together(monkeypatch):
    """Two worlds of other numbers of targets, numbers of a state, horizons, and objectives."""
    walkers = Scenario(target=VelocityTarget(kind="constant_velocity"), scenes=replace(FEW, targets_max=3, steps=12))
    monkeypatch.setattr(worlds, "RANDOM", ((Scenario(scenes=FEW), "terminal"), (walkers, "seen")))
    network = PointerSettings(kind="pointer", target_widths=(8,), heads=2, context_widths=(8,), mode_width=8, modes=1)
    training = replace(ANY.training, episodes=32, minibatches=2, window=6, held_out=32)
    experiment = Experiment(policy=network, training=training)
    both = worlds_of(experiment)
    assert most_targets(both) == 3
    policy = experiment.new_policy(jax.random.key(0))
    learner = actor_critic.begin(both, policy, training, jax.random.key(1))
    assert [ongoing is None for ongoing in learner.ongoing] == [True, False]
    learner, report = advance_of(experiment)(jnp.array(3), learner, jax.random.key(2))
    assert bool(report.finite)
    assert int(learner.epoch) == 3
    assert learner.critic.std.shape == (2,)
    assert (np.asarray(learner.critic.std) > 0).all()
    assert learner.critic.std[0] > learner.critic.std[1], "nats and shares of time: each on its own scale"
    moved = jax.tree.map(lambda a, b: bool((a != b).any()), policy.by_target.weight, learner.policy.by_target.weight)
    assert moved
    held_out = held_out_episodes(experiment, jax.random.key(3))
    score, _ = jax.jit(lambda key: validate(experiment, learner.policy, held_out, key))(jax.random.key(4))
    assert np.isfinite(float(score))
