"""`foveate evaluate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from foveate.cli.options import Command, option
from foveate.names import InitialError


@dataclass(kw_only=True)
class Evaluate(Command):
    """Score a policy, or policies made by hand, on scenes.

    surrogate: the paper's score; information grows softly, also for targets near the view. true: the Kalman filter
    that really runs; information only from real measurements. Every method gets the same scenes and the same noise.
    """

    run: Annotated[tyro.conf.Positional[str], option("RUN|PRESET")]
    """Run folder of `foveate train`, or a preset, of which the package brings a trained policy."""
    scenes: Annotated[str | None, option("FILE|table1|own")] = None
    """Scenes file; or table1, the paper's six cells of 30 scenes; or own, 30 scenes for each of three numbers of
    targets from the scenario's own distribution, none of which trained it (default: table1 in the plane, own in
    space)."""
    scene_seed: int = 2023
    """Seed of the scenes of table1 or own; table1 proper is the default."""
    protocol: Literal["surrogate", "true", "both"] = "both"
    """How information is counted."""
    method: tuple[str, ...] = ("policy",)
    """Any of policy, random, still, nearest, uncertain, lawnmower; or all."""
    episodes: int = 1
    """Noise draws per scene."""
    seed: int = 0
    """Seed of the noise."""
    initial_error: Annotated[InitialError | None, option("paper|consistent")] = None
    """How far first means are off: as a measurement is (paper: less than the belief claims), or as the first belief
    claims (consistent; default: as the scenario says)."""
    normalised: Annotated[bool, tyro.conf.arg(aliases=("--closeness",))] = False
    """Say how far each score gets from never seeing anything (0) to the omniscient planner (1). Its plans take about
    100 s for table1 on 2 cores, once: they are kept in the user's cache folder."""
    json: Annotated[Path | None, option("FILE")] = None
    """Write rows and summary for programs."""
    write_scenes: Annotated[Path | None, option("FILE")] = None
    """Write the scenes that were run as a scenes file."""
