"""Sensors that measure in coordinates of their own: range and bearing in the plane, azimuth, elevation, range in space.

h(q) of the position q in the body frame (x ahead, y to the left, z up):

    range = |q|,  bearing (azimuth) = atan2(q_y, q_x),  elevation = atan2(q_z, |(q_x, q_y)|)

with its Jacobian and Hessians. One text serves the simulation (JAX) and the robot (numpy): `xp` is the module that
computes. All functions are of one target, or broadcast over leading axes. The filter is `models.polar_filter`.
"""

from typing import Any, Literal, NamedTuple

import numpy as np

Coordinate = Literal["range", "bearing", "elevation"]
Numbers = Any
"""An array of the module that computes."""

MIN_RANGE_M = 0.01
"""Within this range a bearing's derivative 1 / range stays as it is there, instead of growing without bound."""


class Polar(NamedTuple):
    """Measured coordinates in order, and the growth of the standard deviation of each with the range [1/m]."""

    coordinates: tuple[Coordinate, ...]
    growth_per_m: tuple[float, ...]

    def is_full(self, dimension: int) -> bool:
        """True if a measurement has a position."""
        return len(self.coordinates) == dimension


def wrapped(angle: Numbers) -> Numbers:
    """The angle in [-pi, pi) [rad]."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def names_of(dimension: int) -> tuple[Coordinate, ...]:
    """The coordinates that make up a position."""
    return ("range", "bearing") if dimension == 2 else ("range", "bearing", "elevation")


def _lengths(xp: Any, q: Numbers) -> tuple[Numbers, Numbers]:
    """|q| and |(q_x, q_y)|, at least `MIN_RANGE_M` [m]."""
    least = MIN_RANGE_M**2
    squares = xp.sum(q * q, axis=-1), xp.sum(q[..., :2] * q[..., :2], axis=-1)
    distance, across = (xp.sqrt(xp.where(square > least, square, least)) for square in squares)
    return distance, across


def coordinates_of(xp: Any, polar: Polar, q: Numbers) -> Numbers:
    """h(q) of positions (.., d) in the body frame [m]: (.., n_z) [m, rad]."""
    distance, across = _lengths(xp, q)
    # The angle of a position at the origin, which has none, is 0 with a finite derivative.
    ahead = xp.where(xp.sum(q[..., :2] ** 2, axis=-1) > 0, q[..., 0], 1.0)
    values = {"range": lambda: distance, "bearing": lambda: xp.arctan2(q[..., 1], ahead)}
    values["elevation"] = lambda: xp.arctan2(q[..., 2], across)
    return xp.stack([values[name]() for name in polar.coordinates], axis=-1)


def jacobian(xp: Any, polar: Polar, q: Numbers) -> Numbers:
    """dh/dq (.., n_z, d) [1, rad/m]."""
    distance, across = _lengths(xp, q)
    x, y, zero = q[..., 0], q[..., 1], xp.zeros_like(distance)

    def row(name: Coordinate) -> Numbers:
        if name == "range":
            return q / distance[..., None]
        if name == "bearing":
            flat = xp.stack([-y, x], axis=-1) / (across * across)[..., None]
            return flat if q.shape[-1] == 2 else xp.concatenate([flat, zero[..., None]], axis=-1)
        up = q[..., 2] / (across * distance * distance)
        return xp.stack([-x * up, -y * up, across / (distance * distance)], axis=-1)

    return xp.stack([row(name) for name in polar.coordinates], axis=-2)


def hessians(xp: Any, polar: Polar, q: Numbers) -> Numbers:
    """Second derivatives of h (.., n_z, d, d) [1/m, rad/m^2]."""
    distance, across = _lengths(xp, q)
    x, y, d = q[..., 0], q[..., 1], q.shape[-1]

    def of(name: Coordinate) -> Numbers:
        if name == "range":
            u = q / distance[..., None]
            return (xp.eye(d) - u[..., :, None] * u[..., None, :]) / distance[..., None, None]
        if name == "bearing":
            diagonal, off = 2 * x * y / across**4, (y * y - x * x) / across**4
            flat = xp.stack([xp.stack([diagonal, off], -1), xp.stack([off, -diagonal], -1)], -2)
            return flat if d == 2 else xp.pad(flat, [(0, 0)] * (q.ndim - 1) + [(0, 1), (0, 1)])
        # In the frame of the ray u, upwards v and sideways w: -1 / r^2 for u v, -tan(elevation) / r^2 for w w.
        sideways = xp.stack([-y, x, xp.zeros_like(x)], -1) / across[..., None]
        u, v = q / distance[..., None], jacobian(xp, Polar(("elevation",), (0.0,)), q)[..., 0, :] * distance[..., None]
        tangent, uv = (q[..., 2] / across)[..., None, None], u[..., :, None] * v[..., None, :]
        ww = sideways[..., :, None] * sideways[..., None, :]
        return -(uv + xp.swapaxes(uv, -1, -2) + tangent * ww) / (distance * distance)[..., None, None]

    return xp.stack([of(name) for name in polar.coordinates], axis=-3)


def residual(xp: Any, polar: Polar, z: Numbers, expected: Numbers) -> Numbers:
    """z - expected (.., n_z), angles wrapped to [-pi, pi)."""
    is_angle = np.array([name != "range" for name in polar.coordinates])
    return xp.where(is_angle, wrapped(z - expected), z - expected)


def position(xp: Any, every: dict[Coordinate, Numbers]) -> Numbers:
    """The position (.., d) in the body frame [m] with these coordinates; without an elevation in the plane."""
    least = xp.where(every["range"] > MIN_RANGE_M, every["range"], MIN_RANGE_M)
    cos, sin = xp.cos(every["bearing"]), xp.sin(every["bearing"])
    if "elevation" not in every:
        return xp.stack([least * cos, least * sin], axis=-1)
    flat = least * xp.cos(every["elevation"])
    return xp.stack([flat * cos, flat * sin, least * xp.sin(every["elevation"])], axis=-1)


def noise(xp: Any, polar: Polar, V: Numbers, q: Numbers) -> Numbers:
    """V of a target at q (.., n_z, n_z): each standard deviation grows with the range by its own factor."""
    if not any(polar.growth_per_m):
        return V + xp.zeros_like(q[..., :1, None])
    factor = 1.0 + np.array(polar.growth_per_m) * _lengths(xp, q)[0][..., None]
    return V * factor[..., :, None] * factor[..., None, :]


def finest_gain(polar: Polar, V: np.ndarray, Z: np.ndarray, least_m: float | None) -> np.ndarray:
    """H^T V^-1 H (n_y, n_y) of the finest measurement: of a target straight ahead at `least_m` [m].

    None for an agent that comes as near as it likes, within MIN_RANGE_M.
    """
    point_body = np.eye(len(Z))[0] * (MIN_RANGE_M if least_m is None else least_m)
    H = jacobian(np, polar, point_body) @ Z
    return H.T @ np.linalg.solve(noise(np, polar, V, point_body), H)


def replaced(xp: Any, polar: Polar, q: Numbers, values: Numbers) -> Numbers:
    """The position q with these values of the measured coordinates in place of its own."""
    names = names_of(q.shape[-1])
    own = coordinates_of(xp, Polar(names, (0.0,) * len(names)), q)
    every: dict[Coordinate, Numbers] = {name: own[..., i] for i, name in enumerate(names)}
    for i, name in enumerate(polar.coordinates):
        every[name] = values[..., i]
    return position(xp, every)
