"""What a comparison consists of: methods, scenes, seeds, and the units of work that they make."""

import hashlib
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from foveate import __version__
from foveate.errors import InputError
from foveate.evaluation.evaluate import prepare
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PRESETS
from foveate.io.toml import digest
from foveate.scenario.scenes import Scene
from foveate.simulation.records import PROTOCOLS
from foveate.simulation.suites import SUITE_SEED, table1
from foveate.study.methods import (
    CHANGED_WORLDS,
    TRUE_VIEW,
    Bench,
    Method,
    Training,
    paper_methods,
    reference,
    true_view_methods,
)
from foveate.study.robustness import FACTORS, Factor, changed_bench

InitialError = Literal["paper", "consistent"]
VERSION = 1
"""Of the files of units; raised, too, when methods of ours do otherwise than before."""


QUICK_SCENES = 3


QUICK_TARGETS = (3, 5)
"""As many sizes as cores compile side by side: compilation is most of a quick look."""


QUICK_FACTORS = ("V", "depth")
"""Two that need no further program."""


@dataclass(frozen=True, kw_only=True)
class TrainingUnit:
    """One policy to train."""

    training: Training
    seed: int

    @property
    def name(self) -> str:
        """Of its run folder."""
        return f"{self.training.name}-{self.seed}"

    @property
    def file(self) -> str:
        """Where its result is kept."""
        return f"training-{self.name}.json"

    @property
    def what(self) -> str:
        """What is being done."""
        return f"training {self.name}"


@dataclass(frozen=True, kw_only=True)
class RowsUnit:
    """One method to run on all scenes under one protocol and first error; `seed` is that of its training, if any."""

    method: Method
    seed: int | None
    protocol: str
    initial_error: InitialError | None = None

    @property
    def training(self) -> TrainingUnit | None:
        """What has to be done before."""
        return _training_of(self.method, self.seed)

    @property
    def name(self) -> str:
        """Of the method, as one trained with this seed."""
        return _name_of(self.method, self.seed)

    @property
    def file(self) -> str:
        """Where its result is kept."""
        return f"rows-{'-'.join([self.name, self.protocol, *self._error])}.json"

    @property
    def what(self) -> str:
        """What is being done."""
        return ", ".join([self.name, self.protocol, *self._error])

    @property
    def _error(self) -> list[str]:
        return [] if self.initial_error is None else [self.initial_error]


@dataclass(frozen=True, kw_only=True)
class WorldsUnit:
    """One method to run in all worlds of a factor."""

    method: Method
    seed: int | None
    protocol: str
    factor: Factor

    @property
    def training(self) -> TrainingUnit | None:
        """What has to be done before."""
        return _training_of(self.method, self.seed)

    @property
    def file(self) -> str:
        """Where its result is kept."""
        return f"worlds-{_name_of(self.method, self.seed)}-{self.factor.name}.json"

    @property
    def what(self) -> str:
        """What is being done."""
        return f"{_name_of(self.method, self.seed)}, {self.factor.name} changed"


def _training_of(method: Method, seed: int | None) -> TrainingUnit | None:
    return None if method.training is None or seed is None else TrainingUnit(training=method.training, seed=seed)


def _name_of(method: Method, seed: int | None) -> str:
    return method.name if seed is None else f"{method.name}-{seed}"


Unit = TrainingUnit | RowsUnit | WorldsUnit


@dataclass(frozen=True, kw_only=True)
class Study:
    """What is to be found out: which methods, on which scenes, trained with which seeds.

    `scenes_per_cell`: the first so many scenes of every cell; `targets`: of cells with so many targets (None: all).
    `noise_seed` draws the chance in the scenes. All is done under each of `protocols` and for each of `initial_errors`
    of beliefs (None: the world's own). Besides, the methods that are named in `changed` are run in worlds that differ
    by one of `factors`, under the first protocol, on so many scenes as `scenes_per_world`.
    """

    methods: tuple[Method, ...]
    reference: str
    suite: Literal["paper", "true-view"] = "paper"
    protocols: tuple[str, ...] = tuple(PROTOCOLS)
    initial_errors: tuple[InitialError | None, ...] = (None,)
    factors: tuple[Factor, ...] = ()
    changed: tuple[str, ...] = ()
    scenes_per_world: int = 30
    seeds: tuple[int, ...] = (0, 10, 100)
    scene_seed: int = SUITE_SEED
    scenes_per_cell: int = 30
    targets: tuple[int, ...] | None = None
    noise_seed: int = 0
    quick: bool = False
    world: Experiment = PRESETS["paper"]

    def __post_init__(self) -> None:
        names = [method.name for method in self.methods]
        if twice := [name for name in names if names.count(name) > 1]:
            raise InputError(f"method {twice[0]}: is given twice: expected one method a name")
        for name in [*names, *(method.training.name for method in self.methods if method.training is not None)]:
            if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9._-]*", name):
                raise InputError(f"method or training {name!r}: expected letters, digits, and . _ - within")
        if self.reference not in names:
            raise InputError(f"reference {self.reference}: expected one of the methods {', '.join(names)}")
        made: dict[str, Training] = {}
        for training in (method.training for method in self.methods if method.training is not None):
            if made.setdefault(training.name, training) != training:
                raise InputError(f"training {training.name}: means two experiments: give each its own name")
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise InputError(f"seeds = {self.seeds}: expected at least one, and each once")


