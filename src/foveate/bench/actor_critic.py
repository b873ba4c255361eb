"""Time iterations of the actor-critic against their limit.

The *limit* of an iteration is arithmetic alone: the multiply-adds of the dense layers of policy and critic on rows and
targets that are real, 2 operations each, at the rate of a large float32 matrix product, timed in turn with it. The
batch is decided and valued once; each epoch of updates goes forward, and twice that backward.
"""

import jax
import jax.numpy as jnp
import numpy as np

from foveate.bench.decisions import observation_of
from foveate.bench.operations import multiply_adds, per_episode
from foveate.bench.timing import Metric, in_turn, matrix_product, rate_metric, spread
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings
from foveate.learning.actor_critic import begin
from foveate.learning.learner import Learner
from foveate.learning.loop import advance_of
from foveate.learning.worlds import worlds_of
from foveate.models.problem import Problem
from foveate.policies.pointer import PointerPolicy

ITERATIONS_PER_CALL = 2
"""Iterations in a timed call: each takes long beside the overhead of a call."""


def row_products(problem: Problem, learner: Learner, targets: int) -> int:
    """Multiply-adds of the learner's networks for one row, a decision among this number of targets."""
    assert isinstance(learner.policy, PointerPolicy), "the actor-critic trains no other"
    observation = observation_of(problem, targets)
    decision = multiply_adds(learner.policy, observation, (), jax.random.key(0))
    return decision + multiply_adds(learner.critic, jax.eval_shape(learner.policy.tokens, observation))


def minimum_operations(experiment: Experiment, problem: Problem, learner: Learner) -> float:
    """Fewest floating-point operations of an iteration."""
    training, scenes = experiment.training, experiment.scenario.scenes
    assert isinstance(training, ActorCriticSettings), "the actor-critic is measured"
    products = per_episode(lambda targets: row_products(problem, learner, targets), scenes) / scenes.mean_horizon
    return 2.0 * training.decisions(scenes) * products * (1 + 3 * training.update_epochs)


def iterations(experiment: Experiment, repeats: int) -> list[Metric]:
    """Time iterations of an actor-critic that plays whole episodes, over their limit and as its environments' steps."""
    problem, training, scenes = experiment.scenario.problem(), experiment.training, experiment.scenario.scenes
    assert isinstance(training, ActorCriticSettings), "the actor-critic is measured"
    policy_key, critic_key, key = jax.random.split(jax.random.key(0), 3)
    learner = begin(worlds_of(experiment), experiment.new_policy(policy_key), training, critic_key)
    program, (product, operations) = advance_of(experiment), matrix_product()
    calls = [product, lambda: program(jnp.array(ITERATIONS_PER_CALL), learner, key)[1].objective]
    reference, seconds = in_turn(calls, repeats).T
    seconds = seconds / ITERATIONS_PER_CALL
    limit = minimum_operations(experiment, problem, learner) * np.median(reference) / operations
    return [
        Metric(
            key="actor_critic_over_limit",
            value=float(np.median(seconds) / limit),
            unit="1",
            better="lower",
            spread=spread(seconds / reference),
        ),
        rate_metric("actor_critic_env_steps_per_s", training.decisions(scenes), seconds),
    ]
