"""`foveate fit`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from foveate.cli.options import Command, option
from foveate.names import Goal


@dataclass(kw_only=True)
class Fit(Command):
    """Derive a scenario from a recording of real targets, ready for `foveate train --config`.

    Taken from the recording: targets at once, where they are, how fast, how far a step carries them. Yours: the agent
    and its sensor, in the plane a driving robot with a sector of view, in space (z_m) a quadrotor with a camera. Fit
    on the first part of a recording (--end) and replay on the rest (--start) to judge honestly.
    """

    recording: Annotated[tyro.conf.Positional[Path], option("RECORDING.csv")]
    """Header time_s,track_id,x_m,y_m[,z_m]."""
    out: Annotated[Path, option("scenario.toml")]
    """File to write."""
    start: Annotated[float | None, option("SECONDS")] = None
    """Begin here [s]."""
    end: Annotated[float | None, option("SECONDS")] = None
    """End here [s]."""
    max_gap: Annotated[float | None, option("SECONDS")] = None
    """Longest gap over which a target counts as present [s] (default: 2 s, or three fixes of a slow clock)."""
    v_max: float = 3.0
    """The agent's largest speed [m/s]."""
    w_max: float = 1.5
    """Its largest turn rate [rad/s]."""
    view_depth: float = 10.0
    """How far its sensor sees [m]."""
    view_angle_deg: float = 90.0
    """Full angle of its view [deg]."""
    tau: float = 0.5
    """Time between its decisions [s]."""
    sensor_std_m: float = 0.3
    """Standard deviation of a measured position [m]."""

    goal: Goal = "seen"
    """seen: have the targets in view for as long as possible. information: know all of them well."""
