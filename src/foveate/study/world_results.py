"""Results of a suite of worlds: policy, best heuristic and planner in each, as tables, a page and JSON."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from foveate.evaluation.held_out import Scores
from foveate.evaluation.metrics import DIGITS, MEANINGS
from foveate.evaluation.statistics import mean_interval
from foveate.evaluation.verdict import CLEAR, standard_error
from foveate.experiment.run_folder import METRICS, read_validations
from foveate.io.files import write_atomic, write_document
from foveate.io.grouping import group_by
from foveate.io.provenance import provenance
from foveate.io.tables import Table, markdown
from foveate.io.toml import digest
from foveate.names import Objective, ProtocolName
from foveate.study.jobs import Trained
from foveate.study.worlds import Scored, WorldsStudy

VERSION = 1
"""Of the files of suites of worlds."""

TABLE, DATA = "worlds.md", "worlds.json"

NEAR_PLANNER = 0.95
"""Share of the way from the best heuristic to the planner that counts as all of it."""


@dataclass(frozen=True, kw_only=True)
class Lead:
    """The policy's score, mean over training seeds, minus a method's, in the same episodes, with its standard error."""

    method: str
    mean: float
    difference: float
    difference_se: float
    episodes: int

    @property
    def standard_errors(self) -> float:
        """The difference in standard errors; infinite without any."""
        if self.difference_se == 0.0:
            return float(np.sign(self.difference)) * np.inf if self.difference else 0.0
        return self.difference / self.difference_se


@dataclass(frozen=True, kw_only=True)
class WorldResult:
    """A world: the score by its objective of the policy (mean over training seeds), every heuristic and the planner.

    `ci95` is Student's interval of the policy's mean, episodes taken as independent and training seeds as fixed;
    `by_seed` has the mean of each. `heuristics` are sorted, the best first. `way`: share of the way from the best
    heuristic to the planner that the policy has gone, in the planner's episodes; None without a planner, or where it is
    no better than that heuristic. `no_planner` says why there is none. `training_s`: mean wall time of a training [s].
    """

    world: str
    objective: Objective
    protocol: ProtocolName
    mean: float
    ci95: tuple[float, float]
    by_seed: tuple[float, ...]
    episodes: int
    heuristics: tuple[Lead, ...]
    planner: Lead | None
    no_planner: str
    way: float | None
    training_s: float

    @property
    def beats_heuristics(self) -> bool:
        """True if the policy leads every heuristic by two standard errors."""
        return all(lead.standard_errors >= CLEAR for lead in self.heuristics)

    @property
    def reaches_planner(self) -> bool | None:
        """True if the policy is as good as the planner, or nearly; None without one."""
        if self.planner is None:
            return None
        return self.planner.difference >= 0 or (self.way is not None and self.way >= NEAR_PLANNER)

    def text(self, score: float) -> str:
        """A score as tables show it."""
        return f"{score:.{DIGITS[self.objective]}f}"


def world_results(study: WorldsStudy, scored: Sequence[Scored], trained: Sequence[Trained]) -> list[WorldResult]:
    """Results of every world, from the scores of its methods and the run folders of its trainings."""
    by_world, trainings = group_by(scored, lambda each: each.world), group_by(trained, lambda each: each.name)
    return [_result(study, name, by_world[name], trainings[name]) for name in study.worlds]


def _result(study: WorldsStudy, name: str, scored: Sequence[Scored], trained: Sequence[Trained]) -> WorldResult:
    of = {kind: [each for each in scored if each.kind == kind] for kind in ("policy", "heuristic", "planner")}
    by_seed = np.array([each.scores for each in of["policy"]])
    ours, (plan,) = by_seed.mean(axis=0), of["planner"]
    leads = sorted((_lead(each, ours) for each in of["heuristic"]), key=lambda lead: -lead.mean)
    planner = _lead(plan, ours) if plan.scores else None
    best = next(np.array(each.scores) for each in of["heuristic"] if each.method == leads[0].method)
    training = study.worlds[name].training
    return WorldResult(
        world=name,
        objective=training.objective,
        protocol=training.select,
        mean=float(ours.mean()),
        ci95=mean_interval(ours),
        by_seed=tuple(by_seed.mean(axis=1).tolist()),
        episodes=len(ours),
        heuristics=tuple(leads),
        planner=planner,
        no_planner=plan.note,
        way=None if planner is None else _way(ours, best, np.array(plan.scores)),
        training_s=float(np.mean([read_validations(each.run / METRICS)[-1].elapsed_s for each in trained])),
    )


def _lead(scored: Scored, ours: Scores) -> Lead:
    theirs = np.array(scored.scores)
    lead = ours[: len(theirs)] - theirs
    return Lead(
        method=scored.method,
        mean=float(theirs.mean()),
        difference=float(lead.mean()),
        difference_se=standard_error(lead),
        episodes=len(theirs),
    )


def _way(ours: Scores, heuristic: Scores, planner: Scores) -> float | None:
    """Share of the way from the heuristic to the planner, in the planner's episodes."""
    policy, lowest, highest = (float(each[: len(planner)].mean()) for each in (ours, heuristic, planner))
    return (policy - lowest) / (highest - lowest) if highest > lowest else None


