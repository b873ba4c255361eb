"""The results of a study as files: table.md, table.json and figures."""

import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from foveate.evaluation.bounds import lower_bounds
from foveate.evaluation.evaluate import Row, prepare
from foveate.experiment.presets import PPO
from foveate.io.files import write_atomic, write_document
from foveate.io.provenance import provenance
from foveate.io.tables import markdown
from foveate.io.toml import digest
from foveate.plotting.animation import animate
from foveate.plotting.episode_data import EpisodeData, suite_data
from foveate.study.comparison import Comparison, as_json, compare
from foveate.study.figures import curve_of, duel_figure, learning_curves, pareto_figure
from foveate.study.figures_robustness import robustness_figure
from foveate.study.methods import Acting, Bench, can_train
from foveate.study.robustness import as_json as worlds_as_json
from foveate.study.robustness import verdicts
from foveate.study.run import Results, Trained, trained_policy
from foveate.study.study import RowsUnit, Study, bench_of
from foveate.study.tables import tables, worlds

VERSION = 1
"""Of the files of comparisons."""


TABLE, DATA = "table.md", "table.json"


ROBUSTNESS = "robustness.png"


EPISODES = "episodes"
"""Folder of moving pictures."""


RIVAL = "ppo"
"""Whom the reference meets in the pictures, if it is there; else the best method made by hand."""


def publish(study: Study, out: Path, results: Results) -> list[Comparison]:
    """Write all files into the folder `out`, and give what they show: a comparison for each first error."""
    bench, trained = bench_of(study, study.initial_errors[0]), results.trained
    problem = bench.suite.problem
    lowest = lower_bounds(problem, bench.suite.scenes)
    comparisons = []
    for error in study.initial_errors:
        parts = [part for part in results.parts if part.initial_error == error]
        comparisons.append(compare(parts, study.reference, lowest, problem.motion.state_size))
    write_document(out / DATA, "comparison", VERSION, as_json(comparisons, _facts(study, trained)))
    figures = {"pareto.png": "Score against the time of a decision"}
    pareto_figure(comparisons[0].overall, out / "pareto.png")
    if trained:
        figures["learning.png"] = "Held-out score against environment steps and time: mean over seeds, worst to best"
        learning_curves(_curves(trained), out / "learning.png")
    for protocol in study.protocols:
        if (rival := _rival(study, comparisons[0], protocol)) is not None:
            file = f"trajectories-{protocol}.png"
            figures[file] = f"{study.reference} and {rival.name} in the same scenes, {protocol} protocol"
            duel_figure((study.reference, rival.name), _duels(study, bench, out, rival, protocol), out / file)
    if results.points:
        figures[ROBUSTNESS] = "True score in worlds that differ from training by one factor"
        _robustness(study, out, results)
    if study.suite == "true-view" and not study.quick:
        _episodes(study, bench, out, comparisons[0])
    found = [table for one in comparisons for protocol in study.protocols for table in tables(one, protocol)]
    if results.points:
        found.append(worlds(study.factors, results.points))
    text = markdown(heading(study), _conditions(study, trained), found, figures)
    write_atomic(out / TABLE, text.encode())
    return comparisons


def _robustness(study: Study, out: Path, results: Results) -> None:
    found = {factor.name: verdicts(factor, results.points) for factor in study.factors}
    label = f"{study.protocols[0]} score [nat per target]"
    robustness_figure(study.factors, found, out / ROBUSTNESS, label)
    about = {"protocol": study.protocols[0], "initial_error": study.initial_errors[0]}
    facts = {**_facts(study, results.trained), **about}
    write_document(out / "robustness.json", "robustness", VERSION, worlds_as_json(study.factors, results.points, facts))


def _episodes(study: Study, bench: Bench, out: Path, comparison: Comparison) -> None:
    """Moving pictures of the reference's best and worst scene in every cell, by its first training seed."""
    method = next(one for one in study.methods if one.name == study.reference)
    assert isinstance(method, Acting), "the reference of this suite is a policy"
    part = next(part for part in comparison.parts if part.method == study.reference)
    unit = RowsUnit(method=method, seed=part.training_seed, protocol=part.protocol)
    trained = None if unit.training is None else trained_policy(out, unit.training)
    cells: dict[tuple[str, int], list[Row]] = {}
    for row in part.rows:
        cells.setdefault((row.motion, row.targets), []).append(row)
    chosen = {}
    for (motion, targets), rows in cells.items():
        ranked = sorted(rows, key=lambda row: row.score if row.score is not None else 0.0)
        chosen |= {f"{targets}-{motion}-{word}": row.scene for word, row in (("easy", ranked[-1]), ("hard", ranked[0]))}
    by_id = {scene.id: scene for scene in bench.suite.scenes}
    scenes = [by_id[scene] for scene in chosen.values()]
    suite = prepare(bench.suite.problem, bench.world.scenario.scenes, scenes, study.noise_seed)
    (out / EPISODES).mkdir(exist_ok=True)
    for name, shot in zip(
        chosen, suite_data(suite, method.policy(bench.world, trained), part.protocol, method.name), strict=True
    ):
        animate(shot, out / EPISODES / f"{name}.gif")


