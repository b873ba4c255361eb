"""What a file computes, as a JAX function, and its inputs: beliefs in metres in, a command in m/s and rad/s out."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.export import symbolic_shape

from foveate.deploy.onnx.trace import NoRule, Shape, Trace, is_number, trace
from foveate.models.problem import Problem
from foveate.models.robot import Robot, Surroundings
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


def rays_of(policy: Policy) -> int:
    """Number of rays along which a policy is told free ranges; 0 for one that knows of no obstacles."""
    return getattr(policy, "rays", 0)


def possible_inputs(problem: Problem, rays: int = 0) -> tuple[Input, ...]:
    """All that a policy may read, in order; with `rays` also what it is told of obstacles (`Surroundings`)."""
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
        *(_inputs_of_obstacles(problem.agent.space.dimension, rays) if rays else ()),
    )


def _inputs_of_obstacles(dimension: int, rays: int) -> tuple[Input, ...]:
    """What a policy with rays is told of obstacles."""
    place = "where to drive next, straight ahead, on the way around obstacles to each target's mean, in the world [m]"
    ranges = "free range along each of the metadata's rays, at most their longest [m]"
    straight = "true where the way is a straight line, and way_place the mean's position"
    return (
        Input("ranges", "float32", ("b", rays), ranges),
        Input("way_place", "float32", ("b", "n", dimension), place),
        Input("way_length", "float32", ("b", "n"), "length of the whole way [m]"),
        Input("is_straight", "bool", ("b", "n"), straight),
        Input("is_seen", "bool", ("b", "n"), "true where no obstacle is on the line to the target's mean"),
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

        rays = rays_of(policy)

        def decide(pose, mean, information, present, known_input, left, step, *around):
            # Whatever padding holds, NaN too, must not reach the command.
            mean, known_input = (jnp.where(present[:, None], x, 0.0) for x in (mean, known_input))
            information = jnp.where(present[:, None, None], information, problem.prior_information)
            seen = Observation(step, left, pose, mean, information, present, known_input, robot.at(step))
            seen = replace(seen, surroundings=_surroundings(present, *around) if around else None)
            memory = policy.start(seen)
            if jax.tree.leaves(memory):
                raise NoRule("a memory from one decision to the next")
            return problem.agent.control(policy(seen, memory, jax.random.key(0))[0])

        sizes = dict(zip("bn", symbolic_shape("b, n"), strict=True))
        inputs = [
            jax.ShapeDtypeStruct([sizes.get(str(size), size) for size in each.shape], types[each.dtype])
            for each in possible_inputs(problem, rays)
        ]
        return trace(jax.vmap(decide), inputs, KEPT)


def _surroundings(present, ranges, place_world, length, is_straight, is_seen) -> Surroundings:
    """Surroundings of which padding is finite."""
    place_world = jnp.where(present[:, None], place_world, 1.0)
    return Surroundings(ranges, place_world, jnp.where(present, length, 1.0), is_straight, is_seen)


def _single(leaf: Any) -> Any:
    """An array in single precision; anything else as it is."""
    if not isinstance(leaf, np.ndarray | jax.Array):
        return leaf
    return jnp.asarray(leaf, {"f": jnp.float32, "i": jnp.int32}.get(leaf.dtype.kind, leaf.dtype))
