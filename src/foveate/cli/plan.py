"""`foveate plan`."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from foveate.cli.options import option
from foveate.errors import InputError

if TYPE_CHECKING:
    from foveate.evaluation.evaluate import Row
    from foveate.experiment.experiment import Experiment
    from foveate.planning.shooting import PlanSettings
    from foveate.scenario.scenes import Scene
    from foveate.simulation.records import Policy


@dataclass(kw_only=True)
class Plan:
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

    def run_command(self) -> int:
        """Plan, print the summary, write the file."""
        from foveate.cli.common import check_output, check_seed, print_table
        from foveate.evaluation.report import summary_table
        from foveate.evaluation.summary import summarise, write_result
        from foveate.experiment.resolve import scenes_of
        from foveate.io.progress import Bar
        from foveate.io.toml import digest
        from foveate.scenario.scenes import scenes_digest

        check_output(self.json, *([self.scenes] if self.scenes else []))
        check_seed(self.seed)
        check_seed(self.scene_seed, "--scene-seed")
        self._check_options()
        experiment = self._experiment()
        chosen, scenes = scenes_of(self.scenes, self.scene_seed, experiment)
        protocols = ("surrogate", "true") if self.protocol == "both" else (self.protocol,)
        rows = []
        with Bar("planning", len(scenes) * self.episodes * len(protocols), "episodes") as bar:
            for protocol in protocols:
                before = len(rows)
                rows += self._rows(experiment, scenes, protocol, lambda done, b=before: bar.update(b + done))
        summary = summarise(rows, experiment.scenario.problem().motion.state_size)
        title = f"plans on {chosen}: score per target [nat], {self.episodes} episode(s) a scene"
        table = summary_table(title, summary)
        print_table(table.title, table.header, table.rows)
        if self.json is not None:
            facts = {"scenes": chosen, "scenes_digest": scenes_digest(scenes), "experiment": digest(experiment)}
            names = ("seed", "scene_seed", "run", "refine", "starts", "iterations", "window", "omniscient", "open_loop")
            asked = {name: str(value) if isinstance(value := getattr(self, name), Path) else value for name in names}
            write_result(self.json, rows, summary, {**facts, **asked})
        return 0

    def _check_options(self) -> None:
        """Raise ValueError where options are out of range, or say two things at once."""
        from foveate.cli.common import check_least

        check_least("--episodes", self.episodes, 1)
        check_least("--starts", self.starts, 1)
        check_least("--iterations", self.iterations, 1)
        check_least("--refine", self.refine, 1)
        check_least("--window", self.window, 1)
        if sum(world is not None for world in (self.run, self.config, self.preset)) > 1:
            raise InputError("--run, --config and --preset: each is a world to plan in; give one of them")
        if self.window is not None and (self.omniscient or self.open_loop):
            raise InputError(f"--window {self.window}: only a plan made anew at every step has one")
        if self.refine is not None and self.run is None:
            raise InputError(f"--refine {self.refine}: whose policy? give --run RUN")
        if self.omniscient and (self.open_loop or self.refine is not None):
            raise InputError("--omniscient: needs no --open-loop and no --refine: it knows the future")
        if self.refine is not None and (self.open_loop or self.starts is not None or self.iterations is not None):
            raise InputError("--refine N: begins at the policy's own sequence; no other option of plans fits")

    def _experiment(self) -> "Experiment":
        from foveate.experiment.experiment import Experiment
        from foveate.experiment.presets import PRESETS
        from foveate.experiment.resolve import experiment_of
        from foveate.io.toml import load_toml

        if self.config is not None:
            return load_toml(Experiment, self.config)
        if self.run is not None:
            return experiment_of(self.run)
        preset = self.preset or "paper"
        if preset not in PRESETS:
            raise InputError(f"--preset {preset}: presets are {', '.join(PRESETS)}")
        return PRESETS[preset]

    def _rows(self, experiment: "Experiment", scenes: "list[Scene]", protocol: str, report) -> "list[Row]":
        from foveate.evaluation.evaluate import prepare
        from foveate.evaluation.oracle import omniscient, omniscient_rows
        from foveate.evaluation.planners import planner, planner_rows
        from foveate.experiment.resolve import load
        from foveate.io.files import cache_folder
        from foveate.planning.receding import OpenLoop

        problem, settings = experiment.scenario.problem(), self._settings(protocol)
        suite = prepare(problem, experiment.scenario.scenes, scenes, self.seed, self.episodes)
        if self.omniscient:
            return omniscient_rows(
                suite, protocol, omniscient(suite, protocol, settings, cache_folder("plans"), report)
            )
        policy = None if self.refine is None or self.run is None else load(self.run)[1]

        def policy_of(horizon: int) -> "Policy":
            return (
                OpenLoop(problem, settings, horizon)
                if self.open_loop
                else planner(problem, settings, horizon, self.window or 30, policy)
            )

        return planner_rows(suite, experiment.scenario.scenes, self._name(), policy_of, protocol, report)

    def _settings(self, protocol: str) -> "PlanSettings":
        from foveate.planning.shooting import OMNISCIENT, ONLINE, PUBLISHED, refining

        if self.refine is not None:
            return refining(protocol, self.refine)
        settings = OMNISCIENT[protocol] if self.omniscient else ONLINE[protocol]
        if self.starts is None and not self.omniscient:
            settings = PUBLISHED
        if self.open_loop:
            settings = replace(settings, iterations=OMNISCIENT[protocol].iterations)
        if self.starts is not None:
            settings = replace(settings, starts=self.starts)
        if self.iterations is not None:
            settings = replace(settings, iterations=self.iterations)
        return settings

    def _name(self) -> str:
        """The method's name in rows: icr as published, icr-16 from 16 starts, icr-open, refine-15."""
        if self.refine is not None:
            return f"refine-{self.refine}"
        many = "" if self.starts is None else f"-{self.starts}"
        return f"icr{many}{'-open' * self.open_loop}"
