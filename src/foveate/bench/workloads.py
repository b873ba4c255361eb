"""What `foveate bench` measures: training against its limit, deciding, simulating, planning, starting.

The *limit* of a training step is arithmetic alone: the dense multiply-adds of the policy's layers on targets and steps
that are real (no padding, no finished episode), forward and twice that backward, 2 operations each, at the rate of a
large float32 matrix product that is measured in turn with the step.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from foveate.bench.timing import Metric, compilations, in_turn, matrix_product, peak_memory_mib, spread, timed
from foveate.errors import InputError
from foveate.evaluation.evaluate import evaluate_traces, prepare
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import TrainingSettings
from foveate.experiment.presets import PRESETS
from foveate.learning.devices import on_all_devices, sharded
from foveate.learning.gradient import mean_and_gradient
from foveate.learning.loop import QUICKLY, advance_of, train
from foveate.learning.policy_gradient import begin, micro_batch_size
from foveate.models.problem import Problem, first_information
from foveate.planning.information import Future
from foveate.planning.shooting import OMNISCIENT, plan
from foveate.policies.attention import AttentionPolicy
from foveate.policies.inputs import policy_features
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.batch import Batch, Programs
from foveate.simulation.environment import Environment
from foveate.simulation.episodes import scene_episodes, training_episode
from foveate.simulation.records import PROTOCOLS, SURROGATE, Episode, Observation, Policy
from foveate.simulation.rollout import rollout
from foveate.simulation.suites import own_suite

Measurement = tuple[str, Callable[[int], list[Metric]]]
"""What is measured, in words, and the function that measures it with so many repeats."""


TARGETS = (1, 8, 64, 1000)
"""Numbers of targets that a decision is timed for."""


EPISODES_A_CALL = 1200
"""A timed call of the training program goes through about so many episodes."""


ENVIRONMENTS = 1024


PLANNED_SCENES = 4


def measurements(sizes: tuple[int, ...], quick: bool) -> list[Measurement]:
    """All that is measured, in this order; `sizes` are episodes of a training step."""
    world = PRESETS["paper"]
    training: list[Measurement] = [
        (f"training step, {size} episodes", lambda repeats, size=size: training_step(world, size, repeats))
        for size in sizes
    ]
    rest: list[Measurement] = [
        ("simulation", lambda repeats: simulation(world, repeats)),
        ("environments", lambda repeats: environments(world, repeats)),
        ("decisions by JAX", lambda repeats: decisions_jax(world, repeats)),
        ("decisions by ONNX Runtime", lambda repeats: decisions_onnx(world, repeats)),
        ("planning", lambda repeats: planning(world, repeats)),
        ("compilations of a training", lambda repeats: compiled(world)),
        ("start of the command line", lambda repeats: starting(repeats)),
    ]
    if not quick:
        rest.append(("the paper's training, from command to checkpoint", lambda repeats: whole_process()))
    return training + rest


def dense_products(policy: AttentionPolicy) -> tuple[int, int]:
    """Multiply-adds of the layers in one decision: for each target, and for the agent."""
    of_target = sum(layer.weight.size for layer in policy.target_layers)
    return of_target, sum(layer.weight.size for layer in (*policy.agent_layers, *policy.out_layers))


def real_steps(scenes: SceneSettings) -> tuple[float, float]:
    """Steps, and steps of targets, in an episode that is drawn, in the mean."""
    numbers = range(scenes.targets_min, scenes.targets_max + 1)
    return scenes.mean_horizon, sum(n * scenes.horizon(n) for n in numbers) / len(numbers)


def least_operations(policy: AttentionPolicy, scenes: SceneSettings, episodes: int) -> float:
    """Floating-point operations that a training step cannot do without: forward, and twice that backward."""
    of_target, of_agent = dense_products(policy)
    steps, target_steps = real_steps(scenes)
    return 3 * 2.0 * episodes * (target_steps * of_target + steps * of_agent)


def network_program(
    problem: Problem, scenes: SceneSettings, training: TrainingSettings, policy: AttentionPolicy
) -> Callable:
    """The compiled function of a count that makes so many steps of ascent on nothing but decisions: as many as
    real episodes have, for as many targets as these have in the mean, all at once.

    What the library of array programs makes of the arithmetic where there is no padding, no simulation, no belief, no
    way back through the states: the limit is further away for a training step than for this.
    """
    steps, target_steps = real_steps(scenes)
    decisions, space = round(training.episodes * steps), problem.agent.space
    seen = observation_of(problem, round(target_steps / steps))
    pose_key, mean_key = jax.random.split(jax.random.key(0))
    places = jax.random.normal(pose_key, (decisions, space.dimension + 1))
    poses = jax.vmap(lambda place: space.upright(place[1:], place[0]))(places)
    means = seen.mean + 0.1 * jax.random.normal(mean_key, (decisions, *seen.mean.shape))
    parameters, rest = eqx.partition(policy, eqx.is_inexact_array)
    at_once = round(micro_batch_size(training, scenes) * steps)

    def cost(parameters, where):
        observation = eqx.tree_at(lambda o: (o.pose, o.mean), seen, where)
        return jnp.sum(eqx.combine(parameters, rest)(observation, (), jax.random.key(0))[0] ** 2)

    def step(_, parameters):
        gradient = mean_and_gradient(cost, parameters, (poses, means), at_once)[1]
        return jax.tree.map(lambda p, g: p - 1e-3 * g, parameters, gradient)

    program = jax.jit(lambda count, parameters: jax.lax.fori_loop(0, count, step, parameters), compiler_options=QUICKLY)
    run = on_all_devices(program, sharded(decisions, at_once).devices)
    return lambda count: jax.tree.leaves(run(jnp.array(count), parameters))[0]


def training_step(experiment: Experiment, episodes: int, repeats: int) -> list[Metric]:
    """One step of ascent on so many episodes, as a share of its limit and in seconds, and its compilation."""
    assert isinstance(experiment.training, TrainingSettings), "the paper's learner is measured"
    problem, scenes = experiment.scenario.problem(), experiment.scenario.scenes
    training = replace(experiment.training, episodes=episodes)
    policy = experiment.policy.policy(problem, jax.random.key(0))
    assert isinstance(policy, AttentionPolicy), "the paper's network is measured"
    learner, key = begin(policy, training), jax.random.key(1)
    count = max(2, EPISODES_A_CALL // episodes)
    program = advance_of(replace(experiment, training=training), problem)
    # One step is so short that the first call of the program is its compilation.
    compile_s = timed(lambda: program(jnp.array(1), learner, key)[1].objective)

    product, operations = matrix_product()
    alone = network_program(problem, scenes, training, policy)
    calls = [product, lambda: program(jnp.array(count), learner, key)[1].objective, lambda: alone(count)]
    seconds = in_turn(calls, repeats)
    seconds[:, 1:] /= count
    rate, step = operations / np.median(seconds[:, 0]), float(np.median(seconds[:, 1]))
    limit = least_operations(policy, scenes, episodes) / rate
    wide = spread(seconds[:, 1])
    times: dict[str, Any] = {"better": "higher", "unit": "1/s", "per": "matmul", "spread": wide}
    found = [
        Metric(
            key=f"train_step_over_limit_{episodes}",
            value=step / limit,
            unit="1",
            better="lower",
            spread=spread(seconds[:, 1] / seconds[:, 0]),
        ),
        Metric(
            key=f"network_over_limit_{episodes}",
            value=float(np.median(seconds[:, 2])) / limit,
            unit="1",
            better="lower",
            spread=spread(seconds[:, 2] / seconds[:, 0]),
        ),
        Metric(key=f"train_epoch_s_{episodes}", **{**times, "better": "lower", "unit": "s"}, value=step),
        Metric(key=f"train_episodes_per_s_{episodes}", **times, value=episodes / step),
        Metric(
            key=f"train_target_steps_per_s_{episodes}", **times, value=episodes * float(real_steps(scenes)[1]) / step
        ),
        Metric(key=f"train_peak_memory_mib_{episodes}", value=peak_memory_mib(), unit="MiB", better="lower"),
    ]
    if episodes == 60:  # the paper's: one program for every number of epochs
        found.append(Metric(key="train_compile_s", value=compile_s, unit="s", better="lower", per="python"))
    return found


def simulation(experiment: Experiment, repeats: int) -> list[Metric]:
    """Rollouts of training scenes without noise, and evaluation of the scenario's own suite by the real filter."""
    problem, settings = experiment.scenario.problem(), experiment.scenario.scenes
    policy = experiment.policy.policy(problem, jax.random.key(0))
    keys = jax.random.split(jax.random.key(0), ENVIRONMENTS)
    episodes = jax.jit(jax.vmap(lambda key: training_episode(problem, settings, key, noise=False)))(keys)
    target_steps = float(jnp.sum(jnp.sum(episodes.present, axis=-1) * episodes.horizon))
    play = jax.jit(jax.vmap(lambda e, k: rollout(problem, policy, e, SURROGATE, k).log_det))
    suite = prepare(problem, settings, own_suite(settings, problem), episodes=4)
    real = sum(len(scene.targets) * scene.horizon for scene in suite.scenes) * suite.episodes_per_scene
    seconds = in_turn(
        [lambda: play(episodes, keys), lambda: evaluate_traces(suite, policy, PROTOCOLS["true"])], repeats
    )
    rollouts, evaluation = np.median(seconds, axis=0)
    count = len(suite.scenes) * suite.episodes_per_scene
    times: dict[str, Any] = {"unit": "1/s", "better": "higher", "per": "matmul"}
    return [
        Metric(key="rollout_target_steps_per_s", value=target_steps / rollouts, **times, spread=spread(seconds[:, 0])),
        Metric(key="evaluation_target_steps_per_s", value=real / evaluation, **times, spread=spread(seconds[:, 1])),
        Metric(key="evaluation_episodes_per_s", value=count / evaluation, **times, spread=spread(seconds[:, 1])),
    ]


