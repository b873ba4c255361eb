"""`foveate render`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from foveate.cli.common import check_video
from foveate.cli.options import Command, option
from foveate.names import ProtocolName


@dataclass(kw_only=True)
class Render(Command):
    """Draw episodes: an animation of one scene, or a figure with a row per scene (start, 1/3, 2/3, end).

    Noise is as in `foveate evaluate`: the figure shows the episode of its row with that scene and --seed.
    """

    run: Annotated[tyro.conf.Positional[str], option("RUN|PRESET|FILE.onnx")]
    """Run folder, exported file (.onnx), or name of a preset (its trained policy comes with the package)."""
    out: Annotated[Path, option("FILE.gif|.mp4|.png|.pdf|.svg")]
    """.gif or .mp4: an animation. .png, .pdf or .svg: four pictures per scene."""
    scene: Annotated[tuple[str, ...], option("ID ..")] = ()
    """Scenes to draw (default: the last of each number of targets; for an animation the last of all)."""
    scenes: Annotated[str | None, option("FILE|table1|own")] = None
    """Scenes file, table1 or own (default: table1 if the scenario's are the paper's, else own)."""
    scene_seed: int = 2023
    """Seed of the scenes of table1 or own."""
    protocol: ProtocolName = "true"
    """Source of information: the soft view (surrogate) or real measurements (true)."""
    method: Annotated[str, option("NAME")] = "policy"
    """policy, random, still, nearest, uncertain, lawnmower, price, window or post."""
    seed: int = 0
    """Seed of the noise."""
    width: Annotated[float, option("INCHES")] = 9.0
    """Width of a figure: 9 for a page, 3.5 for a column of a paper (two pictures per scene)."""
    dpi: int = 150
    """Dots per inch of a .png figure."""

    def check(self) -> None:
        """Raise InputError where inputs do not exist, or a video cannot be encoded."""
        super().check()
        check_video(self.out)
