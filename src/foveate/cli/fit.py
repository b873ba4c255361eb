"""`foveate fit`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from foveate.cli.options import option
from foveate.errors import InputError


@dataclass(kw_only=True)
class Fit:
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

    goal: Literal["seen", "information"] = "seen"
    """seen: have the targets in view for as long as possible. information: know all of them well."""

    def run_command(self) -> int:
        """Fit, say what was found, write the experiment."""
        from foveate.cli.common import check_output
        from foveate.io.toml import save_toml
        from foveate.recordings.fit import Robot, fit_experiment
        from foveate.recordings.formats import load_recording
        from foveate.recordings.motion import fit_statistics
        from foveate.recordings.recording import window

        check_output(self.out, self.recording)
        if self.out.exists():
            raise InputError(f"{self.out}: exists already: choose another --out")
        recording = window(load_recording(self.recording), self.start, self.end)
        if self.tau <= 0:
            raise InputError(f"--tau {self.tau}: expected > 0")
        found = fit_statistics(recording, self.tau, self.max_gap)
        robot = Robot(
            v_max=self.v_max,
            w_max=self.w_max,
            depth_m=self.view_depth,
            angle_deg=self.view_angle_deg,
            std_m=self.sensor_std_m,
        )
        experiment = fit_experiment(found, robot, self.goal)
        said = found.lines()
        print("\n".join(said))
        header = "\n".join([f"Fitted to {self.recording.name} by foveate fit.", *said])
        save_toml(experiment, self.out, header, sealed=False)
        print(f"{self.out}: written; next  foveate train --config {self.out}")
        return 0
