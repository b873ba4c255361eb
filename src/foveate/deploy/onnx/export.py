"""A trained policy as an ONNX file, for robots without JAX (extra `onnx`).

The graph takes beliefs in metres and in the world frame, and returns a command in m/s and rad/s: all that a policy
computes from its observation is inside. Its metadata describe inputs and output, and hold the matrices that predict a
belief. `docs/deploy.md` describes both.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
"""ONNX operator sets that a file can be written for; old runtimes know only old ones."""


DEFAULT_OPSET = 17


UNITS = {"v": "m/s", "w": "rad/s"}


@dataclass(frozen=True, kw_only=True)
class Input:
    """One input of the graph, for b decisions and n targets."""

    name: str
    dtype: str
    shape: tuple[str | int, ...]
    meaning: str


def inputs_of(policy: Policy, problem: Problem) -> tuple[Input, ...]:
    """Inputs of a policy's graph in order: only those that it reads."""
    planar = problem.agent.space.dimension == 2
    n_y, m_y = problem.motion.state_size, problem.motion.input_size
    poses = "[x, y, yaw] [m, rad]" if planar else "homogeneous transform T, body to world [m]"
    inputs = [
        Input(
            name="pose",
            dtype="float32",
            shape=("b", 3) if planar else ("b", 4, 4),
            meaning=f"the agent's pose in the world: {poses}",
        ),
        Input(
            name="mean",
            dtype="float32",
            shape=("b", "n", n_y),
            meaning="mean of each target's state in the world, predicted to the end of the coming step; begins with "
            "the position [m]",
        ),
        Input(
            name="information",
            dtype="float32",
            shape=("b", "n", n_y, n_y),
            meaning="inverse covariance of each target's state, predicted likewise",
        ),
        Input(
            name="present",
            dtype="bool",
            shape=("b", "n"),
            meaning="false marks padding, which is ignored; all false is allowed",
        ),
    ]
    if isinstance(policy, PointerPolicy):
        if m_y == problem.agent.space.dimension:
            meaning = "the known input xi that led to the prediction of each target; 0 where none is known"
            inputs.append(Input(name="known_input", dtype="float32", shape=("b", "n", m_y), meaning=meaning))
        meaning = "steps until the end, this one too; a robot without an end gives the file's steps_left every time"
        inputs.append(Input(name="steps_left", dtype="int64", shape=("b",), meaning=meaning))
    return tuple(inputs)


def metadata_of(experiment: Experiment, policy: Policy) -> dict[str, str]:
    """The metadata of the file: texts, all but the first four of them JSON."""
    scenario = experiment.scenario
    problem = scenario.problem()
    agent, period = problem.agent, problem.period
    axes = [agent.space.axes[axis] for axis in agent.axes]
    steps = [
        {"tau_s": tau, "A": A, "B": B, "W": W, "V": V}
        for tau, A, B, W, V in zip(
            *map(_plain, (period.tau, period.motion.A, period.motion.B, period.motion.W, period.V)), strict=True
        )
    ]
    model = {
        "Z": _plain(problem.motion.Z),
        "H": _plain(problem.sensor.H),
        "V_frame": problem.sensor.frame,
        "range_growth_per_m": problem.sensor.range_growth,
        "prior_information": _plain(problem.prior_information),
        "steps": steps,
    }
    output = {
        "name": "control",
        "frame": "body",
        "axes": axes,
        "units": [UNITS[axis[0]] for axis in axes],
        "lower": _plain(agent.lower),
        "upper": _plain(agent.upper),
    }
    structured = {
        "inputs": [vars(each) for each in inputs_of(policy, problem)],
        "output": output,
        "tau_s": period.tau.tolist()[0] if len(period.tau) == 1 else period.tau.tolist(),
        "trained_targets": [scenario.scenes.targets_min, scenario.scenes.targets_max],
        "steps_left": scenario.scenes.middle_steps_left,
        "model": model,
    }
    plain = {
        "format": FORMAT,
        "format_version": str(VERSION),
        "foveate_version": __version__,
        "policy": experiment.policy.kind,
    }
    return plain | {name: json.dumps(value) for name, value in structured.items()}


def to_onnx(experiment: Experiment, policy: Policy, opset: int = DEFAULT_OPSET) -> "ModelProto":
    """ONNX model of a policy: `inputs_of` in, the command of the actuated axes (b, m) [m/s, rad/s] out.

    Raises InputError for an opset that is not in `OPSETS`, a policy that has no ONNX graph here, and where the extra is
    missing.
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
    _command(graph, last, np.asarray(problem.agent.lower), np.asarray(problem.agent.upper))

    inputs = [_value_info(each.name, each.dtype, each.shape, each.meaning) for each in inputs_of(policy, problem)]
    command = _value_info("control", "float32", ("b", len(problem.agent.axes)), "body-frame command [m/s, rad/s]")
    body = helper.make_graph(graph.nodes, "policy", inputs, [command], graph.constants)
    version = helper.make_opsetid("", opset)
    model = helper.make_model(
        body,
        opset_imports=[version],
        ir_version=helper.find_min_ir_version_for([version]),
        producer_name="foveate",
        producer_version=__version__,
    )
    helper.set_model_props(model, metadata_of(experiment, policy))
    checker.check_model(model, full_check=True)
    return model


def export(experiment: Experiment, policy: Policy, path: Path, opset: int = DEFAULT_OPSET) -> None:
    """Write `to_onnx` to a file, whole or not at all. Raises InputError as it does."""
    write_atomic(path, to_onnx(experiment, policy, opset).SerializeToString())


def _command(graph: Any, last: str, lower: np.ndarray, upper: np.ndarray) -> None:
    """lower + (1 + tanh) / 2 (upper - lower), exactly within the limits, as `Agent.control`."""
    share = graph("Mul", graph("Add", graph("Tanh", last), 1.0), 0.5)
    command = graph("Add", graph("Mul", share, upper - lower), lower)
    graph("Min", graph("Max", command, lower), upper, output="control")


def _value_info(name: str, dtype: str, shape: Sequence[str | int], meaning: str) -> Any:
    from onnx import TensorProto, helper

    kinds = {"float32": TensorProto.FLOAT, "int64": TensorProto.INT64, "bool": TensorProto.BOOL}
    return helper.make_tensor_value_info(name, kinds[dtype], shape, doc_string=meaning)


def _plain(array: Any) -> Any:
    """Lists of numbers, as exact as the array holds them."""
    return np.asarray(array, float).tolist()
