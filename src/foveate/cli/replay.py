"""`foveate replay`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from foveate.cli.options import Command, option
from foveate.names import GATE


@dataclass(kw_only=True)
class Replay(Command):
    """Drive the agent through a recording of real targets, with the real Kalman filter and the real view.

    Targets come and go; positions are interpolated between fixes. All methods get the same noise and the same start.
    Writes replay.json, a figure and an animation into --out.
    """

    run: Annotated[tyro.conf.Positional[str], option("RUN|PRESET")]
    """Run folder of `foveate train`, or a preset, of which the package brings a trained policy."""
    recording: Annotated[tyro.conf.Positional[Path], option("RECORDING.csv")]
    """Header time_s,track_id,x_m,y_m[,z_m]."""
    method: tuple[str, ...] = ("all",)
    """Any of policy, random, still, nearest, uncertain, lawnmower; or all."""
    start: Annotated[float | None, option("SECONDS")] = None
    """Begin here [s]."""
    end: Annotated[float | None, option("SECONDS")] = None
    """End here [s]."""
    agent_start: Annotated[str | None, option("X,Y,YAW")] = None
    """Where the agent starts [m, rad] (x,y,z,qw,qx,qy,qz in space; default: the middle of the recording)."""
    starts: int = 1
    """Number of starts; with more than one they are drawn, alike for all methods, and means are printed."""
    max_gap: Annotated[float | None, option("SECONDS")] = None
    """Longest gap between two fixes over which a target counts as present [s] (default: 2 s, or three fixes of a slow
    clock)."""
    gate: float | None = GATE
    """The filter rejects measurements that are farther from their prediction than this share of honest ones; None: it
    takes whatever comes. With the fifth in a row the target has really jumped, and its belief begins anew."""
    seed: int = 0
    """Seed of the noise and of drawn starts."""
    out: Annotated[Path | None, option("DIR")] = None
    """Folder for replay.json, replay.png and replay.gif."""
    json: Annotated[Path | None, option("FILE")] = None
    """Write the rows for programs."""
