"""`foveate view`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from foveate.cli.options import Command, option
from foveate.names import ProtocolName


@dataclass(kw_only=True)
class View(Command):
    """Play episodes in the browser, in 3-D: the agent with its view, targets, beliefs, and what is known of each.

    Serves a page at 127.0.0.1, for this machine only, until ctrl-C; or, with --record, writes one episode as a page
    that plays without a server. The same chance as in `foveate evaluate` and `foveate replay`.
    """

    run: Annotated[tyro.conf.Positional[str], option("RUN|PRESET")]
    """Run folder of `foveate train`, or a preset, of which the package brings a trained policy."""
    scenes: Annotated[str | None, option("FILE|table1|own")] = None
    """Where scenes come from (default: table1 in the plane, own in space)."""
    recording: Annotated[Path | None, option("RECORDING.csv")] = None
    """Drive through a recording of real targets in the place of scenes."""
    start: Annotated[float | None, option("SECONDS")] = None
    """Begin the recording here [s]."""
    end: Annotated[float | None, option("SECONDS")] = None
    """End the recording here [s]."""
    max_gap: Annotated[float | None, option("SECONDS")] = None
    """Longest gap between two fixes over which a target of the recording counts as present [s] (default: 2 s, or three
    fixes of a slow clock)."""
    port: int = 8080
    """Where to serve the page."""
    record: Annotated[Path | None, option("FILE.html")] = None
    """Write a page that plays one episode without a server, and end."""
    scene: Annotated[str | None, option("NAME")] = None
    """The scene to begin with, or to record (default: the first)."""
    method: Annotated[str | None, option("NAME")] = None
    """The method to begin with, or to record: policy, random, still, nearest, uncertain or lawnmower."""
    protocol: ProtocolName = "true"
    """How information is counted; in a recording always the true way."""
    scene_seed: int = 2023
    """Seed of the scenes of table1 or own."""
    seed: int = 0
    """Seed of the noise."""
