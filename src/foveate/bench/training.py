"""Time training steps against their limit, and count the programs that a training compiles.

The *limit* of a training step is arithmetic alone: the dense multiply-adds of the policy's layers on targets and steps
that are real (no padding, no finished episode), forward and twice that backward, 2 operations each, at the rate of a
large float32 matrix product, timed in turn with the step.
"""

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from foveate.bench.decisions import observation_of
from foveate.bench.operations import multiply_adds, per_episode
from foveate.bench.timing import (
    Metric,
    compilations,
    in_turn,
    matrix_product,
    peak_memory_mib,
    rate_metric,
    spread,
    time_metric,
    timed,
)
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import TrainingSettings
from foveate.learning.devices import Share, on_all_devices, schedule
from foveate.learning.gradient import Group, mean_and_gradient
from foveate.learning.loop import PLANAR_COMPILER_OPTIONS, advance_of, train
from foveate.learning.policy_gradient import begin, micro_batch_size
from foveate.models.problem import Problem
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.records import Policy

EPISODES_PER_CALL = 1200
"""Approximate number of episodes in a timed call of the training program: enough to hide the call's own overhead."""

PAPER_EPISODES = 60
"""Episodes of the paper's training step, for which compilation is reported."""


def minimum_operations(problem: Problem, policy: Policy, scenes: SceneSettings, episodes: int) -> float:
    """Fewest floating-point operations of a training step: forward, and twice that backward."""

    def decision(targets: int) -> int:
        return multiply_adds(policy, observation_of(problem, targets), (), jax.random.key(0))

    return 3 * 2.0 * episodes * per_episode(decision, scenes)


def network_program(problem: Problem, scenes: SceneSettings, training: TrainingSettings, policy: Policy) -> Callable:
    """Compile a function that takes `count` steps of ascent on decisions alone, without simulation.

    It makes as many decisions as real episodes have, each for their mean number of targets. Without padding, beliefs
    and back-propagation through states it is closer to the limit than a training step can be.
    """
    steps, target_steps = scenes.mean_horizon, per_episode(float, scenes)
    decisions, space = round(training.episodes * steps), problem.agent.space
    observation = observation_of(problem, round(target_steps / steps))
    pose_key, mean_key = jax.random.split(jax.random.key(0))
    places = jax.random.normal(pose_key, (decisions, space.dimension + 1))
    poses = jax.vmap(lambda place: space.upright(place[1:], place[0]))(places)
    means = observation.mean + 0.1 * jax.random.normal(mean_key, (decisions, *observation.mean.shape))
    parameters, rest = eqx.partition(policy, eqx.is_inexact_array)
    # Micro-batches as large, in decisions, as those of the training step.
    share = Share(decisions, round(micro_batch_size(training, scenes) * steps))

    def loss(parameters, pose_and_mean):
        seen = eqx.tree_at(lambda o: (o.pose, o.mean), observation, pose_and_mean)
        return jnp.sum(eqx.combine(parameters, rest)(seen, (), jax.random.key(0))[0] ** 2)

    def step(_, parameters):
        gradient = mean_and_gradient([Group(loss, (poses, means), share)], parameters)[1]
        return jax.tree.map(lambda p, g: p - 1e-3 * g, parameters, gradient)

    program = jax.jit(
        lambda count, parameters: jax.lax.fori_loop(0, count, step, parameters),
        compiler_options=PLANAR_COMPILER_OPTIONS,
    )
    run = on_all_devices(program, schedule([share]).devices)
    return lambda count: jax.tree.leaves(run(jnp.array(count), parameters))[0]


def training_step(experiment: Experiment, episodes: int, repeats: int) -> list[Metric]:
    """Time a step of ascent on `episodes`, over its limit and in seconds, and its compilation."""
    assert isinstance(experiment.training, TrainingSettings), "the paper's learner is measured"
    problem, scenes = experiment.scenario.problem(), experiment.scenario.scenes
    training = replace(experiment.training, episodes=episodes)
    policy = experiment.new_policy(jax.random.key(0))
    learner, key = begin(policy, training), jax.random.key(1)
    count = max(2, EPISODES_PER_CALL // episodes)
    program = advance_of(replace(experiment, training=training))
    # A step is so short that the first call of the program is its compilation.
    compile_s = timed(lambda: program(jnp.array(1), learner, key)[1].objective)

    product, operations = matrix_product()
    network = network_program(problem, scenes, training, policy)
    calls = [product, lambda: program(jnp.array(count), learner, key)[1].objective, lambda: network(count)]
    seconds = in_turn(calls, repeats)
    reference, step, network_step = seconds[:, 0], seconds[:, 1] / count, seconds[:, 2] / count
    limit = minimum_operations(problem, policy, scenes, episodes) * np.median(reference) / operations

    def over_limit(name: str, times: np.ndarray) -> Metric:
        value = float(np.median(times)) / limit
        return Metric(key=f"{name}_{episodes}", value=value, unit="1", better="lower", spread=spread(times / reference))

    metrics = [
        over_limit("train_step_over_limit", step),
        over_limit("network_over_limit", network_step),
        time_metric(f"train_epoch_s_{episodes}", step, per="matmul"),
        rate_metric(f"train_episodes_per_s_{episodes}", episodes, step),
        rate_metric(f"train_target_steps_per_s_{episodes}", episodes * per_episode(float, scenes), step),
        Metric(key=f"train_peak_memory_mib_{episodes}", value=peak_memory_mib(), unit="MiB", better="lower"),
    ]
    if episodes == PAPER_EPISODES:
        metrics.append(time_metric("train_compile_s", [compile_s]))
    return metrics


def compilation_counts(experiment: Experiment) -> list[Metric]:
    """Count the programs that a training compiles in all, and after its first validation, where none should be."""
    training = replace(experiment.training, epochs=5, check_every=2)
    counts: list[int] = []
    with tempfile.TemporaryDirectory() as folder, compilations() as compiled:
        train(
            replace(experiment, training=training),
            Path(folder) / "run",
            on_validation=lambda validation, total: counts.append(len(compiled)),
        )
    numbers = {"train_compilations": len(compiled), "train_late_compilations": counts[-1] - counts[0]}
    return [Metric(key=key, value=float(value), unit="1", better="lower") for key, value in numbers.items()]
