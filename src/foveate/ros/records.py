"""Plain records of what a node receives and sends: times in s, lengths in m, angles in rad, quaternions x, y, z, w."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from foveate.io.occupancy import OccupancyGrid

AXES = ("vx", "vy", "vz", "wx", "wy", "wz")
"""Numbers of a twist in the body frame, in the order of geometry_msgs/Twist."""
Position = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class Odometry(NamedTuple):
    """Pose of the body frame `child` in the world frame `frame`, as nav_msgs/Odometry has it."""

    time_s: float
    frame: str
    child: str
    position: Position
    quaternion: Quaternion


class Detections(NamedTuple):
    """Positions of targets by id, in a frame, all measured at one time; NaN for one that is not seen."""

    time_s: float
    frame: str
    positions: Mapping[str, Position]


class Map(NamedTuple):
    """Occupied cells in a world frame, as nav_msgs/OccupancyGrid has them; unknown ones are occupied."""

    frame: str
    grid: OccupancyGrid


class Estimate(NamedTuple):
    """Belief about one target at the time of a decision, in the world frame; the state begins with the position."""

    target: str
    mean: Float[np.ndarray, " n_y"]
    covariance: Float[np.ndarray, "n_y n_y"]


class Decision(NamedTuple):
    """A twist in the body frame, numbers by AXES; `stopped` says why it is zero, and is empty while driving."""

    time_s: float
    frame: str
    twist: tuple[float, ...]
    stopped: str
    estimates: tuple[Estimate, ...]
