"""`foveate fit`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from foveate.cli.options import Command, option
from foveate.names import Goal


@dataclass(kw_only=True)
class Fit(Command):
    """Fit a scenario to a recording of real targets, for `foveate train --config`.

    The recording gives the number of targets, their positions, speeds and process noise. The options give the agent
    and its sensor: a driving robot with a sector view in the plane, a quadrotor with a camera in space (z_m). For an
    unbiased evaluation, fit on the first part of a recording (--end) and replay on the rest (--start).
    """

    recording: Annotated[tyro.conf.Positional[Path], option("RECORDING.csv")]
    """CSV file with the header time_s,track_id,x_m,y_m[,z_m]."""
    out: Annotated[Path, option("scenario.toml")]
    """File to write."""
    start: Annotated[float | None, option("SECONDS")] = None
    """Start of the part to use [s]."""
    end: Annotated[float | None, option("SECONDS")] = None
    """End of the part to use [s]."""
    max_gap: Annotated[float | None, option("SECONDS")] = None
    """Longest gap over which a target counts as present [s] (default: 2 s, or three fixes of a slow clock)."""
    v_max: float = 3.0
    """Largest speed of the agent [m/s]."""
    w_max: float = 1.5
    """Largest turn rate of the agent [rad/s]."""
    view_depth: float = 10.0
    """Depth of the field of view [m]."""
    view_angle_deg: float = 90.0
    """Full angle of the field of view [deg]."""
    tau: float = 0.5
    """Control period [s]."""
    sensor_std_m: float = 0.3
    """Standard deviation of a measured position [m]."""
    goal: Goal = "seen"
    """Objective. seen: time in view. information: log det of all beliefs."""
