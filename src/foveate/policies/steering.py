"""The steering law: the command that brings a point into view, exact for an agent's limits, period and view."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.fov import Extent
from foveate.models.agent import Agent
from foveate.types import Action, Point, Scalar

MAX_STEPS = 1000.0
"""Steps to what an agent can never bring into view: finite, so that differences are."""

MAX_UNIT = 3.0
"""Largest unit of the view in an axis's action, which has a range of 2: for slow axes more would only be noise."""


def steer(agent: Agent, tau: Scalar, point_body: Point, standoff_m: Scalar | float) -> Action:
    """The action that faces a body-frame point [m], and ends `standoff_m` [m] before it, after one period `tau` [s].

    The action of the nearest command within the limits: far points take several steps.
    """
    return agent.action(twist_towards(agent, tau, point_body, standoff_m)[jnp.array(agent.axes)])


def twist_towards(agent: Agent, tau: Scalar, point_body: Point, standoff_m: Scalar | float) -> Float[Array, " n_u"]:
    """The twist of `steer` before the agent's limits [m/s, rad/s]; `sideways` speeds are within them."""
    range_m = jnp.hypot(point_body[0], point_body[1])
    bearing = jnp.arctan2(point_body[1], point_body[0])
    if 1 in agent.axes:
        ahead, aside = _straight_line(agent, tau, point_body, bearing, range_m - standoff_m)
    else:
        # Heading first: a vehicle that cannot move sideways would drive past its goal while it still turns.
        ahead = jnp.maximum(jnp.cos(bearing), 0.0) * (range_m - standoff_m) / tau
        aside = jnp.zeros_like(ahead)
    if len(point_body) == 2:
        return jnp.stack([ahead, aside, bearing / tau])
    elevation = jnp.arctan2(point_body[2], range_m)
    return jnp.stack([ahead, aside, point_body[2] / tau, jnp.zeros_like(ahead), -elevation / tau, bearing / tau])


def _straight_line(
    agent: Agent, tau: Scalar, point_body: Point, bearing: Scalar, distance_m: Scalar
) -> tuple[Scalar, Scalar]:
    """Speeds ahead and sideways that move in a straight line along the bearing while the agent turns to it."""
    turn = jnp.minimum(jnp.abs(bearing), limit(agent, "wz") * tau) * jnp.sign(bearing)
    # A turn by w tau moves a constant (v_x, v_y) by sinc(w tau / 2) R(w tau / 2) (v_x, v_y) tau.
    heading = bearing - 0.5 * turn
    speed = distance_m / (tau * jnp.sinc(turn / (2 * jnp.pi)))
    ahead, aside = speed * jnp.cos(heading), speed * jnp.sin(heading)
    # One factor for both, or the limits would bend the line.
    excess = jnp.maximum(jnp.abs(ahead) / limit(agent, "vx"), jnp.abs(aside) / limit(agent, "vy"))
    return ahead / jnp.maximum(excess, 1.0), aside / jnp.maximum(excess, 1.0)


def limit(agent: Agent, axis: str) -> Scalar:
    """The largest speed of an axis, in either direction [m/s, rad/s]; hardly any for an axis that is not actuated."""
    index = agent.space.axes.index(axis) if axis in agent.space.axes else -1
    if index not in agent.axes:
        return jnp.asarray(1e-9, agent.upper.dtype)
    entry = agent.axes.index(index)
    return jnp.maximum(agent.upper[entry], -agent.lower[entry])


def steps_to_view(agent: Agent, tau: Scalar, extent: Extent, point_body: Point) -> Float[Array, "2"]:
    """Steps of turning, and steps of driving (and climbing), until a body-frame point [m] is in view.

    Both are fractions, 0 for a point in view and at most MAX_STEPS. Sides and ends of the view are those of its extent.
    """
    range_m = jnp.hypot(point_body[0], point_body[1])
    bearing = jnp.abs(jnp.arctan2(point_body[1], point_body[0]))
    turn = jnp.maximum(bearing - extent.half_width_rad, 0.0) / (limit(agent, "wz") * tau)
    drive = jnp.maximum(range_m - extent.ahead_m, 0.0) / (limit(agent, "vx") * tau)
    if len(point_body) == 3:
        above = jnp.abs(jnp.arctan2(point_body[2], range_m))
        excess = jnp.maximum(above - extent.half_height_rad, 0.0)
        if "wy" in _actuated(agent):
            turn = jnp.maximum(turn, excess / (limit(agent, "wy") * tau))
        else:
            drive = jnp.maximum(drive, range_m * excess / (limit(agent, "vz") * tau))
    return jnp.minimum(jnp.stack([turn, drive]), MAX_STEPS)


def _actuated(agent: Agent) -> tuple[str, ...]:
    return tuple(agent.space.axes[axis] for axis in agent.axes)


def view_units(agent: Agent, tau: Scalar, extent: Extent) -> Float[Array, " m"]:
    """The change of each axis's action that moves the agent by the size of its view in one period, at most MAX_UNIT.

    The size is the depth of the view for a displacement, the half angle for a turn. In these units errors of aiming,
    and exploration, mean the same for every robot.
    """
    sizes = view_sizes(agent, extent)[jnp.array(agent.axes)]
    return jnp.minimum(sizes / (0.5 * (agent.upper - agent.lower) * tau), MAX_UNIT)


def view_sizes(agent: Agent, extent: Extent) -> Float[Array, " n_u"]:
    """The size of the view along each axis of the twist [m, rad]: its depth, or its half angle."""
    size = {axis: extent.ahead_m if axis[0] == "v" else extent.half_width_rad for axis in agent.space.axes}
    size["wx"] = jnp.asarray(jnp.pi / 4)
    size["wy"] = extent.half_height_rad
    return jnp.stack([jnp.asarray(size[axis], agent.upper.dtype) for axis in agent.space.axes])