def publish_worlds(study: WorldsStudy, out: Path, results: Sequence[WorldResult]) -> list[Table]:
    """Write worlds.json and worlds.md into the folder `out`; return the tables."""
    write_document(out / DATA, "worlds", VERSION, as_json(study, results))
    shown = tables(results)
    write_atomic(out / TABLE, markdown(heading(study), _conditions(study), shown, {}).encode())
    return shown


def heading(study: WorldsStudy) -> str:
    """Title of a suite; a quick one says so."""
    return "QUICK LOOK at the worlds, not a result: short trainings" if study.quick else "The suite of worlds"


def as_json(study: WorldsStudy, results: Sequence[WorldResult]) -> dict[str, Any]:
    """The results and their origin, for programs."""
    names = ("quick", "scene_seed", "episodes", "starts")
    worlds = [
        {
            **asdict(result),
            "beats_heuristics": result.beats_heuristics,
            "reaches_planner": result.reaches_planner,
            "experiment": digest(study.worlds[result.world]),
        }
        for result in results
    ]
    facts = {name: getattr(study, name) for name in names}
    return {**provenance(), **facts, "training_seeds": list(study.seeds), "worlds": worlds}


def _conditions(study: WorldsStudy) -> Mapping[str, str]:
    made, seeds = provenance(), ", ".join(map(str, study.seeds))
    return {
        "training seeds": seeds + " (trainings cut short)" * study.quick,
        "scenes": f"{study.episodes} a world, of its own distribution (seed {study.scene_seed}), none of which trained "
        "or selected a policy; the same with the same noise for every method",
        "versions": f"foveate {made['foveate']}, jax {made['jax']}, {made['device']}",
    }


def tables(results: Sequence[WorldResult]) -> list[Table]:
    """The worlds, one line each; then the scores of all heuristics, and of every training seed."""
    return [_worlds(results), _heuristics(results), _seeds(results)]


def _worlds(results: Sequence[WorldResult]) -> Table:
    def row(result: WorldResult) -> tuple[str, ...]:
        best, planner = result.heuristics[0], result.planner
        half = "-" if result.episodes < 2 else result.text((result.ci95[1] - result.ci95[0]) / 2)
        return (
            result.world,
            f"{best.method} {result.text(best.mean)}",
            f"{result.text(result.mean)} ± {half}",
            f"{best.standard_errors:+.1f}",
            "-" if planner is None else f"{result.text(planner.mean)} ({planner.episodes})",
            "-" if result.way is None else f"{result.way:.0%}",
            f"{result.training_s:.0f}",
        )

    meanings = "; ".join(f"{name}: {MEANINGS[name]}" for name in MEANINGS if name in {r.objective for r in results})
    return Table(
        title="Policy, best heuristic and planner",
        note=f"Scores by the objective that was trained for ({meanings}). Policy: mean over training seeds ± half of "
        "its 95 % interval. Lead: policy minus best heuristic, in standard errors of the paired difference. Planner: "
        "its mean in as many episodes as the brackets say. Way: share of the way from the best heuristic to the "
        "planner that the policy has gone, in these episodes; - where the planner is no better than that heuristic.",
        header=("world", "best heuristic", "policy", "lead [se]", "planner", "way", "training [s]"),
        rows=tuple(map(row, results)),
    )


def _heuristics(results: Sequence[WorldResult]) -> Table:
    names = sorted({lead.method for result in results for lead in result.heuristics})

    def row(result: WorldResult) -> tuple[str, ...]:
        means = {lead.method: result.text(lead.mean) for lead in result.heuristics}
        return result.world, result.objective, *(means[name] for name in names)

    return Table(
        title="Every heuristic",
        note="Mean scores in the same episodes.",
        header=("world", "objective", *names),
        rows=tuple(map(row, results)),
    )


def _seeds(results: Sequence[WorldResult]) -> Table:
    count = max(len(result.by_seed) for result in results)
    return Table(
        title="Every training",
        note="Mean score of the policy of each training seed, in their order.",
        header=("world", "objective", *(f"policy {i + 1}" for i in range(count))),
        rows=tuple((r.world, r.objective, *map(r.text, r.by_seed)) for r in results),
    )
