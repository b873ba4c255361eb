"""Time one decision by the number of targets, in JAX and in ONNX Runtime."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from foveate.bench.timing import Metric, in_turn, time_metric
from foveate.experiment.experiment import Experiment
from foveate.models.problem import Problem
from foveate.models.robot import Robot
from foveate.simulation.records import Observation, Policy

TARGETS = (1, 8, 64, 1000)
"""Numbers of targets for which a decision is timed."""


def observation_of(problem: Problem, targets: int) -> Observation:
    """Return an observation of `targets` random beliefs."""
    rng, n_y = np.random.default_rng(targets), problem.motion.state_size
    return Observation(
        step=jnp.zeros((), int),
        left=jnp.array(10),
        pose=problem.agent.space.identity(),
        mean=jnp.asarray(rng.normal(0.0, 5.0, (targets, n_y)), jnp.float32),
        information=jnp.asarray(np.broadcast_to(np.eye(n_y), (targets, n_y, n_y)), jnp.float32),
        present=jnp.ones(targets, bool),
        known_input=jnp.zeros((targets, problem.motion.input_size), jnp.float32),
        robot=Robot.of(problem),
    )


def jax_decisions(experiment: Experiment, repeats: int) -> list[Metric]:
    """Time decisions of the paper's network, compiled by JAX."""
    problem, key = experiment.scenario.problem(), jax.random.key(0)
    policy: Policy = experiment.new_policy(key)
    decide = jax.jit(lambda observation, key: policy(observation, (), key)[0])
    return _decisions("jax", problem, lambda observation: lambda: decide(observation, key), repeats)


def onnx_decisions(experiment: Experiment, repeats: int) -> list[Metric]:
    """Time decisions of the exported network by ONNX Runtime, on one thread; nothing where the extra is missing."""
    try:
        import onnxruntime
    except ImportError:
        return []
    from foveate.deploy.onnx.export import to_onnx

    problem = experiment.scenario.problem()
    policy = experiment.new_policy(jax.random.key(0))
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    model = to_onnx(experiment, policy).SerializeToString()
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])

    def decide_on(observation: Observation) -> Callable[[], Any]:
        numbers = {name: getattr(observation, name) for name in ("pose", "mean", "information")}
        inputs = {name: np.asarray(value, np.float32)[None] for name, value in numbers.items()}
        inputs["present"] = np.asarray(observation.present)[None]
        return lambda: session.run(None, inputs)

    return _decisions("onnx", problem, decide_on, repeats)


def _decisions(
    name: str, problem: Problem, decide_on: Callable[[Observation], Callable[[], Any]], repeats: int
) -> list[Metric]:
    """Time one decision, called alone and waited for, by the number of targets."""
    metrics = []
    for targets in TARGETS:
        # A decision takes microseconds: many are timed at once.
        decide, calls = decide_on(observation_of(problem, targets)), max(20, 4000 // targets)

        def decide_all(decide=decide, calls=calls) -> None:
            for _ in range(calls):
                jax.block_until_ready(decide())

        seconds = in_turn([decide_all], repeats)[:, 0] / calls
        metrics.append(time_metric(f"decision_{name}_us_{targets}", seconds, unit="us"))
    return metrics
