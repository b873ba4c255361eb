"""The results of a study as files: table.md, table.json and figures."""

import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from foveate.evaluation.bounds import lower_bounds
from foveate.evaluation.evaluate import prepare
from foveate.experiment.presets import PPO
from foveate.experiment.run_folder import METRICS, read_validations
from foveate.io.files import write_atomic, write_document
from foveate.io.grouping import group_by
from foveate.io.provenance import provenance
from foveate.io.tables import markdown
from foveate.io.toml import digest
from foveate.plotting.animation import animate
from foveate.plotting.episode_data import EpisodeData, suite_data
from foveate.scenario.scenes import Scene
from foveate.study import robustness, tables
from foveate.study.comparison import Comparison, as_json, compare
from foveate.study.comparison_figures import duel_figure, learning_curves
from foveate.study.figures import pareto_figure, robustness_figure
from foveate.study.methods import Acting, Benchmark, can_train
from foveate.study.run import Results, trained_policy
from foveate.study.study import Study, benchmark_of

VERSION = 1
"""Of the files of comparisons."""

TABLE, DATA, EPISODES = "table.md", "table.json", "episodes"

RIVAL = "ppo"
"""Method drawn beside the reference; without it, the best heuristic."""


def publish(study: Study, out: Path, results: Results) -> list[Comparison]:
    """Write all files into the folder `out`, and return their contents: a comparison for each initial error."""
    page = _Page(study=study, out=out, results=results, benchmark=benchmark_of(study, study.initial_errors[0]))
    suite = page.benchmark.suite
    lowest, state_size = lower_bounds(suite.problem, suite.scenes), suite.problem.motion.state_size
    by_error = group_by(results.parts, lambda part: part.initial_error)
    comparisons = [compare(parts, study.reference, lowest, state_size) for parts in by_error.values()]
    write_document(out / DATA, "comparison", VERSION, as_json(comparisons, page.facts()))
    figures = dict(page.figures(comparisons[0]))
    if study.suite == "true-view" and not study.quick:
        page.animations(comparisons[0])
    shown = [table for each in comparisons for protocol in study.protocols for table in tables.tables(each, protocol)]
    if results.points:
        shown.append(tables.robustness(study.factors, results.points))
    write_atomic(out / TABLE, markdown(heading(study), page.conditions(), shown, figures).encode())
    return comparisons


def heading(study: Study) -> str:
    """Title of a study; a quick one says so."""
    scenes = f"{study.scenes_per_cell} scenes a cell"
    if study.quick:
        return f"QUICK LOOK, not a result: {scenes}, short trainings"
    return f"The true field of view, {scenes}" if study.suite == "true-view" else f"The paper's table 1, {scenes}"


