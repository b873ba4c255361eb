"""`foveate view`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from foveate.cli.options import Command, option
from foveate.names import ProtocolName


@dataclass(kw_only=True)
class View(Command):
    """Show episodes in the browser, in 3-D: the agent with its field of view, targets, beliefs, and their information.

    Serves a page at 127.0.0.1, for this machine only, until Ctrl-C; or, with --record, writes one episode as a page
    that plays without a server. Noise is as in `foveate evaluate` and `foveate replay`.
    """

    run: Annotated[tyro.conf.Positional[str], option("RUN|PRESET")]
    """Run folder of `foveate train`, or name of a preset (its trained policy comes with the package)."""
    scenes: Annotated[str | None, option("FILE|table1|own")] = None
    """Scenes file, table1 or own (default: table1 in the plane, own in space)."""
    recording: Annotated[Path | None, option("RECORDING.csv")] = None
    """Recording of real targets, in place of scenes."""
    start: Annotated[float | None, option("SECONDS")] = None
    """Start of the part of the recording to use [s]."""
    end: Annotated[float | None, option("SECONDS")] = None
    """End of the part of the recording to use [s]."""
    max_gap: Annotated[float | None, option("SECONDS")] = None
    """Longest gap between two fixes over which a target of the recording counts as present [s] (default: 2 s, or three
    fixes of a slow clock)."""
    port: int = 8080
    """Port of the page."""
    record: Annotated[Path | None, option("FILE.html")] = None
    """Write a page that plays one episode without a server, and exit."""
    scene: Annotated[str | None, option("NAME")] = None
    """Scene to show first, or to record (default: the first)."""
    method: Annotated[str | None, option("NAME")] = None
    """Method to show first, or to record: policy, random, still, nearest, uncertain or lawnmower."""
    protocol: ProtocolName = "true"
    """Source of information: the soft view (surrogate) or real measurements (true); on a recording always true."""
    scene_seed: int = 2023
    """Seed of the scenes of table1 or own."""
    seed: int = 0
    """Seed of the noise."""
