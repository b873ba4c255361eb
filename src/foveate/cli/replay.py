"""`foveate replay`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from foveate.cli.options import Command, option
from foveate.names import GATE


@dataclass(kw_only=True)
class Replay(Command):
    """Run methods on a recording of real targets, with the Kalman filter and the real field of view.

    Targets appear and disappear; positions are interpolated between fixes. All methods get the same noise and start.
    With --out, writes replay.json, a figure and an animation.
    """

    run: Annotated[tyro.conf.Positional[str], option("RUN|PRESET")]
    """Run folder of `foveate train`, or name of a preset (its trained policy comes with the package)."""
    recording: Annotated[tyro.conf.Positional[Path], option("RECORDING.csv")]
    """CSV file with the header time_s,track_id,x_m,y_m[,z_m]."""
    method: tuple[str, ...] = ("all",)
    """Any of policy, random, still, nearest, uncertain, lawnmower; or all."""
    start: Annotated[float | None, option("SECONDS")] = None
    """Start of the part to use [s]."""
    end: Annotated[float | None, option("SECONDS")] = None
    """End of the part to use [s]."""
    agent_start: Annotated[str | None, option("X,Y,YAW")] = None
    """Start pose of the agent [m, rad] (x,y,z,qw,qx,qy,qz in space; default: the middle of the recording)."""
    starts: int = 1
    """Number of start poses; more than one are sampled, the same for all methods, and means are printed."""
    max_gap: Annotated[float | None, option("SECONDS")] = None
    """Longest gap between two fixes over which a target counts as present [s] (default: 2 s, or three fixes of a slow
    clock)."""
    gate: float | None = GATE
    """Probability of the chi-square gate; measurements outside are rejected. None: no gate. After four rejections in a
    row, the fifth measurement restarts the belief: the target has really jumped."""
    seed: int = 0
    """Seed of the noise and of sampled starts."""
    out: Annotated[Path | None, option("DIR")] = None
    """Folder for replay.json, replay.png and replay.gif."""
    json: Annotated[Path | None, option("FILE")] = None
    """Write the rows as JSON."""
