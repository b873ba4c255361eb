"""A suite of worlds: each a whole experiment in a file, trained, judged, and compared with heuristics and a planner."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from foveate.errors import InputError
from foveate.evaluation.held_out import HeldOut, Scores, held_out, planning_work, policy_scores
from foveate.evaluation.rivals import heuristics_of
from foveate.evaluation.verdict import Kind, planned_scores
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import PPOSettings
from foveate.experiment.presets import adjusted
from foveate.io.cache import Job
from foveate.io.toml import digest, load_toml
from foveate.planning.shooting import ONLINE, PlanSettings
from foveate.simulation.suites import SUITE_SEED
from foveate.study.jobs import (
    OnJob,
    Say,
    Trained,
    do_all,
    job_in,
    key_of,
    trained_policy,
    training_job,
    training_key,
    weights_digest,
)
from foveate.study.methods import FULL, Training

WORLDS = Path(__file__).parents[3] / "benchmarks" / "worlds"
"""Folder of the suite in a checkout of foveate."""

QUICK_CUT = 20
"""A quick training is shorter by this factor."""


@dataclass(frozen=True, kw_only=True)
class WorldsStudy:
    """Worlds by name, each trained with every one of `seeds` and judged on `episodes` held-out episodes.

    The planner, of `starts` starts, has the first `plans[1]` of them, or fewer, at least `plans[0]`, so that its work
    (see `planning_work`) stays below `work`: 8e9 take some three minutes on two cores.
    """

    worlds: dict[str, Experiment]
    seeds: tuple[int, ...] = FULL.seeds
    scene_seed: int = SUITE_SEED
    episodes: int = 256
    starts: int = 64
    plans: tuple[int, int] = (8, 32)
    work: float = 8e9
    quick: bool = False

    def __post_init__(self) -> None:
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise InputError(f"seeds = {self.seeds}: expected at least one, and each once")

    def planner(self, experiment: Experiment) -> tuple[int, PlanSettings]:
        """Episodes and settings of the planner in a world."""
        settings = replace(ONLINE[experiment.training.select], starts=self.starts)
        fewest, most = self.plans
        return int(np.clip(self.work // planning_work(experiment, settings), fewest, most)), settings


@dataclass(frozen=True, kw_only=True)
class Scored:
    """Score of a method in every held-out episode of a world; a planner that cannot plan there has a `note` alone."""

    world: str
    method: str
    kind: Kind
    training_seed: int | None = None
    scores: tuple[float, ...] = ()
    note: str = ""


def worlds_at(folder: Path, only: Sequence[str] = ()) -> dict[str, Experiment]:
    """Read the experiments of a folder by the names of their files; with `only`, those of these names."""
    files = {path.stem: path for path in sorted(folder.glob("*.toml"))}
    if not files:
        raise InputError(f"{folder}: holds no worlds: expected --worlds FOLDER of files NAME.toml")
    if unknown := [name for name in only if name not in files]:
        raise InputError(f"--only {unknown[0]}: expected names of {folder}: {', '.join(files)}")
    return {name: load_toml(Experiment, path) for name, path in files.items() if not only or name in only}


def worlds_study(worlds: dict[str, Experiment], quick: bool = False, **changes: Any) -> WorldsStudy:
    """The suite of these worlds; the quick one has one seed, short trainings, few episodes and a small planner."""
    if not quick:
        return WorldsStudy(worlds=worlds, **changes)
    short = {name: _shortened(experiment) for name, experiment in worlds.items()}
    sizes = {"seeds": (0,), "episodes": 32, "starts": 4, "plans": (4, 8), "work": 2e8, "quick": True}
    return WorldsStudy(worlds=short, **{**sizes, **changes})


def _shortened(experiment: Experiment) -> Experiment:
    training = experiment.training
    if isinstance(training, PPOSettings):
        return adjusted(experiment, steps=max(1, training.steps // QUICK_CUT))
    return adjusted(experiment, epochs=max(1, training.epochs // QUICK_CUT))


def reproduce_worlds(
    study: WorldsStudy, out: Path, on_progress: OnJob = lambda done, label: None, say: Say = lambda line: None
) -> tuple[list[Scored], list[Trained]]:
    """Do the jobs of a suite that are not done yet, and return the results of all. Raises as `do_all`."""
    records = do_all(out, world_jobs(study, out, say), on_progress, say)
    scored = [record for record in records if isinstance(record, Scored)]
    return scored, [record for record in records if isinstance(record, Trained)]


def world_jobs(study: WorldsStudy, out: Path, say: Say = lambda line: None) -> list[Job[Any]]:
    """All jobs in order, world after world: heuristics, planner, and for every seed its training and its scores."""
    jobs = []
    for name, experiment in study.worlds.items():
        world = _World(study=study, out=out, training=Training(name=name, experiment=experiment))
        jobs += [world.heuristics(), world.planner()]
        for seed in study.seeds:
            jobs += [training_job(out, world.training, seed, say), world.policy(seed)]
    return jobs


@dataclass(frozen=True, kw_only=True)
class _World:
    """Makes the jobs of a world; its training has its name."""

    study: WorldsStudy
    out: Path
    training: Training

    @property
    def experiment(self) -> Experiment:
        return self.training.experiment

    def heuristics(self) -> Job[Any]:
        """Job of all heuristics."""

        def compute(note: Say) -> list[Scored]:
            rules = heuristics_of(self.experiment)
            found = policy_scores(self._episodes(), rules, lambda done: note(f"{done} of {len(rules)}"))
            return [self._scored(name, "heuristic", scores) for name, scores in found.items()]

        return self._job("heuristics", lambda: [*heuristics_of(self.experiment)], compute)

    def planner(self) -> Job[Any]:
        """Job of the planner."""
        count, settings = self.study.planner(self.experiment)
        name = f"icr-{settings.starts}"

        def compute(note: Say) -> list[Scored]:
            scores = planned_scores(self._episodes(), settings, count, lambda done: note(f"{done} of {count} episodes"))
            if isinstance(scores, str):
                return [Scored(world=self.training.name, method=name, kind="planner", note=scores)]
            return [self._scored(name, "planner", scores)]

        return self._job("planner", lambda: [count, asdict(settings)], compute)

    def policy(self, seed: int) -> Job[Any]:
        """Job of the policy of a training seed."""

        def compute(note: Say) -> list[Scored]:
            policy = {"policy": trained_policy(self.out, self.training, seed)}
            (scores,) = policy_scores(self._episodes(), policy).values()
            return [self._scored("policy", "policy", scores, seed)]

        weights = partial(weights_digest, self.out, self.training, seed)
        return self._job(f"policy-{seed}", lambda: [training_key(self.training, seed), weights()], compute)

    def _job(self, what: str, method: Callable[[], list[Any]], compute: Callable[[Say], list[Scored]]) -> Job[Any]:
        words = {"scene_seed": self.study.scene_seed, "episodes": self.study.episodes}
        return job_in(
            self.out,
            f"{what}-{self.training.name}.json",
            label=f"{self.training.name}, {what}",
            key=lambda: key_of(world=digest(self.experiment), method=method(), **words),
            compute=compute,
            encode=lambda records: [asdict(record) for record in records],
            decode=lambda result: [Scored(**{**row, "scores": tuple(row["scores"])}) for row in result],
        )

    def _episodes(self) -> HeldOut:
        return held_out(self.experiment, self.study.episodes, self.study.scene_seed)

    def _scored(self, method: str, kind: Kind, scores: Scores, seed: int | None = None) -> Scored:
        name = self.training.name
        return Scored(world=name, method=method, kind=kind, training_seed=seed, scores=tuple(scores.tolist()))