@dataclass(frozen=True, kw_only=True)
class _Page:
    """Figures and facts of a study."""

    study: Study
    out: Path
    results: Results
    benchmark: Benchmark

    def figures(self, comparison: Comparison) -> Iterator[tuple[str, str]]:
        """Draw all figures, and yield their names and captions."""
        study, out, reference = self.study, self.out, self.study.reference
        pareto_figure(comparison.overall, out / "pareto.png")
        yield "pareto.png", "Score against the time of a decision"
        if self.results.trained:
            curves = {
                name: (group[0].experiment.training.select, [read_validations(each.run / METRICS) for each in group])
                for name, group in group_by(self.results.trained, lambda training: training.name).items()
            }
            learning_curves(curves, out / "learning.png")
            yield "learning.png", "Held-out score against environment steps: mean over seeds, worst to best"
        biased = [scene for scene in self.benchmark.suite.scenes if scene.motion == "biased"]
        scenes = [group[0] for group in group_by(biased, lambda scene: len(scene.targets)).values()]
        for protocol in study.protocols:
            if (rival := self._rival(comparison, protocol)) is not None:
                both = [self._episodes(name, study.seeds[0], protocol, scenes) for name in (reference, rival)]
                file = f"trajectories-{protocol}.png"
                duel_figure((reference, rival), list(zip(*both, strict=True)), out / file)
                yield file, f"{reference} and {rival} in the same scenes, {protocol} protocol"
        if points := self.results.points:
            protocol = study.protocols[0]
            facts = {**self.facts(), "protocol": protocol, "initial_error": study.initial_errors[0]}
            data = robustness.as_json(study.factors, points, facts)
            write_document(out / "robustness.json", "robustness", VERSION, data)
            verdicts = {factor.name: robustness.verdicts(factor, points) for factor in study.factors}
            robustness_figure(study.factors, verdicts, out / "robustness.png", f"{protocol} score [nat per target]")
            yield "robustness.png", "True score in scenarios that differ from training by one factor"

    def animations(self, comparison: Comparison) -> None:
        """Animate the reference's best and worst scene of every cell, by its first training seed."""
        part = next(part for part in comparison.parts if part.method == self.study.reference)
        scenes = {scene.id: scene for scene in self.benchmark.suite.scenes}
        chosen: dict[str, Scene] = {}
        for (targets, motion), rows in group_by(part.rows, lambda row: (row.targets, row.motion)).items():
            ranked = sorted(rows, key=lambda row: row.score or 0.0)
            chosen[f"{targets}-{motion}-easy"] = scenes[ranked[-1].scene]
            chosen[f"{targets}-{motion}-hard"] = scenes[ranked[0].scene]
        (self.out / EPISODES).mkdir(exist_ok=True)
        episodes = self._episodes(part.method, part.training_seed, part.protocol, list(chosen.values()))
        for name, data in zip(chosen, episodes, strict=True):
            animate(data, self.out / EPISODES / f"{name}.gif")

    def _episodes(self, name: str, seed: int | None, protocol: str, scenes: list[Scene]) -> list[EpisodeData]:
        method, experiment = self.study.method(name), self.benchmark.experiment
        assert isinstance(method, Acting), "only policies are drawn"
        policy = method.policy(experiment, trained_policy(self.out, method, seed))
        suite = prepare(self.benchmark.suite.problem, experiment.scenario.scenes, scenes, self.study.noise_seed)
        return suite_data(suite, policy, protocol, name)

    def _rival(self, comparison: Comparison, protocol: str) -> str | None:
        """The method to draw beside the reference; None unless both are policies."""
        policies = [method.name for method in self.study.methods if isinstance(method, Acting)]
        if self.study.reference not in policies:
            return None
        if RIVAL in policies and self.study.reference != RIVAL:
            return RIVAL
        heuristics = [m for m in comparison.overall if (m.protocol, m.family) == (protocol, "heuristic")]
        best = max(heuristics, key=lambda method: method.mean, default=None)
        return best.method if best is not None and best.method in policies else None

    def facts(self) -> dict[str, Any]:
        """The origin of the data, for programs."""
        study = self.study
        names = ("suite", "quick", "scene_seed", "scenes_per_cell", "targets", "noise_seed")
        return {
            **provenance(),
            **{name: getattr(study, name) for name in names},
            "scenes": "table1",
            "training_seeds": list(study.seeds),
            "scenario": digest(study.experiment),
            "trainings": [
                {"name": each.name, "seed": each.seed, "experiment": digest(each.experiment), **asdict(each.outcome)}
                for each in self.results.trained
            ],
        }

    def conditions(self) -> dict[str, str]:
        """The origin of the data, for readers."""
        study, made = self.study, provenance()
        outcomes = {f"{training.name}-{training.seed}": training.outcome for training in self.results.trained}
        rollbacks = [f"{name} ({outcome.rollbacks})" for name, outcome in outcomes.items() if outcome.rollbacks]
        stopped = [f"{name}: {outcome.stopped}" for name, outcome in outcomes.items() if outcome.stopped]
        missing = [name for name in PPO if study.suite == "paper" and not can_train(name)]
        return {
            "scenes": f"table1 with seed {study.scene_seed}, the first {study.scenes_per_cell} of each cell; "
            f"one noise draw a scene (seed {study.noise_seed}), the same for every method",
            "training seeds": ", ".join(map(str, study.seeds)) + " (trainings cut short)" * study.quick,
            "reference": study.reference,
            "collapsed trainings and their rollbacks": ", ".join(rollbacks) or "none",
            "trainings that stopped early": "; ".join(stopped) or "none",
            "left out, as the extra ppo is not installed": ", ".join(missing) or "nothing",
            "versions": f"foveate {made['foveate']}, jax {made['jax']}, {made['device']}, {os.cpu_count()} cores",
        }
