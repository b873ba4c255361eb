"""`foveate replay`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from foveate.cli.options import ReadingCommand, option
from foveate.names import GATE, Part


@dataclass(kw_only=True)
class Replay(ReadingCommand):
    """Run methods on a recording of real targets, with the Kalman filter and the real field of view.

    Targets appear and disappear; positions are interpolated between fixes. All methods get the same noise and start.
    Detections have ids and miss no target in view, unless --detection-probability or --clutter is given.
    With --out, writes replay.json, a figure and an animation, or a bag.
    """

    run: Annotated[tyro.conf.Positional[str], option("RUN|PRESET|FILE.onnx")]
    """Run folder, exported file (.onnx), or name of a preset (its trained policy comes with the package)."""
    recording: Annotated[tyro.conf.Positional[tuple[Path, ...]], option("RECORDING ..")]
    """CSV files with the header time_s,track_id,x_m,y_m[,z_m]; other tables (--columns); MOT challenge text, rows of
    frame,id,x,y (--fps), TUM trajectories (a file each target); bags of ROS 1 and 2, MCAP (extra ros)."""
    method: Annotated[tuple[str, ...], option("NAME ..")] = ("all",)
    """Any of policy, random, still, nearest, uncertain, lawnmower, price, window, post; or all of these. Without ids of
    detections also explore, alternate, lookahead. Also planners in receding horizon, which take seconds to minutes:
    icr, icr-STARTS, refine-STEPS (from the policy's actions). In a team also NAME+RULE, which assigns targets to
    robots: greedy, hungarian, auction."""
    start: Annotated[float | None, option("SECONDS")] = None
    """Start of the part to use [s]."""
    end: Annotated[float | None, option("SECONDS")] = None
    """End of the part to use [s]."""
    split: Annotated[str | None, option("60,20,20")] = None
    """Shares of the time to train on (`foveate fit --split`), to choose on and to judge on; --part is replayed."""
    part: Part = "judge"
    """Part of the --split to replay."""
    candidates: Annotated[tuple[str, ...], option("RUN ..")] = ()
    """Further runs, say of other seeds: the best of all on the part to choose on is replayed on the part to judge."""
    agent_start: Annotated[str | None, option("X,Y,YAW")] = None
    """Start pose of the agent [m, rad] (x,y,z,qw,qx,qy,qz in space; default: the middle of the recording)."""
    starts: int = 1
    """Number of start poses; more than one are sampled, the same for all methods, and means are printed."""
    max_gap: Annotated[float | None, option("SECONDS")] = None
    """Longest gap between two fixes over which a target counts as present [s] (default: 2 s, or three fixes of a slow
    clock)."""
    gate: Annotated[float | None, option("PROBABILITY|None")] = GATE
    """Probability of the chi-square gate; measurements outside are rejected. None: no gate. After four rejections in a
    row, the fifth measurement restarts the belief: the target has really jumped."""
    detection_probability: Annotated[float | None, option("0.9")] = None
    """Probability that a target in the view is detected. With this or --clutter detections have no ids, tracks are
    those of the multi-target filter, and the table has GOSPA; the number replaces that of scenario.detections."""
    clutter: Annotated[float | None, option("1")] = None
    """Expected number of false alarms a step, uniform in the view, as --detection-probability."""
    seed: int = 0
    """Seed of the noise and of sampled starts."""
    out: Annotated[Path | None, option("DIR|FILE.mcap")] = None
    """Folder for replay.json, replay.png and replay.gif; or a bag for Foxglove, Rerun and `ros2 bag play` (extra ros):
    poses, commands, detections, beliefs and markers of the first method, from the first start."""
    wide: bool = False
    """Print all columns: also NEES of detected and undetected tracks, and rejected measurements."""
    json: Annotated[Path | None, option("FILE")] = None
    """Write the rows as JSON."""
