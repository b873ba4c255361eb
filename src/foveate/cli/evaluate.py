"""`foveate evaluate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from foveate.cli.options import Command, option
from foveate.names import InitialError


@dataclass(kw_only=True)
class Evaluate(Command):
    """Score policies and heuristics on scenes.

    surrogate: the paper's score; targets near the field of view give a part of the information. true: the Kalman
    filter; only real measurements give information. Every method gets the same scenes and the same noise.

      foveate evaluate true-view
      foveate evaluate runs/first true-view --method policy uncertain
    """

    run: Annotated[tyro.conf.Positional[tuple[str, ...]], option("RUN|PRESET|FILE.onnx ..")]
    """Run folder, exported file (.onnx), or name of a preset (its trained policy comes with the package). Of several,
    all run in the scenario of the first."""
    scenes: Annotated[str | None, option("FILE|table1|own")] = None
    """Scenes file; table1: the paper's six cells of 30 scenes; own: 30 scenes for each of three numbers of targets from
    the scenario's distribution, not used in training (default: table1 if that is the paper's, else own)."""
    scene_seed: int = 2023
    """Seed of the scenes of table1 or own; the default gives the paper's table 1."""
    protocol: Literal["surrogate", "true", "both"] = "both"
    """Source of information: the soft view (surrogate) or real measurements (true); see above."""
    method: Annotated[tuple[str, ...], option("NAME ..")] = ("policy",)
    """Any of policy, random, still, nearest, uncertain, lawnmower, price, window, post; or all. Without ids of
    detections also explore, alternate, lookahead. In a team also NAME+RULE with greedy, hungarian, auction: targets are
    assigned to robots."""
    episodes: int = 1
    """Noise draws per scene."""
    seed: int = 0
    """Seed of the noise."""
    initial_error: Annotated[InitialError | None, option("paper|consistent")] = None
    """Error of the initial means: that of a measurement (paper), or as large as the initial belief claims (consistent;
    default: as in the scenario)."""
    # tyro shows aliases first: the former name is the one that comes last.
    normalised: Annotated[bool, tyro.conf.arg(name="closeness", aliases=("--normalised",))] = False
    """Add the normalised score: 0 for never seeing anything, 1 for the omniscient planner (no bound), whose plans
    take 100 s for table1 on 2 cores the first time, and are then cached. Formerly --closeness."""
    wide: bool = False
    """Print all columns: also deviations, time in view, the longest gap, errors, and NEES of those never detected."""
    json: Annotated[Path | None, option("FILE")] = None
    """Write rows and summary as JSON."""
    write_scenes: Annotated[Path | None, option("FILE")] = None
    """Write the evaluated scenes to a scenes file."""
