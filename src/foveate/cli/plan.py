"""`foveate plan`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from foveate.cli.options import Command, option


@dataclass(kw_only=True)
class Plan(Command):
    """Evaluate a planner (gradient ascent on the controls) in place of a policy.

    The default is iCR as published, in receding horizon: at every step a new plan for the current belief, starting
    from the last plan (at first straight ahead), under the paper's soft view; its first action is executed.
    --starts N: better plans, from tours of the targets too, under a view that hardens as the ascent proceeds.
    --open-loop: one plan, at the start. --omniscient: a reference (no bound), which knows all inputs and true
    positions, without noise; its plans are cached. --run RUN --refine N: the actions of a trained policy, improved by N
    ascent steps at every decision. The robots of a team plan in turn. Scenes, noise and table are those of `foveate
    evaluate`.

      foveate plan --scenes table1 --omniscient
      foveate plan --scenes table1 --starts 16 --protocol true --json plan.json
      foveate plan --scenes table1 --run best --refine 15
    """

    scenes: Annotated[str | None, option("FILE|table1|own")] = None
    """Scenes file, table1 or own (default: table1 if the scenario's are the paper's, else own)."""
    scene_seed: int = 2023
    """Seed of the scenes of table1 or own; the default gives the paper's table 1."""
    preset: Annotated[str | None, option("NAME")] = None
    """Preset whose scenario to plan in (default: paper)."""
    config: Annotated[Path | None, option("FILE.toml")] = None
    """Experiment in place of a preset."""
    run: Annotated[str | None, option("RUN|PRESET")] = None
    """Run folder or preset whose scenario to plan in; with --refine its policy is improved."""
    refine: Annotated[int | None, option("N")] = None
    """Ascent steps from the actions of the policy of --run."""
    omniscient: bool = False
    """Know all inputs and true positions in advance."""
    open_loop: bool = False
    """Plan once, at the start."""
    starts: Annotated[int | None, option("N")] = None
    """Initial action sequences (default: as published; omniscient: 64)."""
    iterations: Annotated[int | None, option("N")] = None
    """Ascent steps of each (default: 30 per decision, as published 100; omniscient or open loop: 300)."""
    window: Annotated[int | None, option("K")] = None
    """Longest horizon of a receding-horizon plan [steps]; the end of the episode is known (default: 30)."""
    protocol: Literal["surrogate", "true", "both"] = "both"
    """Source of information: the soft view (surrogate) or real measurements (true), in planning and in evaluation."""
    episodes: int = 1
    """Noise draws per scene."""
    seed: int = 0
    """Seed of the noise."""
    wide: bool = False
    """Print all columns: also deviations, time in view, the longest gap, errors, and NEES of those never detected."""
    json: Annotated[Path | None, option("FILE")] = None
    """Write rows and summary as JSON."""
