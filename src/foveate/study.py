"""What a comparison consists of: methods, scenes, seeds, and the units of work that they make."""

import hashlib
import json
import re
from dataclasses import asdict, dataclass
from typing import Any

from foveate import __version__
from foveate.configuration import digest
from foveate.episodes import SUITE_SEED, table1
from foveate.evaluation import prepare
from foveate.methods import PROTOCOLS, Bench, Method, Training, paper_methods, reference
from foveate.scenes import Scene
from foveate.settings import PRESETS, Experiment

VERSION = 1
"""Of the files of units; raised, too, when methods of ours do otherwise than before."""
QUICK_SCENES = 3
QUICK_TARGETS = (3, 5)
"""As many sizes as cores compile side by side: compilation is most of a quick look."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """What is to be found out: which methods, on which scenes, trained with which seeds.

    `scenes_per_cell`: the first so many scenes of every cell; `targets`: of cells with so many targets (None: all).
    `noise_seed` draws the chance in the scenes.
    """

    methods: tuple[Method, ...]
    reference: str
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
            raise ValueError(f"method {twice[0]}: is given twice: expected one method a name")
        for name in [*names, *(method.training.name for method in self.methods if method.training is not None)]:
            if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9._-]*", name):
                raise ValueError(f"method or training {name!r}: expected letters, digits, and . _ - within")
        if self.reference not in names:
            raise ValueError(f"reference {self.reference}: expected one of the methods {', '.join(names)}")
        made: dict[str, Training] = {}
        for training in (method.training for method in self.methods if method.training is not None):
            if made.setdefault(training.name, training) != training:
                raise ValueError(f"training {training.name}: means two experiments: give each its own name")
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise ValueError(f"seeds = {self.seeds}: expected at least one, and each once")


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
    """One method to run on all scenes under one protocol; `seed` is that of its training, if it has one."""

    method: Method
    seed: int | None
    protocol: str

    @property
    def training(self) -> TrainingUnit | None:
        """What has to be done before."""
        if self.method.training is None or self.seed is None:
            return None
        return TrainingUnit(training=self.method.training, seed=self.seed)

    @property
    def name(self) -> str:
        """Of the method, as one trained with this seed."""
        return self.method.name if self.seed is None else f"{self.method.name}-{self.seed}"

    @property
    def file(self) -> str:
        """Where its result is kept."""
        return f"rows-{self.name}-{self.protocol}.json"

    @property
    def what(self) -> str:
        """What is being done."""
        return f"{self.name}, {self.protocol}"


Unit = TrainingUnit | RowsUnit


def paper_study(quick: bool = False, methods: tuple[Method, ...] = (), **changes: Any) -> Study:
    """The paper's suite, with further `methods`; the quick one has one seed, short trainings and few scenes."""
    if quick:
        changes = {"seeds": (0,), "scenes_per_cell": QUICK_SCENES, "targets": QUICK_TARGETS, **changes}
    every = (*paper_methods(quick), *methods)
    return Study(methods=every, reference=reference(quick), quick=quick, **changes)


def units(study: Study) -> list[Unit]:
    """All work in the order in which it is done: a training comes before the first rows that need it."""
    work: dict[str, Unit] = {}
    for method in study.methods:
        for seed in (None,) if method.training is None else study.seeds:
            for protocol in PROTOCOLS:
                unit = RowsUnit(method=method, seed=seed, protocol=protocol)
                if unit.training is not None:
                    work.setdefault(unit.training.file, unit.training)
                if unit.file in work:
                    raise ValueError(f"method {method.name}: its file {unit.file} is another method's: rename it")
                work[unit.file] = unit
    return list(work.values())


def bench_of(study: Study) -> Bench:
    """The world and the scenes of a study, with their chance."""
    problem = study.world.scenario.problem()
    kept: dict[tuple[str, int], list[Scene]] = {}
    for scene in table1(problem, study.scene_seed):
        if study.targets is None or len(scene.targets) in study.targets:
            kept.setdefault((scene.motion, len(scene.targets)), []).append(scene)
    scenes = [scene for cell in kept.values() for scene in cell[: study.scenes_per_cell]]
    suite = prepare(problem, study.world.scenario.scenes, scenes, study.noise_seed)
    return Bench(world=study.world, suite=suite)


def key(study: Study, unit: Unit, scenes: tuple[Scene, ...]) -> str:
    """A digest of all that a unit's result depends on, code of the same version aside."""
    words: dict[str, Any] = {"foveate": __version__, "version": VERSION}
    if isinstance(unit, TrainingUnit):
        words |= {"experiment": digest(unit.training.experiment), "seed": unit.seed}
    else:
        method = unit.method
        words |= {
            "world": digest(study.world),
            "scenes": [asdict(scene) for scene in scenes],
            "noise_seed": study.noise_seed,
            "method": [type(method).__name__, method.name, method.revision, method.settings(unit.protocol)],
            "protocol": unit.protocol,
        }
        if unit.training is not None:
            words["training"] = key(study, unit.training, scenes)
    return hashlib.sha256(json.dumps(words, sort_keys=True).encode()).hexdigest()
