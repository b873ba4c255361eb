"""The policy that a node runs, and the robot that it was trained for: from an ONNX file, a run folder or a preset."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from foveate.api import load
from foveate.deploy.belief import Belief
from foveate.deploy.onnx.export import FORMAT, NO_DIGEST, VERSION
from foveate.errors import InputError
from foveate.io.files import read_bytes
from foveate.io.records import from_table
from foveate.io.validate import require
from foveate.ros.records import AXES
from foveate.scenario.scenario import Scenario

Pose = Float[np.ndarray, "..."]
INPUTS = ("pose", "mean", "information", "present", "known_input", "steps_left", "step")
"""Inputs of a file that a node can give."""
MOST_TARGETS = 64
"""Targets for which a policy in JAX is compiled before the robot drives; with more it compiles again."""


@dataclass(frozen=True, kw_only=True)
class RobotModel:
    """A policy by its name: `decide` maps a predicted belief and a pose to the command of `axes` [m/s, rad/s]."""

    name: str
    scenario: Scenario
    axes: tuple[str, ...]
    decide: Callable[[Belief, Pose], Float[np.ndarray, " m"]]

    def __post_init__(self) -> None:
        require(set(self.axes) <= set(AXES), "axes", self.axes, f"expected some of {', '.join(AXES)}")
        scenario, problem = self.scenario, self.scenario.problem()
        if problem.schedule is not None:
            raise InputError(f"{self.name}: its scenario has a schedule: a node runs at one period tau_s")
        H, Z = (np.asarray(x, float) for x in (problem.sensor.H, problem.motion.Z))
        if len(H) != scenario.dimension or np.abs(H @ np.linalg.pinv(Z) @ Z - H).max() > 1e-9:
            raise InputError(f"{self.name}: its sensor does not measure positions, which are what a node receives")


def load_model(source: str) -> RobotModel:
    """Load a policy for a node. Raises InputError for a file without its scenario, as foveate 0.1 wrote it.

    A policy in JAX is compiled here, which takes seconds, so that no decision has to wait.
    """
    if source.endswith(".onnx"):
        return _of_file(source)
    policy = load(source)

    def decide(belief: Belief, pose: Pose) -> Float[np.ndarray, " m"]:
        return policy(belief.padded(MOST_TARGETS), pose)

    model = RobotModel(name=source, scenario=policy.scenario, axes=policy.axes, decide=decide)
    size, d = policy.problem.motion.state_size, policy.scenario.dimension
    decide(Belief(np.zeros((0, size)), covariance=np.zeros((0, size, size))), np.zeros(3) if d == 2 else np.eye(4))
    policy.reset()
    return model


def _of_file(path: str) -> RobotModel:
    try:
        import onnxruntime
    except ImportError as error:
        raise InputError(f"{path}: needs onnxruntime ({error}): pip install onnxruntime") from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # a network this small is slower on several threads
    data = read_bytes(path, "ONNX file")
    try:
        session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has an exception of its own for everything
        raise InputError(f"{path}: is no ONNX file: {str(error)[:200]}") from None
    facts = session.get_modelmeta().custom_metadata_map
    if (facts.get("format"), facts.get("format_version")) != (FORMAT, str(VERSION)) or "scenario" not in facts:
        raise InputError(f"{path}: has no scenario in it: expected a file of foveate export by this version or a later")
    before, said, after = data.rpartition(facts.get("sha256", "").encode())
    if hashlib.sha256(before + NO_DIGEST.encode() + after).hexdigest().encode() != said:
        raise InputError(f"{path}: is damaged or was changed: it does not fit its digest; export it again")
    scenario = from_table(Scenario, json.loads(facts["scenario"]), path)
    if unknown := [each.name for each in session.get_inputs() if each.name not in INPUTS]:
        raise InputError(f"{path}: its policy reads {', '.join(unknown)}, which a node does not have")
    return RobotModel(
        name=path,
        scenario=scenario,
        axes=tuple(json.loads(facts["output"])["axes"]),
        decide=_session(session, int(facts["steps_left"])),
    )


def _session(session: Any, steps_left: int) -> Callable[[Belief, Pose], Float[np.ndarray, " m"]]:
    wanted = [each.name for each in session.get_inputs()]
    inputs_of_state = next((each.shape[-1] for each in session.get_inputs() if each.name == "known_input"), 0)

    def decide(belief: Belief, pose: Pose) -> Float[np.ndarray, " m"]:
        known = np.zeros((len(belief.mean), inputs_of_state)) if belief.known_input is None else belief.known_input
        inputs = {
            "pose": np.asarray(pose, np.float32),
            "mean": belief.mean.astype(np.float32),
            "information": belief.information.astype(np.float32),
            "present": belief.present,
            "known_input": known.astype(np.float32),
            "steps_left": np.array(steps_left, np.int64),
            "step": np.array(0, np.int64),
        }
        (control,) = session.run(["control"], {name: inputs[name][None] for name in wanted})
        if not np.isfinite(control).all():
            raise InputError("belief, pose: expected numbers that float32 can hold, also squared")
        return control[0].astype(float)

    return decide
