"""What a file computes, as a JAX function, and its inputs: beliefs in metres in, a command in m/s and rad/s out."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.export import symbolic_shape

from foveate.deploy.onnx.trace import NoRule, Shape, Trace, is_number, trace
from foveate.models.problem import Problem
from foveate.models.robot import Robot
from foveate.simulation.records import Observation, Policy


def _is_alike(inputs: Sequence[Shape], outputs: Sequence[Shape]) -> bool:
    return len({*inputs, *outputs}) == 1


def _is_of_matrices(inputs: Sequence[Shape], outputs: Sequence[Shape]) -> bool:
    """True if it can be told which axes are those of the matrices: `vmap` puts its own anywhere."""
    (shape,), (result,) = inputs, outputs
    free = [size for size in shape if not is_number(size)]
    return len(shape) == len(free) + 2 and len(set(free)) == len(free) and set(free) <= set(result)


KEPT = {"hypot": _is_alike, "inverse_spd": _is_of_matrices, "log_det_spd": _is_of_matrices}
"""Functions with a rule of their own, where their arguments and results have such shapes.

ONNX has something shorter than what JAX makes of them.
"""


class Input(NamedTuple):
    """One input of the graph, for b decisions and n targets."""

    name: str
    dtype: str
    shape: tuple[str | int, ...]
    meaning: str


def possible_inputs(problem: Problem) -> tuple[Input, ...]:
    """All that a policy may read, in order."""
    n_y, m_y = problem.motion.state_size, problem.motion.input_size
    if problem.agent.space.dimension == 2:
        pose_shape, pose = ("b", 3), "[x, y, yaw] [m, rad]"
    else:
        pose_shape, pose = ("b", 4, 4), "homogeneous transform T, body to world [m]"
    predicted = "predicted to the end of the coming step; begins with the position [m]"
    information = "inverse covariance of each target's state, predicted likewise"
    present = "false marks padding, which is ignored; all false is allowed"
    known_input = "the known input xi that led to the prediction of each target; 0 where none is known"
    left = "steps until the end, this one too; a robot without an end gives the file's steps_left every time"
    step = "number of the coming step, from 0: selects the entry of model.steps that holds"
    return (
        Input("pose", "float32", pose_shape, f"the agent's pose in the world: {pose}"),
        Input("mean", "float32", ("b", "n", n_y), f"mean of each target's state in the world, {predicted}"),
        Input("information", "float32", ("b", "n", n_y, n_y), information),
        Input("present", "bool", ("b", "n"), present),
        Input("known_input", "float32", ("b", "n", m_y), known_input),
        Input("steps_left", "int64", ("b",), left),
        Input("step", "int64", ("b",), step),
    )


def trace_decisions(policy: Policy, problem: Problem) -> Trace:
    """Trace b decisions about n targets: from `possible_inputs` to commands (b, m), in float32.

    All of the robot is constant, except for what a schedule changes from step to step. Raises NoRule for
    policies that draw random numbers, or have a memory.
    """
    types = {"float32": jnp.float32, "int64": jnp.int32, "bool": jnp.bool_}
    with jax.enable_x64(False):
        policy, problem = (jax.tree.map(_single, tree) for tree in (policy, problem))
        robot = Robot.of(problem)

        def decide(pose, mean, information, present, known_input, left, step):
            # Whatever padding holds, NaN too, must not reach the command.
            mean, known_input = (jnp.where(present[:, None], x, 0.0) for x in (mean, known_input))
            information = jnp.where(present[:, None, None], information, problem.prior_information)
            seen = Observation(step, left, pose, mean, information, present, known_input, robot.at(step))
            memory = policy.start(seen)
            if jax.tree.leaves(memory):
                raise NoRule("a memory from one decision to the next")
            return problem.agent.control(policy(seen, memory, jax.random.key(0))[0])

        sizes = dict(zip("bn", symbolic_shape("b, n"), strict=True))
        inputs = [
            jax.ShapeDtypeStruct([sizes.get(str(size), size) for size in each.shape], types[each.dtype])
            for each in possible_inputs(problem)
        ]
        return trace(jax.vmap(decide), inputs, KEPT)


def _single(leaf: Any) -> Any:
    """An array in single precision; anything else as it is."""
    if not isinstance(leaf, np.ndarray | jax.Array):
        return leaf
    return jnp.asarray(leaf, {"f": jnp.float32, "i": jnp.int32}.get(leaf.dtype.kind, leaf.dtype))
