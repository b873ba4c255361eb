"""`foveate plan`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from foveate.cli.options import Command, option


@dataclass(kw_only=True)
class Plan(Command):
    """Plan by gradient ascent on the controls, where a policy would decide.

    By default iCR as published, in receding horizon: at every step a new plan on the current belief, from the last
    one, at first straight ahead, under the paper's soft view; its first action is done. --open-loop: one plan, at the
    start. --starts N: better plans, also from tours of the targets, under a view that hardens on the way.
    --omniscient: the yardstick, which knows every future input and the true positions and feels no noise; its plans
    are kept in the user's cache folder. --run RUN --refine N: a trained policy's own sequence, improved by N steps at
    every decision. Rows and table are those of foveate evaluate, the scenes and the noise too.

      foveate plan --scenes table1 --omniscient
      foveate plan --scenes table1 --starts 16 --protocol true --json plan.json
      foveate plan --scenes table1 --run best --refine 15
    """

    scenes: Annotated[str | None, option("FILE|table1|own")] = None
    """Scenes file; or table1, the paper's six cells of 30 scenes; or own, 30 scenes for each of three numbers of
    targets from the scenario's own distribution (default: table1 in the plane, own in space)."""
    scene_seed: int = 2023
    """Seed of the scenes of table1 or own; table1 proper is the default."""
    preset: Annotated[str | None, option("NAME")] = None
    """Whose world to plan in."""
    config: Annotated[Path | None, option("FILE.toml")] = None
    """Experiment in place of a preset."""
    run: Annotated[str | None, option("RUN|PRESET")] = None
    """Run folder of foveate train, or a preset: its world, and with --refine its trained policy."""
    refine: Annotated[int | None, option("N")] = None
    """Steps of ascent from what the policy of --run would do."""
    omniscient: bool = False
    """Know the future."""
    open_loop: bool = False
    """Plan once, at the start."""
    starts: Annotated[int | None, option("N")] = None
    """Sequences to begin from (default: as published; omniscient: 64)."""
    iterations: Annotated[int | None, option("N")] = None
    """Steps of ascent of each (default: 30 a decision, as published 100; omniscient or open loop: 300)."""
    window: Annotated[int | None, option("K")] = None
    """Most steps that a plan at every step looks ahead; the end of the episode is known."""
    protocol: Literal["surrogate", "true", "both"] = "both"
    """How information is counted, and so what is planned for."""
    episodes: int = 1
    """Noise draws per scene."""
    seed: int = 0
    """Seed of the noise."""
    json: Annotated[Path | None, option("FILE")] = None
    """Write rows and summary for programs."""
