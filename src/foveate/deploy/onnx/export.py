"""Export of a trained policy to ONNX, for robots without JAX (extra `onnx`).

The graph takes beliefs in metres and in the world frame, and returns a command in m/s and rad/s. Its metadata describe
inputs and output, and hold the matrices that predict a belief. `docs/deploy.md` describes both.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from foveate import __version__
from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.io.files import write_atomic
from foveate.models.problem import Problem
from foveate.policies.attention import AttentionPolicy
from foveate.policies.pointer import PointerPolicy
from foveate.simulation.records import Policy

if TYPE_CHECKING:
    from onnx import ModelProto

FORMAT, VERSION = "foveate-policy", 1
OPSETS = range(13, 25)
"""ONNX operator sets that a file can be written for; old runtimes support only old ones."""
DEFAULT_OPSET = 17
UNITS = {"v": "m/s", "w": "rad/s"}


class Input(NamedTuple):
    """One input of the graph, for b decisions and n targets."""

    name: str
    dtype: str
    shape: tuple[str | int, ...]
    meaning: str


def inputs_of(policy: Policy, problem: Problem) -> tuple[Input, ...]:
    """Inputs of a policy's graph in order: only those that it reads."""
    n_y, m_y = problem.motion.state_size, problem.motion.input_size
    if problem.agent.space.dimension == 2:
        pose_shape, pose = ("b", 3), "[x, y, yaw] [m, rad]"
    else:
        pose_shape, pose = ("b", 4, 4), "homogeneous transform T, body to world [m]"
    predicted = "predicted to the end of the coming step; begins with the position [m]"
    information = "inverse covariance of each target's state, predicted likewise"
    present = "false marks padding, which is ignored; all false is allowed"
    inputs = [
        Input("pose", "float32", pose_shape, f"the agent's pose in the world: {pose}"),
        Input("mean", "float32", ("b", "n", n_y), f"mean of each target's state in the world, {predicted}"),
        Input("information", "float32", ("b", "n", n_y, n_y), information),
        Input("present", "bool", ("b", "n"), present),
    ]
    if isinstance(policy, PointerPolicy):
        if m_y == problem.agent.space.dimension:
            known_input = "the known input xi that led to the prediction of each target; 0 where none is known"
            inputs.append(Input("known_input", "float32", ("b", "n", m_y), known_input))
        left = "steps until the end, this one too; a robot without an end gives the file's steps_left every time"
        inputs.append(Input("steps_left", "int64", ("b",), left))
    return tuple(inputs)


def metadata_of(experiment: Experiment, policy: Policy) -> dict[str, str]:
    """Metadata of the file: texts, all but the first four of them JSON."""
    scenes, problem = experiment.scenario.scenes, experiment.scenario.problem()
    agent, period, sensor = problem.agent, problem.period, problem.sensor
    axes = [agent.space.axes[axis] for axis in agent.axes]
    matrices = (period.tau, period.motion.A, period.motion.B, period.motion.W, period.V)
    steps = zip(*map(_plain, matrices), strict=True)
    model = {
        "Z": _plain(problem.motion.Z),
        "H": _plain(sensor.H),
        "V_frame": sensor.frame,
        "range_growth_per_m": sensor.range_growth,
        "prior_information": _plain(problem.prior_information),
        "steps": [dict(zip(("tau_s", "A", "B", "W", "V"), step, strict=True)) for step in steps],
    }
    output = {"name": "control", "frame": "body", "axes": axes, "units": [UNITS[axis[0]] for axis in axes]}
    structured = {
        "inputs": [each._asdict() for each in inputs_of(policy, problem)],
        "output": {**output, "lower": _plain(agent.lower), "upper": _plain(agent.upper)},
        "tau_s": period.tau.tolist()[0] if len(period.tau) == 1 else period.tau.tolist(),
        "trained_targets": [scenes.targets_min, scenes.targets_max],
        "steps_left": scenes.middle_steps_left,
        "model": model,
    }
    plain = {"format": FORMAT, "format_version": str(VERSION), "foveate_version": __version__}
    return {**plain, "policy": experiment.policy.kind} | {name: json.dumps(value) for name, value in structured.items()}


def to_onnx(experiment: Experiment, policy: Policy, opset: int = DEFAULT_OPSET) -> "ModelProto":
    """ONNX model of a policy: `inputs_of` in, the command of the actuated axes (b, m) [m/s, rad/s] out.

    Raises InputError for an opset that is not in `OPSETS`, a policy without an ONNX graph, and without the extra.
    """
    if opset not in OPSETS:
        raise InputError(f"opset = {opset}: expected from {OPSETS[0]} to {OPSETS[-1]}")
    try:
        from onnx import checker, helper
    except ImportError as error:
        raise InputError(f"exporting needs onnx ({error}): pip install 'foveate[onnx]'") from error
    from foveate.deploy.onnx.graph import Graph
    from foveate.deploy.onnx.networks import attention, pointer

    problem, graph = experiment.scenario.problem(), Graph()
    if isinstance(policy, AttentionPolicy):
        last = attention(graph, policy, problem.motion.state_size)
    elif isinstance(policy, PointerPolicy):
        last = pointer(graph, policy, problem.motion.state_size, problem.motion.input_size)
    else:
        raise InputError(f"{type(policy).__name__} has no ONNX graph: expected a policy that was trained")
    # lower + (1 + tanh) / 2 (upper - lower), exactly within the limits, as `Agent.control`.
    lower, upper = np.asarray(problem.agent.lower), np.asarray(problem.agent.upper)
    share = graph("Mul", graph("Add", graph("Tanh", last), 1.0), 0.5)
    command = graph("Add", graph("Mul", share, upper - lower), lower)
    graph("Min", graph("Max", command, lower), upper, output="control")

    inputs = [_value_info(*each) for each in inputs_of(policy, problem)]
    output = _value_info("control", "float32", ("b", len(problem.agent.axes)), "body-frame command [m/s, rad/s]")
    body = helper.make_graph(graph.nodes, "policy", inputs, [output], graph.constants)
    versions = [helper.make_opsetid("", opset)]
    least = helper.find_min_ir_version_for(versions)
    producer = {"producer_name": "foveate", "producer_version": __version__}
    model = helper.make_model(body, opset_imports=versions, ir_version=least, **producer)
    helper.set_model_props(model, metadata_of(experiment, policy))
    checker.check_model(model, full_check=True)
    return model


def export(experiment: Experiment, policy: Policy, path: Path, opset: int = DEFAULT_OPSET) -> None:
    """Write `to_onnx` to a file, whole or not at all. Raises InputError as it does."""
    write_atomic(path, to_onnx(experiment, policy, opset).SerializeToString())


def _value_info(name: str, dtype: str, shape: Sequence[str | int], meaning: str) -> Any:
    from onnx import TensorProto, helper

    kinds = {"float32": TensorProto.FLOAT, "int64": TensorProto.INT64, "bool": TensorProto.BOOL}
    return helper.make_tensor_value_info(name, kinds[dtype], shape, doc_string=meaning)


def _plain(array: Any) -> Any:
    """Lists of numbers, as exact as the array holds them."""
    return np.asarray(array, float).tolist()
