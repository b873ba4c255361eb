"""Jobs of a comparison, each kept in a file when it is done: the same command resumes an interrupted comparison.

A job is a training, the rows of a method for one training seed and protocol, or its scores under a factor.
"""

import hashlib
import json
import math
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

from foveate import __version__
from foveate.errors import InputError
from foveate.evaluation.evaluate import Row
from foveate.experiment.checkpoint import load_run
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PPOSettings
from foveate.experiment.run_folder import BEST, LAST, Outcome, Validation, outcome_of
from foveate.io.cache import Job
from foveate.io.files import sole_writer, write_atomic
from foveate.io.grouping import group_by
from foveate.io.toml import digest
from foveate.learning.train import train
from foveate.names import InitialError
from foveate.scenario.factors import Factor
from foveate.simulation.records import Policy
from foveate.study.comparison import Part
from foveate.study.methods import Benchmark, Method, Training, check_rows
from foveate.study.robustness import Point, measure, point_of
from foveate.study.study import Study, benchmark_of, changed_benchmarks

VERSION = 1
"""Of the files of jobs; raised, too, when a method gives other rows than before."""
JOBS, TRAININGS = "units", "trainings"
"""Folders of the results of jobs, and of run folders."""
Say = Callable[[str], None]
"""Takes a line for the user."""


@dataclass(frozen=True, kw_only=True)
class Trained:
    """A completed training and its outcome."""

    name: str
    seed: int
    run: Path
    experiment: Experiment
    outcome: Outcome


class Results(NamedTuple):
    """Results of all jobs: rows on the suite, trainings, scores in changed scenarios."""

    parts: list[Part]
    trained: list[Trained]
    points: list[Point]


def reproduce(
    study: Study,
    out: Path,
    on_progress: Callable[[int, str], None] = lambda done, label: None,
    say: Say = lambda line: None,
) -> Results:
    """Do the jobs of a study that are not done yet, and return the results of all.

    `on_progress` takes the number of completed jobs and a line about the current one. Raises InputError while another
    process works in `out`.
    """
    (out / JOBS).mkdir(parents=True, exist_ok=True)
    records: list[Any] = []
    with sole_writer(out):
        for done, job in enumerate(jobs(study, out, say)):

            def note(line: str, done: int = done, label: str = job.label) -> None:
                on_progress(done, f"{label}: {line}")

            note("beginning")
            records += job.result(note, on_rejected=say)
    by_kind = group_by(records, type)
    return Results(by_kind.get(Part, []), by_kind.get(Trained, []), by_kind.get(Point, []))


def jobs(study: Study, out: Path, say: Say = lambda line: None) -> list[Job[Any]]:
    """All jobs in order: a training comes before the first job that needs it."""
    factory, ordered = _Factory(study=study, out=out, say=say), dict[Path, Job[Any]]()
    policies = [(method, seed) for method in study.methods for seed in study.seeds_of(method)]
    work = [
        (*policy, factory.rows(*policy, protocol, error))
        for policy in policies for error in study.initial_errors for protocol in study.protocols
    ]  # fmt: skip
    robust = [(method, seed) for method, seed in policies if method.name in study.robust]
    work += [(*policy, factory.points(*policy, factor)) for factor in study.factors for policy in robust]
    for method, seed, job in work:
        if method.training is not None and seed is not None:
            training = factory.training(method.training, seed)
            ordered.setdefault(training.path, training)
        if job.path in ordered:
            raise InputError(f"method {method.name}: its file {job.path.name} is another method's: rename it")
        ordered[job.path] = job
    return list(ordered.values())


def trained_policy(out: Path, method: Method, seed: int | None) -> Policy | None:
    """Load the policy that the method's training gave for a seed; None for a method without training."""
    return None if method.training is None else load_run(out / TRAININGS / f"{method.training.name}-{seed}")[1]


