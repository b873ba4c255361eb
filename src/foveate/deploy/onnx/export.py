"""Export of a trained policy to ONNX, for robots without JAX (extra `onnx`).

The graph is translated from what JAX traces of the policy (`decision`), so that no network is written a second time. It
takes beliefs in metres and in the world frame, and returns a command in m/s and rad/s. Its metadata describe inputs and
output, and hold the matrices that predict a belief. `docs/deploy.md` describes both.
"""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foveate import __version__
from foveate.deploy.onnx.decision import Input, possible_inputs, rays_of, trace_decisions
from foveate.deploy.onnx.trace import NoRule
from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.geometry.sight import fan
from foveate.io.files import write_atomic
from foveate.io.records import to_table
from foveate.models.problem import Problem
from foveate.policies.attention import AttentionPolicy
from foveate.policies.pointer import PointerPolicy
from foveate.policies.surroundings import RANGE_DEPTHS
from foveate.policies.tokens import STANDOFF
from foveate.scenario.scenario import Scenario
from foveate.scenario.target import LinearTarget
from foveate.simulation.records import Policy

if TYPE_CHECKING:
    from onnx import ModelProto

    from foveate.deploy.onnx.graph import Graph

FORMAT, VERSION = "foveate-policy", 1
OPSETS = range(13, 25)
"""ONNX operator sets that a file can be written for; old runtimes support only old ones."""
DEFAULT_OPSET = 17
NO_DIGEST = "0" * 64
"""Place of a file's digest in its metadata: `sha256` is that of the file with zeros in its place."""
UNITS = {"v": "m/s", "w": "rad/s"}


def inputs_of(policy: Policy, problem: Problem) -> tuple[Input, ...]:
    """Inputs of a policy's graph in order: only those that it reads."""
    return _graph(policy, problem, DEFAULT_OPSET)[1]


def metadata_of(
    experiment: Experiment, inputs: Sequence[Input], rays: int = 0, heuristic: str | None = None
) -> dict[str, str]:
    """Metadata of a file with these inputs: texts, all but the first five of them JSON.

    `heuristic` is the name of a policy that is not the experiment's.
    """
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
    if (polar := sensor.polar) is not None:
        model |= {"measures": list(polar.coordinates), "growth_per_m": list(polar.growth_per_m)}
        model = {name: value for name, value in model.items() if name not in ("V_frame", "range_growth_per_m")}
    output: dict[str, Any] = {"name": "control", "frame": "body", "axes": axes}
    output["units"] = [UNITS[axis[0]] for axis in axes]
    if agent.commands is not None:
        output["commands"] = _plain(agent.commands)
    structured = {
        "inputs": [each._asdict() for each in inputs],
        "output": {**output, "lower": _plain(agent.lower), "upper": _plain(agent.upper)},
        "tau_s": period.tau.tolist()[0] if len(period.tau) == 1 else period.tau.tolist(),
        "trained_targets": [scenes.targets_min, scenes.targets_max],
        "steps_left": scenes.middle_steps_left,
        "state": state_names(experiment.scenario),
        "scenario": to_table(experiment.scenario),
        "model": model,
    }
    if rays:
        structured["rays"] = _rays_of(problem, rays)
    plain = {"format": FORMAT, "format_version": str(VERSION), "foveate_version": __version__}
    plain |= {"policy": heuristic or experiment.policy.kind, "objective": experiment.training.objective}
    return plain | {name: json.dumps(value) for name, value in structured.items()}


def _rays_of(problem: Problem, rays: int) -> dict[str, Any]:
    """Unit vectors of the rays in the body frame, their longest range, and where ways end before a target [m]."""
    depth = float(problem.sensor.view.extent.ahead_m)
    directions = fan(rays, problem.agent.space.dimension)
    return {"directions": _plain(directions), "longest_m": RANGE_DEPTHS * depth, "standoff_m": STANDOFF * depth}


