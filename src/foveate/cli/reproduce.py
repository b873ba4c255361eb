"""`foveate reproduce`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from foveate.cli.options import Command, option
from foveate.io.jax_settings import compile_fast


@dataclass(kw_only=True)
class Reproduce(Command):
    """Reproduce a comparison: all learners and methods on the same scenes, with tables and figures.

    The paper's comparison has learners with three seeds, planners, a policy refined by a planner, heuristics, and the
    omniscient planner as a reference, under both protocols. The folder --out gets table.md, table.json (every episode,
    the summary with normalised scores, paired differences to the reference), figures, and a run folder per training.
    Ctrl-C is safe: the same command resumes, and other settings recompute only the jobs that depend on them.

    The suite of worlds compares, in each of a folder's experiments, the policies that it trains with every heuristic
    and a planner of 64 starts, by the objective of that experiment (worlds.md, worlds.json).

      foveate reproduce --quick                              # a preview: minutes
      foveate reproduce                                      # all, in about 1.5 h
      foveate reproduce --suite true-view                    # detections alone
      foveate reproduce --scene-seed 7 --out runs/seed-7     # other scenes
      foveate reproduce --add examples/own_method.py:METHOD  # your own method
      foveate reproduce --suite worlds --only paper pan      # two of the worlds
    """

    suite: Literal["paper", "true-view", "worlds"] = "paper"
    """paper: the paper's table 1, with its figures. true-view: the same scenes, where only real detections count, with
    the paper's initial errors and consistent ones; also filter consistency (NEES), scores in scenarios that differ from
    training (robustness.png, robustness.json), and animations of easy and hard scenes (episodes/). worlds: the
    experiments of a folder, each in its own scenario."""
    quick: bool = False
    """One seed, a short training, 3 scenes per cell of 3 and 5 targets, fewer planners; every output is marked. For
    worlds: one seed, a twentieth of each training, 32 episodes, a planner of 4 starts."""
    seeds: Annotated[tuple[int, ...] | None, option("INT ..")] = None
    """Training seeds (default: 0 10 100; quick: 0)."""
    scene_seed: int = 2023
    """Seed of the scenes; the default gives the paper's table 1."""
    worlds: Annotated[Path | None, option("FOLDER")] = None
    """Folder of the experiments NAME.toml of the suite worlds (default: benchmarks/worlds of the checkout)."""
    only: Annotated[tuple[str, ...], option("NAME ..")] = ()
    """Worlds to run (default: all)."""
    add: Annotated[tuple[str, ...], option("FILE.py:NAME ..")] = ()
    """Your own methods: `foveate.Method` records, or tuples of them, in Python files, which are executed."""
    out: Annotated[Path | None, option("DIR")] = None
    """Output folder (default: runs/reproduce, with -true-view, -worlds and -quick appended as they apply)."""
    json: Annotated[Path | None, option("FILE")] = None
    """Write the results, which the output folder holds as JSON too, also to this file."""

    def prepare(self) -> None:
        """Compile fast where compilation is most of the time; use every core for the trainings of worlds."""
        if self.quick:
            compile_fast()
        if self.suite == "worlds":
            from foveate.learning.devices import use_cores

            use_cores()

    @property
    def folder(self) -> Path:
        """The output folder."""
        suite = "" if self.suite == "paper" else f"-{self.suite}"
        return self.out or Path("runs") / f"reproduce{suite}{'-quick' * self.quick}"
