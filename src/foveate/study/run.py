"""Jobs of a comparison, each kept in a file when it is done: the same command resumes an interrupted comparison.

A job is a training, the rows of a method for one training seed and protocol, or its scores under a factor.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

from foveate.errors import InputError
from foveate.evaluation.evaluate import Row
from foveate.io.cache import Job
from foveate.io.grouping import group_by
from foveate.io.toml import digest
from foveate.names import InitialError
from foveate.scenario.factors import Factor
from foveate.simulation.records import Policy
from foveate.study import jobs as shared
from foveate.study.comparison import Part
from foveate.study.jobs import OnJob, Say, Trained, do_all, job_in, key_of, training_key, weights_digest
from foveate.study.methods import Benchmark, Method, check_rows
from foveate.study.robustness import Point, measure, point_of
from foveate.study.study import Study, benchmark_of, changed_benchmarks


class Results(NamedTuple):
    """Results of all jobs: rows on the suite, trainings, scores in changed scenarios."""

    parts: list[Part]
    trained: list[Trained]
    points: list[Point]


def reproduce(
    study: Study,
    out: Path,
    on_progress: OnJob = lambda done, label: None,
    say: Say = lambda line: None,
) -> Results:
    """Do the jobs of a study that are not done yet, and return the results of all. Raises as `do_all`."""
    by_kind = group_by(do_all(out, jobs(study, out, say), on_progress, say), type)
    return Results(by_kind.get(Part, []), by_kind.get(Trained, []), by_kind.get(Point, []))


def jobs(study: Study, out: Path, say: Say = lambda line: None) -> list[Job[Any]]:
    """All jobs in order: a training comes before the first job that needs it."""
    factory, ordered = _Factory(study=study, out=out), dict[Path, Job[Any]]()
    policies = [(method, seed) for method in study.methods for seed in study.seeds_of(method)]
    work = [
        (*policy, factory.rows(*policy, protocol, error))
        for policy in policies for error in study.initial_errors for protocol in study.protocols
    ]  # fmt: skip
    robust = [(method, seed) for method, seed in policies if method.name in study.robust]
    work += [(*policy, factory.points(*policy, factor)) for factor in study.factors for policy in robust]
    for method, seed, job in work:
        if method.training is not None and seed is not None:
            training = shared.training_job(out, method.training, seed, say)
            ordered.setdefault(training.path, training)
        if job.path in ordered:
            raise InputError(f"method {method.name}: its file {job.path.name} is another method's: rename it")
        ordered[job.path] = job
    return list(ordered.values())


def trained_policy(out: Path, method: Method, seed: int | None) -> Policy | None:
    """Load the policy that the method's training gave for a seed; None for a method without training."""
    return None if method.training is None or seed is None else shared.trained_policy(out, method.training, seed)


@dataclass(frozen=True, kw_only=True)
class _Factory:
    """Makes the jobs of a study whose results are kept in `out`."""

    study: Study
    out: Path

    @cached_property
    def benchmarks(self) -> dict[InitialError | None, Benchmark]:
        return {error: benchmark_of(self.study, error) for error in self.study.initial_errors}

    @cached_property
    def changed(self) -> dict[str, dict[float, Benchmark]]:
        return {factor.name: changed_benchmarks(self.study, factor) for factor in self.study.factors}

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

        return job_in(
            self.out,
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

        return job_in(
            self.out,
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
            "scenes": [scene.record() for benchmark in benchmarks for scene in benchmark.suite.scenes],
            "noise_seed": self.study.noise_seed,
            "method": [type(method).__name__, method.name, method.revision, method.settings(protocol)],
            "protocol": protocol,
        }
        if method.training is None or seed is None:
            return key_of(**words)
        key = key_of(**words, training=training_key(method.training, seed))
        return f"{key}-{weights_digest(self.out, method.training, seed)}"


def _label(method: Method, seed: int | None) -> str:
    return method.name if seed is None else f"{method.name}-{seed}"