def state_names(scenario: Scenario) -> list[str] | None:
    """Names of a state's numbers, as x, y, vx, vy; None where it is not positions and their derivatives."""
    axes, motion = "xyz"[: scenario.dimension], scenario.problem().motion
    if not motion.begins_with_position or isinstance(scenario.target, LinearTarget):
        return None
    return [prefix + axis for prefix in ("", "v", "a")[: motion.state_size // len(axes)] for axis in axes]


def to_onnx(experiment: Experiment, policy: Policy, opset: int = DEFAULT_OPSET) -> "ModelProto":
    """ONNX model of a policy: `inputs_of` in, the command of the actuated axes (b, m) [m/s, rad/s] out.

    Raises InputError for an opset that is not in `OPSETS`, a policy that has no ONNX graph, and without the extra.
    """
    return _model(experiment, policy, opset)[0]


def export(experiment: Experiment, policy: Policy, path: Path, opset: int = DEFAULT_OPSET) -> tuple[Input, ...]:
    """Write `to_onnx` to a file, whole or not at all; return its inputs. Raises InputError as it does."""
    model, inputs = _model(experiment, policy, opset)
    write_atomic(path, sealed(model))
    return inputs


def sealed(model: "ModelProto") -> bytes:
    """A model as a file with its digest, by which `examples/run_onnx.py` notices any change."""
    from onnx import helper

    facts = {each.key: each.value for each in model.metadata_props}
    helper.set_model_props(model, {**facts, "sha256": NO_DIGEST})
    data = model.SerializeToString()
    before, zeros, after = data.rpartition(NO_DIGEST.encode())  # metadata come after the weights
    assert zeros, "the digest has a place"
    return before + hashlib.sha256(data).hexdigest().encode() + after


def _model(experiment: Experiment, policy: Policy, opset: int) -> "tuple[ModelProto, tuple[Input, ...]]":
    if opset not in OPSETS:
        raise InputError(f"opset = {opset}: expected from {OPSETS[0]} to {OPSETS[-1]}")
    problem = experiment.scenario.problem().of_one_kind()
    heuristic = None if isinstance(policy, PointerPolicy | AttentionPolicy) else type(policy).__name__
    reads_map = heuristic or (isinstance(policy, PointerPolicy) and policy.window_log_weight is not None)
    if problem.obstacles is not None and reads_map:
        raise InputError(f"{heuristic or 'the dynamic window'} reads the map: expected a scenario without obstacles")
    graph, inputs = _graph(policy, problem, opset)
    from onnx import checker, helper

    output = _value_info("control", "float32", ("b", len(problem.agent.axes)), "body-frame command [m/s, rad/s]")
    body = helper.make_graph(graph.nodes, "policy", [_value_info(*each) for each in inputs], [output], graph.constants)
    versions = [helper.make_opsetid("", opset)]
    least = helper.find_min_ir_version_for(versions)
    producer = {"producer_name": "foveate", "producer_version": __version__}
    model = helper.make_model(body, opset_imports=versions, ir_version=least, **producer)
    helper.set_model_props(model, metadata_of(experiment, inputs, rays_of(policy), heuristic))
    checker.check_model(model, full_check=True)
    return model, inputs


def _graph(policy: Policy, problem: Problem, opset: int) -> "tuple[Graph, tuple[Input, ...]]":
    """Nodes of a policy, and the inputs that they read."""
    try:
        import onnx  # noqa: F401  # asked for here, where its absence has a message

        from foveate.deploy.onnx.graph import Graph
        from foveate.deploy.onnx.translate import translate
    except ImportError as error:
        raise InputError(f"exporting needs onnx ({error}): pip install 'foveate[onnx]'") from error
    graph, inputs = Graph(opset), possible_inputs(problem, rays_of(policy))
    try:
        decisions = trace_decisions(policy, problem)
        graph.finish(translate(graph, decisions, [each.name for each in inputs]), "control")
    except NoRule as error:
        raise InputError(f"{type(policy).__name__} has no ONNX graph: it needs {error}") from error
    return graph, tuple(each for each in inputs if graph.reads(each.name))


def _value_info(name: str, dtype: str, shape: Sequence[str | int], meaning: str) -> Any:
    from onnx import TensorProto, helper

    kinds = {"float32": TensorProto.FLOAT, "int64": TensorProto.INT64, "bool": TensorProto.BOOL}
    return helper.make_tensor_value_info(name, kinds[dtype], shape, doc_string=meaning)


def _plain(array: Any) -> Any:
    """Lists of numbers, as exact as the array holds them."""
    return np.asarray(array, float).tolist()
