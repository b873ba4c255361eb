"""Tokens: what a pointer network is told of each target, in units that mean the same for every robot.

Lengths are in depths of the view, turns in its half angle, speeds in steps, information in that of a measurement. So
decisions do not depend on the world's origin or scale. What differs between robots and tasks is told in as many numbers
for all: a network serves every robot of its space. Each token also has the steering law's action towards its target:
aiming is computed, only deciding is learned.
"""

from collections.abc import Collection
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from foveate.errors import InputError
from foveate.geometry.linalg import cholesky_spd, inverse_spd, log_det_spd, multiply, symmetrise
from foveate.io.validate import require
from foveate.models.belief import predict_information
from foveate.models.problem import Problem
from foveate.models.robot import Robot
from foveate.names import Objective
from foveate.policies.steering import steer, steps_to_view, view_sizes, view_units
from foveate.policies.surroundings import place_features, ways_of, ways_size
from foveate.policies.team_tokens import TEAM_FEATURES, team_tokens
from foveate.simulation.records import Observation
from foveate.types import Scalar

STANDOFF = 0.5
"""Where the steering law ends, in depths of the view: a target may then move either way."""

CROWD_DEPTHS = (0.5, 2.0)
"""Radii, in depths of the view, within which a target's neighbours are counted."""

TIMES_LEFT = (3.0, 10.0, 40.0)
"""Scales [steps] on which the time left is told."""

SEARCH_FEATURES = 3
"""Further features where detections have no ids (`policies.places`)."""

WINDOW_FEATURES = 2
"""Further features of a network that is told the dynamic window (`policies.window`)."""


class Tokens(NamedTuple):
    """Features of each target, the steering law's action towards it, and the measures of the heuristics.

    `urgency` are log det of the information [nat], and the steps until the target is in view, on which the first
    preference among targets is based, in a team also 1 for targets of others; `unit` is one view in each axis's action
    (`view_units`). Actions have a number for every axis of the twist, 0 for those that the robot lacks. `window` is the
    dynamic window's action, for networks that are told it.
    """

    features: Float[Array, "n features"]
    aim: Float[Array, "n n_u"]
    urgency: Float[Array, "n measures"]
    unit: Float[Array, " n_u"]
    present: Bool[Array, " n"]
    window: Float[Array, " n_u"] | None = None


def tokens_of(
    observation: Observation,
    objective: Objective,
    tells_time: bool,
    tells_team: bool = False,
    rays: int = 0,
    standoff: float = STANDOFF,
) -> Tokens:
    """The tokens of an observation; without `tells_time` as if there were no end, without `rays` as if in the open.

    `tells_team`: of a team's robot. `standoff` is where the steering law ends, in depths of the view.
    """
    robot = observation.robot
    if robot is None:
        raise InputError("observation.robot = None: expected the robot, which this policy asks for")
    problem, extent, present = robot.problem, robot.extent, observation.present
    agent, motion, depth = problem.agent, problem.motion, extent.ahead_m
    # Padding may hold anything: a usual belief, in a corner ahead, keeps its numbers finite.
    information = jnp.where(present[:, None, None], observation.information, problem.prior_information)
    position_body = agent.space.to_body(observation.pose, motion.position(observation.mean))
    position_body = jnp.where(present[:, None], position_body, depth)
    reached, rest, around = ways_of(observation, robot, position_body, rays, standoff * depth)
    aim = jax.vmap(lambda point, rest: steer(agent, problem.tau, point, rest))(reached, rest)
    # By the way past bodies, also where the target is in view already: by its place `any` loses 0.4 and 0.9 nat in the
    # worlds rest-200 and set-tracking.
    steps = jax.vmap(lambda point: steps_to_view(agent, problem.tau, extent, point))(reached)
    log_det, ahead = log_det_spd(information), jax.vmap(predict_information, (0, None))(information, motion)
    gain = _gain(problem, observation, information)
    own = [
        place_features(position_body / depth),
        _displacement(observation, robot) / depth,
        _uncertainty(observation, problem, information, depth),
        jnp.log1p(steps),
        jnp.clip(problem.sensor.view.signed_distance(position_body) / depth, -1.0, 2.0)[:, None],
        jnp.stack([gain, log_det - log_det_spd(ahead), _relative(log_det, present)], axis=-1) / 4.0,
        _crowd(position_body / depth, gain, present),
    ]
    urgency = [log_det, jnp.sum(steps, axis=-1)]
    if tells_team:
        team = team_tokens(observation, problem, motion.position(observation.mean), depth)
        own, urgency = [*own, team.features], [*urgency, team.not_own]
    task = [jnp.array([objective == "mean", objective == "seen"], depth.dtype)]
    common = jnp.concatenate(
        [_scene(observation, tells_time), *task, _robot_features(robot), _region_features(observation, problem, depth)]
    )
    features = jnp.concatenate([*own, jnp.broadcast_to(common, (present.shape[0], len(common))), *around], axis=-1)
    aim, unit = (agent.on_all_axes(action) for action in (aim, view_units(agent, problem.tau, extent)))
    return Tokens(jnp.where(present[:, None], features, 0.0), aim, jnp.stack(urgency, axis=-1), unit, present)


