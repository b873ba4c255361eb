"""The range of features, against what policies are told in episodes that are rolled out one by one."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.errors import InputError
from foveate.experiment.checkpoint import load_run
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.learning import feature_range, worlds
from foveate.learning.feature_range import with_feature_range
from foveate.learning.loop import train
from foveate.learning.worlds import informed, worlds_of
from foveate.policies.pointer import PointerPolicy
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.target import VelocityTarget
from foveate.scenario.team import TeamSettings
from foveate.simulation.records import TRUE, Policy
from foveate.simulation.rollout import rollout

TRAINING = PRESETS["any"].training
SMALL = PointerSettings(
    kind="pointer", target_widths=(8,), heads=2, context_widths=(8,), mode_width=8, modes=1, clips_features=True
)
FEW = SceneSettings(targets_min=1, targets_max=2)
TOLD: list[np.ndarray] = []


class Told(Policy):
    """Notes what a policy is told of the targets that are present, until the episode ends."""

    policy: PointerPolicy
    horizon: Any

    def __call__(self, observation, memory, key):
        def note(features, present, step, horizon):
            if step < horizon:
                TOLD.extend(features[present])

        tokens = self.policy.tokens(observation)
        jax.debug.callback(note, tokens.features, tokens.present, observation.step, self.horizon)
        return self.policy(observation, memory, key)


@pytest.mark.slow
def test_the_range_is_that_of_most_features_in_each_world(monkeypatch):
    """Two worlds: the least of both lower ends, and the largest of both upper ends."""
    walkers = Scenario(target=VelocityTarget(kind="constant_velocity"), scenes=replace(FEW, targets_max=3, steps=12))
    monkeypatch.setattr(worlds, "RANDOM", ((Scenario(scenes=FEW), "terminal"), (walkers, "seen")))
    monkeypatch.setattr(feature_range, "EPISODES", 8)
    experiment = Experiment(policy=SMALL, training=TRAINING)
    both, policy, key = worlds_of(experiment), experiment.new_policy(jax.random.key(0)), jax.random.key(1)
    low, high = np.asarray(with_feature_range(both, policy, TRAINING, key).feature_range)
    found = []
    for world, own in zip(both, jax.random.split(key, 2), strict=True):

        @jax.jit
        def play(key, world=world):
            scene_key, policy_key = jax.random.split(key)
            problem, episode = world.drawn(scene_key)
            told = Told(informed(policy, world, TRAINING), episode.horizon)
            return rollout(problem, told, episode, TRUE, policy_key).action

        TOLD.clear()
        for one in jax.random.split(own, 8):
            play(one).block_until_ready()
        jax.effects_barrier()
        found.append(np.quantile(TOLD, [0.05, 0.95], axis=0))
    np.testing.assert_allclose(low, np.minimum(found[0][0], found[1][0]), atol=1e-5)
    np.testing.assert_allclose(high, np.maximum(found[0][1], found[1][1]), atol=1e-5)
    assert (high - low).max() > 1.0
    begun = replace(policy, feature_range=jnp.stack([low - 1.0, high - 1.0]))  # of a training before
    wider = np.asarray(with_feature_range(both, begun, TRAINING, key).feature_range)
    np.testing.assert_allclose(wider, [low - 1.0, high], atol=1e-5)


def test_a_team_without_assigned_targets_clips_nothing():
    team = Scenario(team=TeamSettings(agents=2), scenes=FEW)
    experiment = Experiment(scenario=team, policy=SMALL, training=replace(TRAINING, worlds="own"))
    policy = experiment.new_policy(jax.random.key(0))
    with pytest.raises(InputError, match=r"policy.clips_features = True: expected false in a team"):
        with_feature_range(worlds_of(experiment), policy, experiment.training, jax.random.key(1))


@pytest.mark.slow
def test_a_training_in_random_worlds_keeps_the_range_with_the_policy(monkeypatch, tmp_path):
    monkeypatch.setattr(worlds, "RANDOM", ((Scenario(scenes=FEW), "terminal"),))
    monkeypatch.setattr(feature_range, "EPISODES", 8)
    training = replace(TRAINING, epochs=1, episodes=16, minibatches=2, held_out=8)
    train(Experiment(policy=SMALL, training=training), tmp_path / "run")
    low, high = np.asarray(load_run(tmp_path / "run")[1].feature_range)
    assert (low <= high).all()
    assert np.abs([low, high]).max() < 100.0
