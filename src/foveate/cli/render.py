"""`foveate render`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from foveate.cli.options import Command, option
from foveate.names import ProtocolName


@dataclass(kw_only=True)
class Render(Command):
    """Draw episodes: a moving picture of one scene, or its course (start, 1/3, 2/3, end), a row a scene.

    The same chance as in `foveate evaluate`: what is drawn is the row of its table with that scene and --seed.
    """

    run: Annotated[tyro.conf.Positional[str], option("RUN|PRESET")]
    """Run folder of `foveate train`, or a preset, of which the package brings a trained policy."""
    out: Annotated[Path, option("FILE.gif|.mp4|.png|.pdf|.svg")]
    """.gif or .mp4: the episode as it unfolds. .png, .pdf or .svg: its course in four pictures."""
    scene: Annotated[tuple[str, ...], option("ID ..")] = ()
    """Which scenes (default: the last of each number of targets; the last of all for a moving picture)."""
    scenes: Annotated[str | None, option("FILE|table1|own")] = None
    """Where they come from (default: table1 in the plane, own in space)."""
    scene_seed: int = 2023
    """Seed of the scenes of table1 or own."""
    protocol: ProtocolName = "true"
    """How information is counted."""
    method: str = "policy"
    """policy, random, still, nearest, uncertain or lawnmower."""
    seed: int = 0
    """Seed of the noise."""