def padded(tokens: Tokens, targets: int) -> Tokens:
    """Tokens (.., n) of more targets, those that are new not present."""

    def more(x: Array, axes: int) -> Array:
        widths = [(0, 0)] * x.ndim
        widths[x.ndim - axes] = (0, targets - x.shape[-axes])
        return jnp.pad(x, widths)

    parts = {"features": 2, "aim": 2, "urgency": 2, "present": 1}
    return tokens._replace(**{name: more(getattr(tokens, name), axes) for name, axes in parts.items()})


def token_size(problem: Problem, rays: int = 0, window: bool = False) -> int:
    """Number of features of a token, of which some are for rays, and some for the dynamic window.

    Raises InputError where a state does not begin with the position.
    """
    d, axes = problem.agent.space.dimension, problem.agent.space.twist_size
    shape = f"({d} x {problem.motion.state_size})"
    right = f"expected targets whose state begins with the position, Z = [I 0] {shape}"
    require(problem.motion.begins_with_position, "policy.kind", "pointer", right)
    uncertainty = d + d * (d - 1) // 2 + 3
    own = (2 * d + 2) + d + uncertainty + 2 + 1 + 3 + len(CROWD_DEPTHS)
    own += (problem.team is not None) * TEAM_FEATURES + (problem.detections is not None) * SEARCH_FEATURES
    own += window * WINDOW_FEATURES
    return own + 1 + len(TIMES_LEFT) + 2 + (2 * axes + 4) + 2 * d + ways_size(d, rays)


def untold(
    problem: Problem, objectives: Collection[Objective], tells_time: bool, rays: int = 0, window: bool = False
) -> Bool[np.ndarray, " features"]:
    """Features that are 0 throughout a training for these objectives: the end, other tasks, borders of a region.

    A region counts as untold even where there is one, so that all trainings begin alike.
    """
    after_tasks = 2 * problem.agent.space.twist_size + 4
    told = [tells_time] * len(TIMES_LEFT) + [task in objectives for task in ("mean", "seen")] + [True] * after_tasks
    tail = np.array([*told, *[False] * (2 * problem.agent.space.dimension)])
    around = np.ones(token_size(problem, rays) - token_size(problem), bool)
    return ~np.concatenate([np.ones(token_size(problem, 0, window) - len(tail), bool), tail, around])


def _displacement(observation: Observation, robot: Robot) -> Float[Array, "n d"]:
    """How far each target is expected to move in the next step, in the body frame [m]."""
    motion, space = robot.problem.motion, robot.problem.agent.space
    moved = motion.position(motion.advance(observation.mean, observation.known_input) - observation.mean)
    return multiply(moved, space.rotation(observation.pose))


def _uncertainty(
    observation: Observation, problem: Problem, information: Float[Array, "n n_y n_y"], depth: Float[Array, ""]
) -> Float[Array, "n features"]:
    """Cholesky factor of the position's covariance in the body frame, and deviations relative to the sensor's."""
    d = problem.agent.space.dimension
    covariance = inverse_spd(information)
    turn = problem.agent.space.rotation(observation.pose)
    body = symmetrise(multiply(multiply(turn.T, covariance[:, :d, :d]), turn))
    root = cholesky_spd(body)
    diagonal = jnp.diagonal(root, axis1=-2, axis2=-1)
    rows, columns = jnp.tril_indices(d, -1)
    below = root[:, rows, columns] / diagonal[:, rows]
    sensor_std = jnp.exp(0.5 * jnp.mean(jnp.log(jnp.diagonal(_told_noise(problem)))))
    mean_std = jnp.exp(jnp.mean(jnp.log(diagonal), axis=-1, keepdims=True))
    # Positions alone have no velocity: as if it were known.
    velocity = jnp.sum(jnp.diagonal(covariance[:, d : 2 * d, d : 2 * d], axis1=-2, axis2=-1), axis=-1, keepdims=True)
    moves = problem.tau * jnp.sqrt(velocity) / depth
    parts = [jnp.log(diagonal / depth) / 3.0, below, jnp.log(mean_std / sensor_std) / 2.0, jnp.arcsinh(10 * moves)]
    return jnp.concatenate([*parts, jnp.minimum(mean_std / depth, 2.0)], axis=-1)


