"""The policy that a node runs, and the robot that it was trained for: from an ONNX file, a run folder or a preset."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from foveate.api import load
from foveate.deploy.belief import Belief
from foveate.deploy.exported import load_exported
from foveate.deploy.onnx.session import Session, open_file
from foveate.deploy.policy import RobotPolicy
from foveate.errors import InputError
from foveate.io.validate import require
from foveate.models.obstacles import Obstacles
from foveate.ros.records import AXES
from foveate.scenario.scenario import Scenario

Pose = Float[np.ndarray, "..."]
Decide = Callable[[Belief, Pose], Float[np.ndarray, " m"]]
INPUTS = ("pose", "mean", "information", "present", "known_input", "steps_left", "step")
"""Inputs of a file that a node can give."""
MOST_TARGETS = 64
"""Targets for which a policy in JAX is compiled before the robot drives; with more it compiles again."""


@dataclass(frozen=True, kw_only=True)
class RobotModel:
    """A policy by its name: `decide` maps a predicted belief and a pose to the command of `axes` [m/s, rad/s].

    `in_map` makes the `decide` of another map; None where the policy knows of none.
    """

    name: str
    scenario: Scenario
    axes: tuple[str, ...]
    decide: Decide
    in_map: Callable[[Obstacles], Decide] | None = None

    def __post_init__(self) -> None:
        require(set(self.axes) <= set(AXES), "axes", self.axes, f"expected some of {', '.join(AXES)}")
        scenario, problem = self.scenario, self.scenario.problem().of_one_kind()
        if problem.schedule is not None:
            raise InputError(f"{self.name}: its scenario has a schedule: a node runs at one period tau_s")
        H, Z = (np.asarray(x, float) for x in (problem.sensor.H, problem.motion.Z))
        if len(H) != scenario.dimension or np.abs(H @ np.linalg.pinv(Z) @ Z - H).max() > 1e-9:
            raise InputError(f"{self.name}: its sensor does not measure positions, which are what a node receives")


def load_model(source: str, number: int | None = None) -> RobotModel:
    """Load a policy for a node. Raises InputError for a file without its scenario, as foveate 0.1 wrote it.

    `number` is that of the robot in a team of different kinds, where it must be given; a file is of one kind already. A
    policy in JAX is compiled here, which takes seconds, so that no decision has to wait.
    """
    if source.endswith(".onnx"):
        return _of_file(source)
    policy = load(source)
    if number is None and len(policy.problem.kinds) > 1:
        raise InputError("number: is missing: expected that of this robot in its team of different kinds, from 0")
    return _in_jax(policy.for_robot(number or 0))


def _in_jax(policy: RobotPolicy) -> RobotModel:
    def decide(belief: Belief, pose: Pose) -> Float[np.ndarray, " m"]:
        return policy(belief.padded(MOST_TARGETS), pose)

    def in_map(obstacles: Obstacles) -> Decide:
        return _in_jax(replace(policy, obstacles=obstacles)).decide

    model = RobotModel(name=policy.name, scenario=policy.scenario, axes=policy.axes, decide=decide, in_map=in_map)
    size, d = policy.problem.motion.state_size, policy.scenario.dimension
    decide(Belief(np.zeros((0, size)), covariance=np.zeros((0, size, size))), np.zeros(3) if d == 2 else np.eye(4))
    policy.reset()
    return model


def _of_file(path: str) -> RobotModel:
    """The policy of a file: without JAX, but for a policy with rays, whose map is looked up in JAX."""
    session = open_file(path)
    if session.rays:
        return _in_jax(load_exported(path))
    if unknown := [name for name in session.wanted if name not in INPUTS]:
        raise InputError(f"{path}: its policy reads {', '.join(unknown)}, which a node does not have")
    return RobotModel(name=path, scenario=session.scenario, axes=session.axes, decide=_by(session))


def _by(session: Session) -> Decide:
    inputs_of_state, left = int(session.wanted.get("known_input", (0,))[-1]), int(session.facts["steps_left"])

    def decide(belief: Belief, pose: Pose) -> Float[np.ndarray, " m"]:
        known = np.zeros((len(belief.mean), inputs_of_state)) if belief.known_input is None else belief.known_input
        inputs = {
            "pose": np.asarray(pose, np.float32),
            "mean": belief.mean.astype(np.float32),
            "information": belief.information.astype(np.float32),
            "present": belief.present,
            "known_input": known.astype(np.float32),
            "steps_left": np.array(left, np.int64),
            "step": np.array(0, np.int64),
        }
        control = session.commands({name: value[None] for name, value in inputs.items()})
        if not np.isfinite(control).all():
            raise InputError("belief, pose: expected numbers that float32 can hold, also squared")
        return control[0].astype(float)

    return decide