def environments(experiment: Experiment, repeats: int) -> list[Metric]:
    """Steps of environments side by side, numpy arrays in and out, episodes begun anew where they are over."""
    scenario = experiment.scenario
    problem = scenario.problem()

    def look(observation: Observation, left: jax.Array) -> jax.Array:
        return policy_features(observation, left, problem.agent.space, "body").row

    batch = Batch(Programs(Environment(problem, scenario.scenes, PROTOCOLS["true"], True), look, ENVIRONMENTS))
    batch.renew(jax.random.split(jax.random.key(0), ENVIRONMENTS))
    shape = (32, ENVIRONMENTS, batch.axes)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, shape).astype(np.float32)

    def steps() -> np.ndarray:
        return np.stack([batch.step(action).reward for action in actions])

    seconds = in_turn([steps], repeats)[:, 0]
    rate = len(actions) * ENVIRONMENTS / float(np.median(seconds))
    key = f"env_steps_per_s_{ENVIRONMENTS}"
    return [Metric(key=key, value=rate, unit="1/s", better="higher", per="matmul", spread=spread(seconds))]


def observation_of(problem: Problem, targets: int) -> Observation:
    """What a policy may see of so many targets."""
    rng, d, n_y = np.random.default_rng(targets), problem.agent.space.dimension, problem.motion.state_size
    return Observation(
        step=jnp.zeros((), int),
        left=jnp.array(10),
        pose=problem.agent.space.identity(),
        mean=jnp.asarray(rng.normal(0.0, 5.0, (targets, n_y)), jnp.float32),
        information=jnp.asarray(np.broadcast_to(np.eye(n_y), (targets, n_y, n_y)), jnp.float32),
        present=jnp.ones(targets, bool),
        known_input=jnp.zeros((targets, problem.motion.input_size if d else 0), jnp.float32),
    )


