"""Draw robots: a problem whose view, limits and noises are random (domain randomisation, Tobin et al. 2017)."""

from dataclasses import dataclass, fields, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from foveate.errors import InputError
from foveate.geometry.fov import FieldOfView
from foveate.geometry.fov_planar import ConvexPolygon, Sector, triangle_vertices
from foveate.models.problem import Problem
from foveate.types import Key, Scalar

Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class RobotRanges:
    """Ranges of the factors on a problem's own values, and of the full angle of its view [deg].

    `depth` is that of the view, `speed` and `turn` are the limits', `reverse` the speed back as a share of that ahead,
    `sensor_std`, `process_std` and `prior_std` the standard deviations of measurements, motion and first beliefs.
    `reverse` is uniform; the logarithms of the others are triangular: most robots are extreme in little.
    """

    depth: Range = (0.25, 4.0)
    angle_deg: Range = (30.0, 150.0)
    speed: Range = (0.25, 4.0)
    turn: Range = (0.25, 4.0)
    reverse: Range = (0.0, 1.0)
    sensor_std: Range = (0.25, 4.0)
    process_std: Range = (0.25, 4.0)
    prior_std: Range = (0.5, 2.0)


class RobotFactors(eqx.Module):
    """Factors and angle of one robot, as `RobotRanges` has them."""

    depth: Scalar
    angle_deg: Scalar
    speed: Scalar
    turn: Scalar
    reverse: Scalar
    sensor_std: Scalar
    process_std: Scalar
    prior_std: Scalar


def draw_robot(ranges: RobotRanges, key: Key) -> RobotFactors:
    """The factors and the angle of a random robot."""
    names = [field.name for field in fields(RobotRanges)]
    low, high = np.array([getattr(ranges, name) for name in names]).T
    uniform = jax.random.uniform(key, (2, len(names)))
    is_linear = np.array([name == "reverse" for name in names])
    first, last = (np.log(np.where(is_linear, 1.0, bound)) for bound in (low, high))
    share = jnp.mean(uniform, axis=0)  # of two uniform numbers: triangular
    values = jnp.where(is_linear, low + uniform[0] * (high - low), jnp.exp(first + share * (last - first)))
    return RobotFactors(**{name: values[i].astype(uniform.dtype) for i, name in enumerate(names)})


def with_robot(problem: Problem, robot: RobotFactors) -> Problem:
    """The problem of a robot, whose factors are on this problem's values.

    Raises InputError unless the view is a triangle or a sector, for a schedule, and for a set of commands, which does
    not follow the limits.
    """
    if problem.agent.commands is not None:
        raise InputError("agent.commands: expected none for random robots")
    if problem.schedule is not None:
        raise InputError("schedule: expected none for random robots")
    if len(problem.kinds) > 1:
        raise InputError("team.robots: expected none for random robots")
    agent, names = problem.agent, [problem.agent.space.axes[axis] for axis in problem.agent.axes]
    factor = jnp.stack([robot.speed if name[0] == "v" else robot.turn for name in names])
    upper, lower = factor * agent.upper, factor * agent.lower
    if "vx" in names:
        i = names.index("vx")
        lower = lower.at[i].set(-robot.reverse * upper[i])
    V, W = robot.sensor_std**2 * problem.sensor.V, robot.process_std**2 * problem.motion.W
    return replace(
        problem,
        agent=replace(agent, lower=lower, upper=upper),
        sensor=replace(problem.sensor, V=V, view=_view(problem.sensor.view, robot)),
        motion=replace(problem.motion, W=W),
        prior_information=problem.prior_information / robot.prior_std**2,
    )


def _view(view: FieldOfView, robot: RobotFactors) -> FieldOfView:
    angle = jnp.deg2rad(robot.angle_deg)
    if isinstance(view, Sector):
        return Sector(robot.depth * view.radius, angle, robot.depth * view.near)
    if isinstance(view, ConvexPolygon) and len(view.vertices) == 3:
        return ConvexPolygon(triangle_vertices(robot.depth * view.extent.ahead_m, angle))
    raise InputError(f"view = {type(view).__name__}: expected a triangle or a sector for random robots")