def _gain(problem: Problem, observation: Observation, information: Float[Array, "n n_y n_y"]) -> Float[Array, " n"]:
    """log det that a measurement from the standoff adds [nat]."""
    rotation, d = problem.agent.space.rotation(observation.pose), problem.agent.space.dimension
    point_body = jnp.zeros(d).at[0].set(STANDOFF * problem.sensor.view.extent.ahead_m)
    added = problem.sensor.gain(rotation, point_body)
    return log_det_spd(information + added) - log_det_spd(information)


def _told_noise(problem: Problem) -> Float[Array, "n n"]:
    """V; of a sensor with coordinates of its own the covariance of a position measured at the standoff [m^2]."""
    if problem.sensor.polar is None:
        return problem.sensor.V
    ahead = jnp.zeros(problem.agent.space.dimension).at[0].set(STANDOFF * problem.sensor.view.extent.ahead_m)
    return problem.sensor.equivalent(ahead)


def _relative(log_det: Float[Array, " n"], present: Bool[Array, " n"]) -> Float[Array, " n"]:
    """How much better a target is known than the worst [nat]."""
    worst = jnp.min(log_det, initial=jnp.inf, where=present)
    return log_det - jnp.where(jnp.isfinite(worst), worst, 0.0)


def _crowd(
    position: Float[Array, "n d"], gain: Float[Array, " n"], present: Bool[Array, " n"]
) -> Float[Array, "n radii"]:
    """What could be gained of the neighbours of each target, on the scale of log(1 + gain)."""
    square = jnp.sum((position[:, None] - position[None]) ** 2, axis=-1)
    others = jnp.where(present & (jnp.arange(present.shape[0])[:, None] != jnp.arange(present.shape[0])), gain, 0.0)
    sums = [jnp.sum(others * jnp.exp(-0.5 * square / radius**2), axis=-1) for radius in CROWD_DEPTHS]
    return jnp.log1p(jnp.stack(sums, axis=-1))


def _scene(observation: Observation, tells_time: bool) -> Float[Array, " features"]:
    """Number of targets, and the time left: 0 on each scale where there is no end."""
    count = jnp.log1p(jnp.sum(observation.present).astype(observation.mean.dtype))
    if not tells_time:
        return jnp.stack([count, *[jnp.zeros_like(count)] * len(TIMES_LEFT)])
    # Negative in the padding after the end of an episode, where the exponential would overflow.
    left = jnp.maximum(observation.left, 0).astype(observation.mean.dtype)
    return jnp.stack([count, *(jnp.exp(-left / scale) for scale in TIMES_LEFT)])


def _region_features(observation: Observation, problem: Problem, depth: Scalar) -> Float[Array, " features"]:
    """Where the middle of the region is, in the body frame, and its size, in depths of the view; all 0 without one."""
    if problem.region is None:
        return jnp.zeros(2 * problem.agent.space.dimension, observation.mean.dtype)
    low, high = problem.region.low, problem.region.high
    middle = problem.agent.space.to_body(observation.pose, 0.5 * (low + high))
    return jnp.concatenate([jnp.arcsinh(middle / depth), jnp.log(0.5 * (high - low) / depth)])


def _robot_features(robot: Robot) -> Float[Array, " features"]:
    """Reach in a step along each axis and back, in views; noises, in depths; half angle: constants of one robot."""
    problem, extent = robot.problem, robot.extent
    agent, d = problem.agent, problem.agent.space.dimension
    views = problem.tau / view_sizes(agent, extent)
    ahead, back = (jnp.maximum(agent.on_all_axes(speed), 0.0) * views for speed in (agent.upper, -agent.lower))
    sensor, process = (
        jnp.sqrt(jnp.mean(jnp.diagonal(matrix))) / extent.ahead_m
        for matrix in (_told_noise(problem), multiply(multiply(problem.motion.Z, problem.motion.W), problem.motion.Z.T))
    )
    reach = jnp.log(jnp.concatenate([ahead, back]) + 1e-3) / 3.0
    noises = jnp.log(jnp.stack([sensor, process]) + 1e-4) / 3.0
    prior = jnp.log(jnp.sqrt(jnp.mean(jnp.diagonal(inverse_spd(problem.prior_information))[:d])) / extent.ahead_m) / 3.0
    return jnp.concatenate([reach, noises, jnp.stack([prior, extent.half_width_rad / jnp.pi])])
