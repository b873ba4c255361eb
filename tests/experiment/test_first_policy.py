"""A training that begins with the weights of another: the same numbers, also with the dynamic window beside them."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import foveate
from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.experiment.first_policy import first_policy
from foveate.experiment.presets import ACTOR_CRITIC, PAN
from foveate.models.robot import Robot
from foveate.policies.pointer import PADDING_LOG_WEIGHT
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.scenario import Scenario
from foveate.simulation.episodes import training_episode
from foveate.simulation.records import TRUE, observe
from foveate.simulation.step import start

SMALL = PointerSettings(kind="pointer", target_widths=(8,), heads=2, context_widths=(8,), mode_width=8)
FOR_ANY = Experiment(policy=SMALL, training=replace(ACTOR_CRITIC, worlds="random"))
LONG = replace(PAN, scenes=replace(PAN.scenes, steps=200))


def made(experiment: Experiment, seed: int = 0) -> foveate.TrainedPolicy:
    network = experiment.new_policy(jax.random.key(seed))
    return foveate.TrainedPolicy(name="made", experiment=experiment, network=network, facts={})


def test_a_training_begins_with_the_weights_of_a_run(tmp_path):
    given = made(FOR_ANY, seed=7)
    given.save(tmp_path / "run")
    begins = replace(FOR_ANY, scenario=LONG, policy=replace(SMALL, begin_with=str(tmp_path / "run")))
    policy = first_policy(replace(begins, training=replace(ACTOR_CRITIC, objective="mean")), jax.random.key(0))
    assert (policy.objective, policy.tells_time) == ("mean", False)
    found, expected = (jax.tree.leaves(eqx.filter(x, eqx.is_array)) for x in (policy, given.network))
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)
    for change in (
        {"target_widths": (9,)},
        {"context_widths": (9,), "dynamic_window": True},
        {"mode_width": 9, "dynamic_window": True},
        {"clips_features": True},
        {"begin_with": "quadrotor", "dynamic_window": True},
    ):
        other = replace(begins, policy=replace(begins.policy, **change))
        with pytest.raises(InputError, match=r"policy.begin_with = .*expected a run with a network of this shape: of"):
            first_policy(other, jax.random.key(0))


@pytest.mark.parametrize("clips", [False, True])
def test_a_network_with_the_window_begins_as_one_without_it(tmp_path, clips):
    """All modes but the window's are those of the first network, whose clipping holds, too."""
    experiment = replace(FOR_ANY, scenario=Scenario(), policy=replace(SMALL, clips_features=clips))
    given = made(experiment, seed=7)
    if clips:
        limits = jnp.array([[-0.5], [0.5]]) + jnp.zeros_like(given.network.feature_range)
        given = replace(given, network=replace(given.network, feature_range=limits))
    given.save(tmp_path / "run")
    settings = replace(experiment.policy, begin_with=str(tmp_path / "run"), dynamic_window=True)
    policy = first_policy(replace(experiment, policy=settings), jax.random.key(3))

    problem = experiment.scenario.problem()
    episode = training_episode(problem, experiment.scenario.scenes, jax.random.key(1), noise=True)
    state = start(problem, episode, TRUE)
    observation = observe(state, episode.inputs[0], episode.horizon, Robot.of(problem))
    expected = given.network.modes(given.network.tokens(observation))
    found = policy.modes(policy.tokens(observation))
    assert len(found.log_weight) == len(expected.log_weight) + 1
    assert PADDING_LOG_WEIGHT < found.log_weight[-1] < jnp.max(expected.log_weight)
    np.testing.assert_allclose(found.log_weight[:-1], expected.log_weight, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(found.action[:-1], expected.action, rtol=1e-5, atol=1e-5)
    assert eqx.tree_equal(policy.preference, given.network.preference)