@dataclass(frozen=True, kw_only=True)
class _Factory:
    """Makes the jobs of a study whose results are kept in `out`."""

    study: Study
    out: Path
    say: Say

    def _job(self, file: str, **fields: Any) -> Job[Any]:
        return Job(path=self.out / JOBS / file, kind="unit", version=VERSION, **fields)

    @cached_property
    def benchmarks(self) -> dict[InitialError | None, Benchmark]:
        return {error: benchmark_of(self.study, error) for error in self.study.initial_errors}

    @cached_property
    def changed(self) -> dict[str, dict[float, Benchmark]]:
        return {factor.name: changed_benchmarks(self.study, factor) for factor in self.study.factors}

    def training(self, training: Training, seed: int) -> Job[Any]:
        """Job of a training, into its own run folder."""
        run = self.out / TRAININGS / f"{training.name}-{seed}"

        def records(outcome: Outcome) -> list[Trained]:
            if not (run / BEST).exists():
                raise InputError(f"{run}: has no weights")
            return [Trained(name=training.name, seed=seed, run=run, experiment=training.experiment, outcome=outcome)]

        return self._job(
            f"training-{run.name}.json",
            label=f"training {run.name}",
            key=lambda: _training_key(training, seed),
            compute=lambda note: records(self._train(training, seed, run, note)),
            encode=lambda records: asdict(records[0].outcome),
            decode=lambda result: records(outcome_of(result)),
        )

    def _train(self, training: Training, seed: int, run: Path, note: Say) -> Outcome:
        """Resume the run folder if it was begun under the same key; else train from the start."""
        experiment, key = training.experiment, _training_key(training, seed)
        is_ppo = isinstance(experiment.training, PPOSettings)

        def report(validation: Validation, total: int) -> None:
            done = validation.env_steps if is_ppo else validation.epoch
            note(f"{done} of {total}, held-out {validation.held_out:.2f}")
            if validation.event:
                self.say(f"{run}: iteration {validation.epoch}: {validation.event}")

        outcome, mark = None, self.out / JOBS / f"training-{run.name}.begun"
        is_begun = all(path.exists() for path in (mark, run / LAST, run / BEST)) and mark.read_text() == key
        if is_begun and not is_ppo:  # PPO cannot resume
            try:
                outcome = train(experiment, run, seed, True, report)
            except InputError as error:
                self.say(str(error))
        if outcome is None:
            if run.exists():
                self.say(f"{run}: cannot be resumed: trained again")
                shutil.rmtree(run)
            write_atomic(mark, key.encode())
            outcome = train(experiment, run, seed, False, report)
        if not math.isfinite(outcome.best_score):
            raise InputError(f"{run}: no validation was finite, so there is no policy: {outcome.stopped}")
        return outcome

    def rows(self, method: Method, seed: int | None, protocol: str, error: InitialError | None) -> Job[Any]:
        """Job of a method on all scenes of the suite."""
        words = [_label(method, seed), protocol, *([] if error is None else [error])]
        about = {"method": method.name, "family": method.family, "training_seed": seed, "protocol": protocol}
        part = partial(Part, **about, initial_error=error)

        def compute(note: Say) -> list[Part]:
            benchmark, policy = self.benchmarks[error], trained_policy(self.out, method, seed)
            total = len(benchmark.suite.scenes)
            rows = method.rows(benchmark, protocol, policy, lambda done: note(f"{done} of {total} episodes"))
            check_rows(rows, benchmark.suite, method.name, protocol)
            return [part(rows=tuple(rows))]

        return self._job(
            f"rows-{'-'.join(words)}.json",
            label=", ".join(words),
            key=lambda: self._key(method, seed, protocol, [self.benchmarks[error]]),
            compute=compute,
            encode=lambda parts: [asdict(row) for row in parts[0].rows],
            decode=lambda result: [part(rows=tuple(Row(**row) for row in result))],
        )

    def points(self, method: Method, seed: int | None, factor: Factor) -> Job[Any]:
        """Job of a method in all scenarios of a factor, under the first protocol."""
        protocol, label = self.study.protocols[0], _label(method, seed)
        point = partial(Point, factor=factor.name, method=method.name, training_seed=seed)

        def compute(note: Say) -> list[Point]:
            policy, points = trained_policy(self.out, method, seed), []
            for value, benchmark in self.changed[factor.name].items():
                points.append(point(value=value, **measure(method, benchmark, protocol, policy)))
                note(f"{len(points)} of {len(factor.values)} scenarios")
            return points

        return self._job(
            f"worlds-{label}-{factor.name}.json",
            label=f"{label}, {factor.name} changed",
            key=lambda: self._key(method, seed, protocol, list(self.changed[factor.name].values())),
            compute=compute,
            encode=lambda points: [asdict(point) for point in points],
            decode=lambda result: [point_of(point) for point in result],
        )

    def _key(self, method: Method, seed: int | None, protocol: str, benchmarks: Sequence[Benchmark]) -> str:
        words: dict[str, Any] = {
            "worlds": [digest(benchmark.experiment) for benchmark in benchmarks],
            "scenes": [asdict(scene) for benchmark in benchmarks for scene in benchmark.suite.scenes],
            "noise_seed": self.study.noise_seed,
            "method": [type(method).__name__, method.name, method.revision, method.settings(protocol)],
            "protocol": protocol,
        }
        if method.training is None or seed is None:
            return _digest(**words)
        # Rows depend on the very weights of the run folder: the same training may give others on another machine.
        weights = (self.out / TRAININGS / f"{method.training.name}-{seed}" / BEST).read_bytes()
        key = _digest(**words, training=_training_key(method.training, seed))
        return f"{key}-{hashlib.sha256(weights).hexdigest()[:16]}"


def _training_key(training: Training, seed: int) -> str:
    return _digest(experiment=digest(training.experiment), seed=seed)


def _digest(**words: Any) -> str:
    text = json.dumps({"foveate": __version__, "version": VERSION, **words}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _label(method: Method, seed: int | None) -> str:
    return method.name if seed is None else f"{method.name}-{seed}"
