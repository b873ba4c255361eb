"""Iterations of the actor-critic beside their limit."""

from dataclasses import replace

import jax
import pytest

from foveate.bench import actor_critic
from foveate.bench.decisions import observation_of
from foveate.bench.operations import multiply_adds
from foveate.bench.timing import matrix_product
from foveate.experiment.presets import ACTOR_CRITIC, POINTER
from foveate.learning.actor_critic import begin
from foveate.learning.worlds import worlds_of


@pytest.mark.slow
def test_an_iteration_is_measured_against_the_arithmetic_of_its_networks(tiny, monkeypatch, clock):
    """A call of 2 s is two iterations: of 6 episodes, 1 or 2 targets for 3 steps; three epochs of updates."""
    training = replace(ACTOR_CRITIC, episodes=6, update_epochs=3, minibatches=1)
    experiment = replace(tiny, policy=POINTER, training=training)
    monkeypatch.setattr(actor_critic, "in_turn", clock)
    metrics = {metric.key: metric.value for metric in actor_critic.iterations(experiment, 1)}
    assert metrics["actor_critic_env_steps_per_s"] == pytest.approx(6 * 3 / 1.0)
    problem = experiment.scenario.problem()
    policy = experiment.new_policy(jax.random.key(0))
    learner = begin(worlds_of(experiment), policy, training, jax.random.key(1))
    row = [
        multiply_adds(learner.policy, observation_of(problem, n), (), jax.random.key(0))
        + multiply_adds(learner.critic, jax.eval_shape(policy.tokens, observation_of(problem, n)))
        for n in (1, 2)
    ]
    assert row[1] > row[0] > 10_000
    operations = 2 * 6 * 3 * sum(row) / 2 * (1 + 3 * 3)
    assert metrics["actor_critic_over_limit"] == pytest.approx(1.0 / (2.0 * operations / matrix_product()[1]))
