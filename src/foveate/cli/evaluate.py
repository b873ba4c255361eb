"""`foveate evaluate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from foveate.cli.options import option


@dataclass(kw_only=True)
class Evaluate:
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
    initial_error: Annotated[Literal["paper", "consistent"] | None, option("paper|consistent")] = None
    """How far first means are off: as a measurement is (paper: less than the belief claims), or as the first belief
    claims (consistent; default: as the scenario says)."""
    normalised: Annotated[bool, tyro.conf.arg(aliases=("--closeness",))] = False
    """Say how far each score gets from never seeing anything (0) to the omniscient planner (1). Its plans take about
    100 s for table1 on 2 cores, once: they are kept in the user's cache folder."""
    json: Annotated[Path | None, option("FILE")] = None
    """Write rows and summary for programs."""
    write_scenes: Annotated[Path | None, option("FILE")] = None
    """Write the scenes that were run as a scenes file."""

    def run_command(self) -> int:
        """Evaluate, print the summary, write the files."""
        from foveate.api import evaluate
        from foveate.cli.common import check_least, check_methods, check_output, check_seed, print_table
        from foveate.scenario.scenes import write_scenes

        methods = check_methods(self.method)
        for path in (self.json, self.write_scenes):
            check_output(path, *([self.scenes] if self.scenes else []))
        check_least("--episodes", self.episodes, 1)
        check_seed(self.seed)
        check_seed(self.scene_seed, "--scene-seed")
        found = evaluate(
            self.run,
            self.scenes,
            method=methods,
            protocol=self.protocol,
            episodes=self.episodes,
            seed=self.seed,
            scene_seed=self.scene_seed,
            initial_error=self.initial_error,
            normalised=self.normalised,
        )
        print_table(found.table.title, found.table.header, found.table.rows)
        if self.json is not None:
            found.to_json(self.json)
        if self.write_scenes is not None:
            write_scenes(self.write_scenes, found.scenes)
        return 0
