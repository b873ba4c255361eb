"""Settings of agents: the commanded axes of the twist and their limits. Speeds in [m/s], rates in [rad/s]."""

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

import jax.numpy as jnp
import numpy as np

from foveate.geometry.space import SPACES
from foveate.io.settings import Settings, tag
from foveate.io.validate import Matrix, matrix, positive, require
from foveate.models.agent import Agent


def _agent(space: str, limits: dict[str, tuple[float, float]], commands: Matrix | None) -> Agent:
    """Return the agent that commands the named axes of the twist within (lower, upper), or only these commands.

    Raises InputError unless every command has a number for each axis, in the order of `limits`, within its limits.
    """
    names = SPACES[space].axes
    axes = [names.index(name) for name in limits]
    order = np.argsort(axes)
    lower, upper = np.array(list(limits.values()), float)[order].T
    rows = None
    if commands is not None:
        rows = matrix(commands, "commands", (None, len(limits)))[:, order]
        outside = ((rows < lower) | (rows > upper)).any(axis=1)
        bounds = ", ".join(f"{name} from {low:g} to {high:g}" for name, (low, high) in limits.items())
        require(not outside.any(), "commands", commands[int(outside.argmax())], f"expected {bounds}")
    return Agent(
        space=SPACES[space],
        axes=tuple(sorted(axes)),
        lower=jnp.asarray(lower, float),
        upper=jnp.asarray(upper, float),
        commands=None if rows is None else jnp.asarray(rows, float),
    )


@dataclass(frozen=True, kw_only=True)
class _Commands(Settings):
    """A body that moves by commands, constant over a step, on some axes of its twist, each within its limits.

    With `commands`, rows of a number per axis [m/s, rad/s], it executes only these: of any action the nearest command,
    in units of the limits.
    """

    commands: Matrix | None = None


@dataclass(frozen=True, kw_only=True)
class DifferentialDrive(_Commands):
    """A ground vehicle that drives ahead and turns."""

    kind: Literal["differential_drive"] = "differential_drive"
    space: Literal["planar", "spatial"] = "planar"
    """The plane, or the plane z = 0 of space."""
    v_min_m_s: float = 0.0
    """Least speed ahead; below 0 it can reverse."""
    v_max_m_s: float = 4.0
    """Largest speed ahead."""
    w_max_rad_s: float = math.pi / 3
    """Largest turn rate to either side."""

    def __post_init__(self) -> None:
        super().__post_init__()
        right = f"expected > v_min_m_s {self.v_min_m_s}"
        require(self.v_min_m_s < self.v_max_m_s, "v_max_m_s", self.v_max_m_s, right)
        positive(self, "w_max_rad_s")
        self.agent()  # rejects commands outside of the limits

    def agent(self) -> Agent:
        """The agent with its limits as arrays."""
        w = self.w_max_rad_s
        return _agent(self.space, {"vx": (self.v_min_m_s, self.v_max_m_s), "wz": (-w, w)}, self.commands)


@dataclass(frozen=True, kw_only=True)
class Quadrotor(_Commands):
    """A level flying camera: any velocity, turns about the vertical only."""

    kind: Literal["quadrotor"] = tag("quadrotor")
    v_max_m_s: float = 4.0
    """Largest speed ahead and sideways, to either side."""
    climb_max_m_s: float = 2.0
    """Largest speed up and down."""
    yaw_rate_max_rad_s: float = math.pi / 2
    """Largest turn rate to either side."""
    space: ClassVar[str] = "spatial"

    def __post_init__(self) -> None:
        super().__post_init__()
        positive(self, "v_max_m_s", "climb_max_m_s", "yaw_rate_max_rad_s")
        self.agent()  # rejects commands outside of the limits

    def agent(self) -> Agent:
        """The agent with its limits as arrays."""
        v, climb, turn = self.v_max_m_s, self.climb_max_m_s, self.yaw_rate_max_rad_s
        return _agent(
            self.space, {"vx": (-v, v), "vy": (-v, v), "vz": (-climb, climb), "wz": (-turn, turn)}, self.commands
        )


@dataclass(frozen=True, kw_only=True)
class FixedWing(_Commands):
    """Kinematics of an aeroplane: always ahead; rolls, pitches and (a little) yaws about its own axes."""

    kind: Literal["fixed_wing"] = tag("fixed_wing")
    v_min_m_s: float = 10.0
    """Least airspeed."""
    v_max_m_s: float = 20.0
    """Largest airspeed."""
    roll_rate_max_rad_s: float = 1.0
    """Largest turn rate about the axis ahead."""
    pitch_rate_max_rad_s: float = 0.5
    """Largest turn rate about the axis to the left."""
    yaw_rate_max_rad_s: float = 0.2
    """Largest turn rate about the axis up."""
    space: ClassVar[str] = "spatial"

    def __post_init__(self) -> None:
        super().__post_init__()
        positive(self, "v_min_m_s", "roll_rate_max_rad_s", "pitch_rate_max_rad_s", "yaw_rate_max_rad_s")
        right = f"expected > v_min_m_s {self.v_min_m_s}"
        require(self.v_min_m_s < self.v_max_m_s, "v_max_m_s", self.v_max_m_s, right)
        self.agent()  # rejects commands outside of the limits

    def agent(self) -> Agent:
        """The agent with its limits as arrays."""
        rates = {"wx": self.roll_rate_max_rad_s, "wy": self.pitch_rate_max_rad_s, "wz": self.yaw_rate_max_rad_s}
        turns = {name: (-rate, rate) for name, rate in rates.items()}
        return _agent(self.space, {"vx": (self.v_min_m_s, self.v_max_m_s), **turns}, self.commands)


@dataclass(frozen=True, kw_only=True)
class FreeBody(_Commands):
    """Any subset of the axes of the twist, each within its own limits; the other axes stay 0.

    Axes are vx, vy, wz in the plane and vx, vy, vz, wx, wy, wz in space; `lower` and `upper` are their limits, a number
    for each of `axes` [m/s, rad/s], as in a row of `commands`.
    """

    kind: Literal["body"] = tag("body")
    space: Literal["planar", "spatial"] = "spatial"
    """The plane, or space."""
    axes: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        names, count = SPACES[self.space].axes, len(self.axes)
        require(count > 0, "axes", self.axes, f"expected at least one of {', '.join(names)}")
        for axis in self.axes:
            require(axis in names, "axes", self.axes, f"no axis {axis!r}: expected some of {', '.join(names)}")
        require(len(set(self.axes)) == count, "axes", self.axes, "expected each axis once")
        for name, limits in (("lower", self.lower), ("upper", self.upper)):
            require(len(limits) == count, name, limits, f"expected {count} numbers, one for each of axes")
        below = all(low < high for low, high in zip(self.lower, self.upper, strict=True))
        require(below, "upper", self.upper, f"expected > lower {self.lower} on every axis")
        self.agent()  # rejects commands outside of the limits

    def agent(self) -> Agent:
        """The agent with its limits as arrays."""
        limits = zip(self.lower, self.upper, strict=True)
        return _agent(self.space, dict(zip(self.axes, limits, strict=True)), self.commands)


AgentSettings = DifferentialDrive | Quadrotor | FixedWing | FreeBody