def _decisions(name: str, decide_for: Callable[[int], Callable[[], Any]], repeats: int) -> list[Metric]:
    """Microseconds of one decision, called alone and waited for, by the number of targets."""
    found = []
    for targets in TARGETS:
        decide, calls = decide_for(targets), max(20, 4000 // targets)

        def several(decide=decide, calls=calls) -> None:
            for _ in range(calls):
                jax.block_until_ready(decide())

        seconds = in_turn([several], repeats)[:, 0] / calls
        value = 1e6 * float(np.median(seconds))
        key = f"decision_{name}_us_{targets}"
        found.append(Metric(key=key, value=value, unit="us", better="lower", per="python", spread=spread(seconds)))
    return found


def decisions_jax(experiment: Experiment, repeats: int) -> list[Metric]:
    """Decisions of the paper's network, compiled by JAX."""
    problem = experiment.scenario.problem()
    policy: Policy = experiment.policy.policy(problem, jax.random.key(0))
    decide, key = jax.jit(lambda observation, key: policy(observation, (), key)[0]), jax.random.key(0)

    def decide_for(targets: int) -> Callable[[], Any]:
        seen = observation_of(problem, targets)
        return lambda: decide(seen, key)

    return _decisions("jax", decide_for, repeats)


def decisions_onnx(experiment: Experiment, repeats: int) -> list[Metric]:
    """Decisions of the exported network by ONNX Runtime, on one thread; nothing where the extra is missing."""
    try:
        import onnxruntime
    except ImportError:
        return []
    from foveate.deploy.onnx.export import to_onnx

    problem = experiment.scenario.problem()
    policy = experiment.policy.policy(problem, jax.random.key(0))
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(
        to_onnx(experiment, policy).SerializeToString(), options, providers=["CPUExecutionProvider"]
    )

    def decide_for(targets: int) -> Callable[[], Any]:
        seen = observation_of(problem, targets)
        given = {"pose": seen.pose, "mean": seen.mean, "information": seen.information}
        given = {name: np.asarray(value, np.float32)[None] for name, value in given.items()}
        given["present"] = np.asarray(seen.present)[None]
        return lambda: session.run(None, given)

    return _decisions("onnx", decide_for, repeats)


def planning(experiment: Experiment, repeats: int) -> list[Metric]:
    """Scenes a second for which the planner that knows the future makes a plan, from all its starts."""
    problem, settings = experiment.scenario.problem(), experiment.scenario.scenes
    scenes = [scene for scene in own_suite(settings, problem) if len(scene.targets) == 5][:PLANNED_SCENES]
    episodes = scene_episodes(problem, settings, scenes, seed=0, episodes=1)
    keys = jax.random.split(jax.random.key(0), len(scenes))

    def solve(episode: Episode, key: jax.Array) -> jax.Array:
        assert episode.truth is not None, "scene_episodes always draws the truth"
        information = first_information(problem, len(episode.mean))
        future = Future(episode.pose, episode.truth.state[1:], information, episode.present, episode.horizon)
        return plan(problem, future, OMNISCIENT["true"], key).score

    program = jax.jit(jax.vmap(solve))
    seconds = in_turn([lambda: program(episodes, keys)], repeats)[:, 0]
    rate = len(scenes) / float(np.median(seconds))
    return [
        Metric(
            key="planner_scenes_per_s", value=rate, unit="1/s", better="higher", per="matmul", spread=spread(seconds)
        )
    ]


def compiled(experiment: Experiment) -> list[Metric]:
    """Programs that one training compiles, and how many of them after its first check: each would be a surprise."""
    training = replace(experiment.training, epochs=5, check_every=2)
    before_and_after: list[int] = []
    with tempfile.TemporaryDirectory() as folder, compilations() as found:
        train(
            replace(experiment, training=training),
            Path(folder) / "run",
            report=lambda check, total: before_and_after.append(len(found)),
        )
    late = before_and_after[-1] - before_and_after[0]
    return [
        Metric(key="train_compilations", value=float(len(found)), unit="1", better="lower"),
        Metric(key="train_late_compilations", value=float(late), unit="1", better="lower"),
    ]


def _process(*arguments: str, cache: str | None = None) -> float:
    """Wall time of a process of this Python [s]. Raises ValueError with its last line where it fails."""
    places = {} if cache is None else {"JAX_COMPILATION_CACHE_DIR": cache}
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, *arguments], env={**os.environ, **places}, capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - began
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise InputError(f"{' '.join(arguments)}: ended with {done.returncode}: {last}")
    return seconds


def starting(repeats: int) -> list[Metric]:
    """What stands before every command: its help, and the import of all that training needs."""
    calls = {
        "help_s": ["-m", "foveate.cli.main", "--help"],
        "import_s": ["-c", "import foveate.learning.loop"],
    }
    seconds = in_turn([lambda call=call: _process(*call) for call in calls.values()], min(repeats, 5))
    return [
        Metric(
            key=key,
            value=float(np.median(column)),
            unit="s",
            better="lower",
            per="python",
            spread=spread(column.tolist()),
        )
        for key, column in zip(calls, seconds.T, strict=True)
    ]


def whole_process() -> list[Metric]:
    """`foveate train --preset paper` with an empty cache of compiled programs, and once more with the full one."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for name in ("cold", "warm"):
            train_it = ["-m", "foveate.cli.main", "train", "--preset", "paper", "--out", f"{folder}/{name}"]
            seconds = timed(lambda arguments=train_it: _process(*arguments, cache=f"{folder}/cache"))
            found.append(Metric(key=f"train_process_{name}_s", value=seconds, unit="s", better="lower", per="python"))
    return found