def paper_study(quick: bool = False, methods: tuple[Method, ...] = (), **changes: Any) -> Study:
    """The paper's suite, with further `methods`; the quick one has one seed, short trainings and few scenes."""
    if quick:
        changes = {"seeds": (0,), "scenes_per_cell": QUICK_SCENES, "targets": QUICK_TARGETS, **changes}
    every = (*paper_methods(quick), *methods)
    return Study(methods=every, reference=reference(quick), quick=quick, **changes)


def true_view_study(quick: bool = False, methods: tuple[Method, ...] = (), **changes: Any) -> Study:
    """What methods are worth in the true field of view, with both first errors, and in worlds that differ."""
    if quick:
        changes = {"seeds": (0,), "scenes_per_cell": QUICK_SCENES, "targets": QUICK_TARGETS, **changes}
        some = [factor for factor in FACTORS if factor.name in QUICK_FACTORS]
        changes |= {"factors": tuple(some), "changed": CHANGED_WORLDS[1:], "scenes_per_world": QUICK_SCENES}
    else:
        changes |= {"factors": FACTORS, "changed": CHANGED_WORLDS}
    return Study(
        methods=(*true_view_methods(quick), *methods),
        reference=TRUE_VIEW,
        suite="true-view",
        protocols=("true",),
        initial_errors=("paper", "consistent"),
        quick=quick,
        **changes,
    )


def units(study: Study) -> list[Unit]:
    """All work in the order in which it is done: a training comes before the first rows that need it."""
    work: dict[str, Unit] = {}
    for unit in _units(study):
        if unit.training is not None:
            work.setdefault(unit.training.file, unit.training)
        if unit.file in work:
            raise InputError(f"method {unit.method.name}: its file {unit.file} is another method's: rename it")
        work[unit.file] = unit
    return list(work.values())


def _units(study: Study) -> Iterator[RowsUnit | WorldsUnit]:
    """All but trainings: on the suite, then in changed worlds."""
    runs = [(method, seed) for method in study.methods for seed in ((None,) if not method.training else study.seeds)]
    for method, seed in runs:
        for error in study.initial_errors:
            for protocol in study.protocols:
                yield RowsUnit(method=method, seed=seed, protocol=protocol, initial_error=error)
    for factor in study.factors:
        for method, seed in runs:
            if method.name in study.changed:
                yield WorldsUnit(method=method, seed=seed, protocol=study.protocols[0], factor=factor)


def world_of(study: Study, initial_error: InitialError | None) -> Experiment:
    """The world of a study with this first error of beliefs."""
    if initial_error is None:
        return study.world
    scenario = study.world.scenario
    scenes = replace(scenario.scenes, initial_error=initial_error)
    return replace(study.world, scenario=replace(scenario, scenes=scenes))


def worlds_of(study: Study, factor: Factor) -> dict[float, Bench]:
    """The worlds that a factor makes of a study's, by its values."""
    world = world_of(study, study.initial_errors[0])
    seeds = (study.scene_seed, study.noise_seed)
    return {value: changed_bench(world, factor, value, study.scenes_per_world, *seeds) for value in factor.values}


def bench_of(study: Study, initial_error: InitialError | None = None) -> Bench:
    """The world and the scenes of a study, with their chance."""
    world = world_of(study, initial_error)
    problem = world.scenario.problem()
    kept: dict[tuple[str, int], list[Scene]] = {}
    for scene in table1(problem, study.scene_seed):
        if study.targets is None or len(scene.targets) in study.targets:
            kept.setdefault((scene.motion, len(scene.targets)), []).append(scene)
    scenes = [scene for cell in kept.values() for scene in cell[: study.scenes_per_cell]]
    suite = prepare(problem, world.scenario.scenes, scenes, study.noise_seed)
    return Bench(world=world, suite=suite)


def key(study: Study, unit: Unit, benches: Sequence[Bench]) -> str:
    """A digest of all that a unit's result depends on, code of the same version aside; `benches`: where it is run."""
    words: dict[str, Any] = {"foveate": __version__, "version": VERSION}
    if isinstance(unit, TrainingUnit):
        words |= {"experiment": digest(unit.training.experiment), "seed": unit.seed}
    else:
        method = unit.method
        words |= {
            "worlds": [digest(bench.world) for bench in benches],
            "scenes": [asdict(scene) for bench in benches for scene in bench.suite.scenes],
            "noise_seed": study.noise_seed,
            "method": [type(method).__name__, method.name, method.revision, method.settings(unit.protocol)],
            "protocol": unit.protocol,
        }
        if unit.training is not None:
            words["training"] = key(study, unit.training, benches)
    return hashlib.sha256(json.dumps(words, sort_keys=True).encode()).hexdigest()
