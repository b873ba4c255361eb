"""Contents of a comparison: methods, scenes and seeds."""

import re
from dataclasses import dataclass
from typing import Any, Literal

from foveate.errors import InputError
from foveate.evaluation.evaluate import prepare
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.experiment.resolve import with_initial_error
from foveate.io.grouping import group_by
from foveate.names import InitialError
from foveate.scenario.factors import FACTORS, Factor
from foveate.simulation.records import PROTOCOLS
from foveate.simulation.suites import SUITE_SEED, table1
from foveate.study.methods import FULL, QUICK, TRUE_VIEW, Benchmark, Budget, Method, paper_methods, true_view_methods
from foveate.study.robustness import changed_benchmark


@dataclass(frozen=True, kw_only=True)
class Study:
    """A comparison of methods on the same scenes; methods that need training are trained with each of `seeds`.

    `scenes_per_cell`: the first N scenes of every cell; `targets`: cells with these numbers of targets (None: all).
    `noise_seed` draws the noise in the scenes. Each of `protocols` is run with each of `initial_errors` of beliefs
    (None: the experiment's own). The methods named in `robust` are also run in scenarios that differ by one of
    `factors`, under the first protocol, on `scenes_per_cell` scenes.
    """

    methods: tuple[Method, ...]
    reference: str
    suite: Literal["paper", "true-view"] = "paper"
    protocols: tuple[str, ...] = tuple(PROTOCOLS)
    initial_errors: tuple[InitialError | None, ...] = (None,)
    factors: tuple[Factor, ...] = ()
    robust: tuple[str, ...] = ()
    seeds: tuple[int, ...] = FULL.seeds
    scene_seed: int = SUITE_SEED
    scenes_per_cell: int = FULL.scenes
    targets: tuple[int, ...] | None = None
    noise_seed: int = 0
    quick: bool = False
    experiment: Experiment = PRESETS["paper"]

    def __post_init__(self) -> None:
        names = [method.name for method in self.methods]
        if repeated := [name for name in names if names.count(name) > 1]:
            raise InputError(f"method {repeated[0]}: is given twice: expected one method a name")
        trainings = group_by((m.training for m in self.methods if m.training is not None), lambda each: each.name)
        for name, same in trainings.items():
            if any(training != same[0] for training in same):
                raise InputError(f"training {name}: means two experiments: give each its own name")
        for name in (*names, *trainings):
            if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9._-]*", name):
                raise InputError(f"method or training {name!r}: expected letters, digits, and . _ - within")
        if self.reference not in names:
            raise InputError(f"reference {self.reference}: expected one of the methods {', '.join(names)}")
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise InputError(f"seeds = {self.seeds}: expected at least one, and each once")

    def method(self, name: str) -> Method:
        """Return the method of this name."""
        return next(method for method in self.methods if method.name == name)

    def seeds_of(self, method: Method) -> tuple[int | None, ...]:
        """Return the training seeds of a method; a single None without training."""
        return self.seeds if method.training else (None,)


def paper_study(quick: bool = False, methods: tuple[Method, ...] = (), **changes: Any) -> Study:
    """The paper's suite, with further `methods`; the quick one has one seed, short trainings and few scenes."""
    budget = QUICK if quick else FULL
    return _study(budget, changes, methods=(*paper_methods(budget), *methods), reference=budget.reference)


def true_view_study(quick: bool = False, methods: tuple[Method, ...] = (), **changes: Any) -> Study:
    """The true field of view, with both initial errors, and in scenarios that differ by one factor."""
    budget = QUICK if quick else FULL
    return _study(
        budget, changes, methods=(*true_view_methods(budget), *methods), reference=TRUE_VIEW, suite="true-view",
        protocols=("true",), initial_errors=("paper", "consistent"), robust=budget.robust,
        factors=tuple(factor for factor in FACTORS if budget.factors is None or factor.name in budget.factors),
    )  # fmt: skip


def _study(budget: Budget, changes: dict[str, Any], **fields: Any) -> Study:
    sizes = {"quick": budget.quick, "seeds": budget.seeds, "scenes_per_cell": budget.scenes, "targets": budget.targets}
    return Study(**fields, **{**sizes, **changes})


def benchmark_of(study: Study, initial_error: InitialError | None = None) -> Benchmark:
    """The experiment of a study with an initial error of beliefs, its scenes and their noise."""
    experiment = with_initial_error(study.experiment, initial_error)
    problem = experiment.scenario.problem()
    scenes = (s for s in table1(problem, study.scene_seed) if study.targets is None or len(s.targets) in study.targets)
    cells = group_by(scenes, lambda scene: (scene.motion, len(scene.targets)))
    first = [scene for cell in cells.values() for scene in cell[: study.scenes_per_cell]]
    objective = experiment.training.objective
    suite = prepare(problem, experiment.scenario.scenes, first, study.noise_seed, objective=objective)
    return Benchmark(experiment=experiment, suite=suite)


def changed_benchmarks(study: Study, factor: Factor) -> dict[float, Benchmark]:
    """Benchmarks of a study with a factor changed, by its values."""
    experiment = with_initial_error(study.experiment, study.initial_errors[0])
    scenes = (study.scenes_per_cell, study.scene_seed, study.noise_seed)
    return {value: changed_benchmark(experiment, factor, value, *scenes) for value in factor.values}
