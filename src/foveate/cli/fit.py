"""`foveate fit`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from foveate.cli.common import check_output
from foveate.cli.options import ReadingCommand, option
from foveate.errors import InputError
from foveate.names import Goal


@dataclass(kw_only=True)
class Fit(ReadingCommand):
    """Fit a scenario to a recording of real targets, for `foveate train --config`.

    The recording gives the number of targets, their positions, speeds and process noise, and the length of an episode:
    the time to cross the scene, up to 200 steps of --tau. The options give the agent and its sensor: a driving robot
    with a sector view in the plane, a quadrotor with a camera in space (z_m). For an unbiased evaluation, fit on the
    first part of a recording (--end) and replay on the rest (--start).
    """

    recording: Annotated[tyro.conf.Positional[tuple[Path, ...]], option("RECORDING ..")]
    """CSV files with the header time_s,track_id,x_m,y_m[,z_m]; other tables (--columns); MOT challenge text, rows of
    frame,id,x,y (--fps), TUM trajectories (a file each target); bags of ROS 1 and 2, MCAP (extra ros)."""
    out: Annotated[Path, option("scenario.toml")]
    """File to write."""
    force: bool = False
    """Replace an existing file."""
    start: Annotated[float | None, option("SECONDS")] = None
    """Start of the part to use [s]."""
    end: Annotated[float | None, option("SECONDS")] = None
    """End of the part to use [s]."""
    split: Annotated[str | None, option("60,20,20")] = None
    """Shares of the time to train on, to choose the best of several policies on, and to judge that one on: the scenario
    is fitted to the first part. `foveate replay --split` takes the others."""
    max_gap: Annotated[float | None, option("SECONDS")] = None
    """Longest gap over which a target counts as present [s] (default: 2 s, or three fixes of a slow clock)."""
    v_max: Annotated[float, option("M/S")] = 3.0
    """Largest speed of the agent [m/s]."""
    w_max: Annotated[float, option("RAD/S")] = 1.5
    """Largest turn rate of the agent [rad/s]."""
    view_depth: Annotated[float, option("M")] = 10.0
    """Depth of the field of view [m]."""
    view_angle_deg: Annotated[float, option("DEG")] = 90.0
    """Full angle of the field of view [deg]."""
    tau: Annotated[float, option("SECONDS")] = 0.5
    """Control period [s]."""
    sensor_std_m: Annotated[float, option("M")] = 0.3
    """Standard deviation of a measured position [m]."""
    report: Annotated[Path | None, option("FILE.html")] = None
    """Write a page about what was found, with a figure."""
    goal: Goal = "seen"
    """Objective. seen: time in view. information: log det of all beliefs."""

    def check(self) -> None:
        """Refuse places to write to as well."""
        super().check()
        check_output(self.out, *self.recording)
        check_output(self.report, *self.recording, self.out)
        if self.out.exists() and not self.force:
            raise InputError(f"{self.out}: exists already: choose another --out, or replace it with --force")