def heading(study: Study) -> str:
    """What a study is, in a line; a quick one says so."""
    scenes = f"{study.scenes_per_cell} scenes a cell"
    if study.quick:
        return f"QUICK LOOK, not a result: {scenes}, short trainings"
    return f"The true field of view, {scenes}" if study.suite == "true-view" else f"The paper's table 1, {scenes}"


def _facts(study: Study, trained: Sequence[Trained]) -> dict[str, Any]:
    """What the data were made with."""
    return {
        **provenance(),
        "suite": study.suite,
        "scenes": "table1",
        "quick": study.quick,
        "scene_seed": study.scene_seed,
        "scenes_per_cell": study.scenes_per_cell,
        "targets": study.targets,
        "noise_seed": study.noise_seed,
        "training_seeds": list(study.seeds),
        "world": digest(study.world),
        "trainings": [
            {"name": one.name, "seed": one.seed, "experiment": digest(one.experiment), **asdict(one.outcome)}
            for one in trained
        ],
    }


def _conditions(study: Study, trained: Sequence[Trained]) -> dict[str, str]:
    """The same for readers."""
    stopped = [f"{one.name}-{one.seed}: {one.outcome.stopped}" for one in trained if one.outcome.stopped]
    missing = [name for name in PPO if study.suite == "paper" and not can_train(name)]
    made = provenance()
    rollbacks = [f"{one.name}-{one.seed} ({one.outcome.rollbacks})" for one in trained if one.outcome.rollbacks]
    return {
        "scenes": f"table1 with seed {study.scene_seed}, the first {study.scenes_per_cell} of each cell; "
        f"one noise draw a scene (seed {study.noise_seed}), the same for every method",
        "training seeds": ", ".join(map(str, study.seeds)) + (" (trainings cut short)" if study.quick else ""),
        "reference": study.reference,
        "collapsed trainings that went back to their best": ", ".join(rollbacks) or "none",
        "trainings that stopped early": "; ".join(stopped) or "none",
        "left out, as the extra ppo is not installed": ", ".join(missing) or "nothing",
        "versions": f"foveate {made['foveate']}, jax {made['jax']}, {made['device']}, {os.cpu_count()} cores",
    }


def _curves(trained: Sequence[Trained]):
    """The learning curves by learner, and the protocol that judged each."""
    found: dict[str, tuple[str, list]] = {}
    for one in trained:
        select = one.experiment.training.select
        found.setdefault(one.name, (select, []))[1].append(curve_of(one.run))
    return found


def _rival(study: Study, comparison: Comparison, protocol: str) -> Acting | None:
    """Whom the reference is drawn with; None where one of the two is no policy."""
    methods = {method.name: method for method in study.methods if isinstance(method, Acting)}
    if study.reference not in methods:
        return None
    if RIVAL in methods and study.reference != RIVAL:
        return methods[RIVAL]
    by_hand = [one for one in comparison.overall if one.protocol == protocol and one.family == "made by hand"]
    best = max(by_hand, key=lambda one: one.mean, default=None)
    return None if best is None else methods.get(best.method)


def _duels(
    study: Study, bench: Bench, out: Path, rival: Acting, protocol: str
) -> list[tuple[EpisodeData, EpisodeData]]:
    """Both in the first biased scene of every number of targets; of trained ones the policy of the first seed."""
    first: dict[int, Any] = {}
    for scene in bench.suite.scenes:
        if scene.motion == "biased":
            first.setdefault(len(scene.targets), scene)
    scenes = list(first.values())
    suite = prepare(bench.suite.problem, bench.world.scenario.scenes, scenes, study.noise_seed)
    shown = []
    for method in (next(one for one in study.methods if one.name == study.reference), rival):
        assert isinstance(method, Acting)
        unit = RowsUnit(method=method, seed=study.seeds[0], protocol=protocol)
        policy = None if unit.training is None else trained_policy(out, unit.training)
        shown.append(suite_data(suite, method.policy(study.world, policy), protocol, method.name))
    return list(zip(*shown, strict=True))
