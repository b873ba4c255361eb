"""Time simulation: rollouts, evaluation, environments and the omniscient planner."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from foveate.bench.timing import Metric, in_turn, rate_metric, spread
from foveate.evaluation.evaluate import Row, episode_rows, evaluate_traces, policy_keys, prepare
from foveate.experiment.experiment import Experiment
from foveate.experiment.resolve import load
from foveate.models.problem import first_information
from foveate.planning.shooting import OMNISCIENT, plan
from foveate.policies.inputs import masked_features
from foveate.simulation.batch import Batch, CompiledEnvironments
from foveate.simulation.environment import Environment
from foveate.simulation.episodes import training_episode
from foveate.simulation.information import Future
from foveate.simulation.records import PROTOCOLS, SURROGATE, Episode, Observation
from foveate.simulation.rollout import rollout
from foveate.simulation.suites import own_suite, scene_episodes

ENVIRONMENTS = 1024
"""Episodes of a batch of rollouts, and environments of a batch."""

PLANNED_SCENES, PLANNED_TARGETS = 4, 5
"""Scenes planned at once, and the number of targets in each."""


def simulation(experiment: Experiment, repeats: int) -> list[Metric]:
    """Time rollouts of training scenes without noise, and evaluation of the scenario's own suite by the real filter."""
    problem, settings = experiment.scenario.problem(), experiment.scenario.scenes
    policy = experiment.new_policy(jax.random.key(0))
    keys = jax.random.split(jax.random.key(0), ENVIRONMENTS)
    episodes = jax.jit(jax.vmap(lambda key: training_episode(problem, settings, key, noise=False)))(keys)
    # Padding and steps after an episode's horizon are simulated too, but do not count.
    rollout_steps = float(jnp.sum(jnp.sum(episodes.present, axis=-1) * episodes.horizon))
    play = jax.jit(jax.vmap(lambda episode, key: rollout(problem, policy, episode, SURROGATE, key).log_det))
    suite = prepare(problem, settings, own_suite(settings, problem), episodes=4)
    evaluation_steps = sum(len(scene.targets) * scene.horizon for scene in suite.scenes) * suite.episodes_per_scene
    calls = [lambda: play(episodes, keys), lambda: evaluate_traces(suite, policy, PROTOCOLS["true"])]
    rollout_s, evaluation_s = in_turn(calls, repeats).T
    return [
        rate_metric("rollout_target_steps_per_s", rollout_steps, rollout_s),
        rate_metric("evaluation_target_steps_per_s", evaluation_steps, evaluation_s),
        rate_metric("evaluation_episodes_per_s", len(suite.scenes) * suite.episodes_per_scene, evaluation_s),
    ]


def evaluation(preset: str, repeats: int) -> list[Metric]:
    """Time the evaluation of a trained preset on its own suite, over the bare simulation of the same episodes.

    The former, from scenes to rows, prepares episodes, simulates and measures them; the latter is one compiled program
    of all of them on arrays that are ready. Nothing is compiled in the timed calls, and no decision is timed.
    """
    experiment, policy, _ = load(preset)
    problem, settings = experiment.scenario.problem(), experiment.scenario.scenes
    scenes = own_suite(settings, problem)

    def evaluate() -> list[Row]:
        suite = prepare(problem, settings, scenes)
        trace = evaluate_traces(suite, policy, PROTOCOLS["true"])
        return episode_rows(suite, preset, "true", trace, [0.0] * len(scenes))

    suite = prepare(problem, settings, scenes)
    play = jax.jit(jax.vmap(lambda episode, key: rollout(problem, policy, episode, PROTOCOLS["true"], key)))
    bare = functools.partial(play, suite.episodes, policy_keys(suite))
    whole_s, bare_s = in_turn([evaluate, bare], repeats).T
    ratio = float(np.median(whole_s) / np.median(bare_s))
    return [Metric(key="evaluate_over_limit", value=ratio, unit="1", better="lower", spread=spread(whole_s / bare_s))]


def environments(experiment: Experiment, repeats: int) -> list[Metric]:
    """Time steps of a batch of environments, numpy arrays in and out, with episodes reset where they end."""
    problem, settings = experiment.scenario.problem(), experiment.scenario.scenes

    def features(observation: Observation, left: jax.Array) -> jax.Array:
        return masked_features(observation, left, problem.agent.space, "body").row

    batch = Batch(CompiledEnvironments(Environment(problem, settings, PROTOCOLS["true"], True), features, ENVIRONMENTS))
    batch.renew(jax.random.split(jax.random.key(0), ENVIRONMENTS))
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (32, ENVIRONMENTS, batch.axes)).astype(np.float32)
    seconds = in_turn([lambda: np.stack([batch.step(action).reward for action in actions])], repeats)[:, 0]
    return [rate_metric(f"env_steps_per_s_{ENVIRONMENTS}", len(actions) * ENVIRONMENTS, seconds)]


def planning(experiment: Experiment, repeats: int) -> list[Metric]:
    """Time plans of the omniscient planner, from all its starts."""
    problem, settings = experiment.scenario.problem(), experiment.scenario.scenes
    scenes = [scene for scene in own_suite(settings, problem) if len(scene.targets) == PLANNED_TARGETS][:PLANNED_SCENES]
    episodes = scene_episodes(problem, settings, scenes, seed=0, episodes=1)
    keys = jax.random.split(jax.random.key(0), len(scenes))

    def solve(episode: Episode, key: jax.Array) -> jax.Array:
        assert episode.truth is not None, "scene_episodes always draws the truth"
        information = first_information(problem, len(episode.mean))
        future = Future(episode.pose, episode.truth.state[1:], information, episode.present, episode.horizon)
        return plan(problem, future, OMNISCIENT["true"], key).score

    program = jax.jit(jax.vmap(solve))
    seconds = in_turn([lambda: program(episodes, keys)], repeats)[:, 0]
    return [rate_metric("planner_scenes_per_s", len(scenes), seconds)]
