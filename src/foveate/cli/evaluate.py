"""`foveate evaluate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from foveate.closeness import Cell
    from foveate.evaluation import Suite
    from foveate.summary import Summary


@dataclass(kw_only=True)
class Evaluate:
    """Score a policy, or policies made by hand, on scenes.

    surrogate: the paper's score; information grows softly, also for targets near the view. true: the Kalman filter
    that really runs; information only from real measurements. Every method gets the same scenes and the same noise.
    """

    run: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN|PRESET")]
    """Run folder of `foveate train`; with hand-made methods a preset's name will do."""
    scenes: Annotated[str | None, tyro.conf.arg(metavar="FILE|table1|own")] = None
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
    initial_error: Literal["paper", "consistent"] | None = None
    """How far first means are off: as a measurement is (paper: less than the belief claims), or as the first belief
    claims (consistent; default: as the scenario says)."""
    closeness: bool = False
    """Say how far each score gets from never seeing anything (0) to the omniscient planner (1). Its plans take about
    100 s for table1 on 2 cores, once: they are kept in the user's cache folder."""
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Write rows and summary for programs."""
    write_scenes: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Write the scenes that were run as a scenes file."""

    def run_command(self) -> int:
        """Evaluate, print the summary, write the files."""
        from foveate.cli.common import (
            Bar,
            check_least,
            check_methods,
            check_output,
            check_seed,
            experiment_of,
            policy_of,
            print_summary,
            scenes_of,
            with_initial_error,
        )
        from foveate.closeness import floors
        from foveate.configuration import digest
        from foveate.evaluation import evaluate, prepare
        from foveate.files import write_json
        from foveate.scenes import write_scenes
        from foveate.summary import result, summarise

        methods = check_methods(self.method)
        for path in (self.json, self.write_scenes):
            check_output(path, *([self.scenes] if self.scenes else []))
        check_least("--episodes", self.episodes, 1)
        check_seed(self.seed)
        check_seed(self.scene_seed, "--scene-seed")
        experiment = with_initial_error(experiment_of(self.run), self.initial_error)
        problem, settings = experiment.scenario.problem(), experiment.scenario.scenes
        chosen, scenes = scenes_of(self.scenes, self.scene_seed, experiment)
        policies = {name: policy_of(self.run, name, experiment) for name in methods}
        suite = prepare(problem, settings, scenes, self.seed, self.episodes)
        protocols = ("surrogate", "true") if self.protocol == "both" else (self.protocol,)
        lowest = floors(problem, scenes) if self.closeness else {}
        rows = []
        with Bar("evaluating", len(policies), "methods") as bar:
            for done, (name, policy) in enumerate(policies.items()):
                bar.update(done, name)
                rows += evaluate(suite, name, policy, protocols)
        summary = summarise(rows, problem.motion.state_size)
        if self.closeness:
            summary = _judged(summary, suite, protocols, lowest)
        print_summary(f"{self.run} on {chosen}", self.episodes, summary)
        if self.json is not None:
            facts = {"run": self.run, "scenes": chosen, "experiment": digest(experiment)}
            facts["initial_error"] = settings.initial_error
            write_json(self.json, result(rows, summary, facts))
        if self.write_scenes is not None:
            write_scenes(self.write_scenes, scenes)
        return 0


def _judged(
    summary: "list[Summary]", suite: "Suite", protocols: "tuple[str, ...]", lowest: "dict[Cell, float]"
) -> "list[Summary]":
    """The summary with the closeness of each cell."""
    from foveate.cli.common import Bar
    from foveate.closeness import ceiling_rows, with_closeness
    from foveate.summary import summarise

    count, rows = len(suite.scenes) * suite.episodes_per_scene, []
    with Bar("omniscient plans", count * len(protocols), "episodes") as bar:
        for protocol in protocols:
            before = len(rows)
            rows += ceiling_rows(suite, protocol, lambda done, before=before: bar.update(before + done))
    ceiling = summarise(rows, suite.problem.motion.state_size)
    return with_closeness(summary, ceiling, lowest)
