"""Many methods on one suite, in pieces that are kept: what is done is not done again, what was cut short goes on.

A unit of work is a training, or the rows of a method for one training seed and protocol. Its file holds a key of all
that its result depends on, and is written whole when the unit is done.
"""

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from foveate import __version__
from foveate.checkpoint import BEST, LAST, load_run
from foveate.comparison import Part
from foveate.configuration import digest
from foveate.episodes import SUITE_SEED, table1
from foveate.evaluation import Row, prepare
from foveate.files import read_json, write_json
from foveate.learning.training import Check, Outcome, stored_run, train
from foveate.methods import PROTOCOLS, Bench, Method, Training, paper_methods, reference
from foveate.scenes import Scene
from foveate.settings import PRESETS, Experiment

UNITS, TRAININGS = "units", "trainings"
VERSION = 1
"""Of the files of units; raised, too, when methods of ours do otherwise than before."""
QUICK_SCENES = 3
Say = Callable[[str], None]
"""Takes a line for the user."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """What is to be found out: which methods, on which scenes, trained with which seeds.

    `scenes_per_cell`: the first so many scenes of every cell. `noise_seed` draws the chance in the scenes.
    """

    methods: tuple[Method, ...]
    reference: str
    seeds: tuple[int, ...] = (0, 10, 100)
    scene_seed: int = SUITE_SEED
    scenes_per_cell: int = 30
    noise_seed: int = 0
    quick: bool = False
    world: Experiment = PRESETS["paper"]

    def __post_init__(self) -> None:
        names = [method.name for method in self.methods]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ValueError(f"method {twice[0]}: is given twice: expected one method a name")
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


@dataclass(frozen=True, kw_only=True)
class Trained:
    """A training that is done: how it ended, and how long it took [s], interruptions left out."""

    name: str
    seed: int
    run: Path
    experiment: Experiment
    outcome: Outcome


def paper_study(quick: bool = False, methods: tuple[Method, ...] = (), **changes: Any) -> Study:
    """The paper's suite, with further `methods`; the quick one has one seed, short trainings and few scenes."""
    if quick:
        changes = {"seeds": (0,), "scenes_per_cell": QUICK_SCENES, **changes}
    every = (*paper_methods(quick), *methods)
    return Study(methods=every, reference=reference(quick), quick=quick, **changes)


def units(study: Study) -> list[Unit]:
    """All work in the order in which it is done: a training comes before the first rows that need it."""
    work: dict[str, Unit] = {}
    for method in study.methods:
        for seed in (None,) if method.training is None else study.seeds:
            if method.training is not None and seed is not None:
                unit = TrainingUnit(training=method.training, seed=seed)
                work.setdefault(unit.file, unit)
            for protocol in PROTOCOLS:
                unit = RowsUnit(method=method, seed=seed, protocol=protocol)
                work[unit.file] = unit
    return list(work.values())


def bench_of(study: Study) -> Bench:
    """The world and the scenes of a study, with their chance."""
    problem = study.world.scenario.problem()
    kept: dict[tuple[str, int], list[Scene]] = {}
    for scene in table1(problem, study.scene_seed):
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
        if method.training is not None and unit.seed is not None:
            words["training"] = key(study, TrainingUnit(training=method.training, seed=unit.seed), scenes)
    return hashlib.sha256(json.dumps(words, sort_keys=True).encode()).hexdigest()


def reproduce(
    study: Study,
    out: Path,
    report: Callable[[int, str], None] = lambda done, what: None,
    say: Say = lambda line: None,
) -> tuple[list[Part], list[Trained]]:
    """Do what is not done yet, and give all results.

    `report` is called with the number of units that are done and what is being done now.
    """
    bench = bench_of(study)
    (out / UNITS).mkdir(parents=True, exist_ok=True)
    parts, trained = [], []
    for done, unit in enumerate(units(study)):
        path = out / UNITS / unit.file
        wanted = key(study, unit, bench.suite.scenes)

        def note(what: str, done: int = done, name: str = unit.what) -> None:
            report(done, f"{name}: {what}")

        note("beginning")
        found = _kept(path, wanted, say)
        if isinstance(unit, TrainingUnit):
            trained.append(_training(unit, out / TRAININGS / unit.name, path, wanted, found, note, say))
        else:
            parts.append(_rows(unit, bench, out, path, wanted, found, note))
    return parts, trained


def _kept(path: Path, wanted: str, say: Say) -> Any:
    """What a unit's file holds; None where there is none, or one made with other settings or damaged."""
    if not path.exists():
        return None
    try:
        found = read_json(path, "file of a unit")
    except ValueError as error:
        say(f"{error}: made anew")
        return None
    if not isinstance(found, dict) or found.get("key") != wanted:
        say(f"{path}: was made with other settings, or by another version: made anew")
        return None
    return found["result"]


def _training(unit: TrainingUnit, run: Path, path: Path, wanted: str, found: Any, note: Say, say: Say) -> Trained:
    """Train, or go on with what was begun, unless it is done."""
    experiment = unit.training.experiment
    if found is None or not (run / BEST).exists():
        path.unlink(missing_ok=True)

        def report(check: Check, total: int) -> None:
            note(f"epoch {check.epoch} of {total}, held-out {check.held_out:.2f}")
            if check.event:
                say(f"{run}: epoch {check.epoch}: {check.event}")

        begun = _is_begun(run, experiment, unit.seed)
        if not begun and run.exists():
            say(f"{run}: cannot be gone on with: trained anew")
            shutil.rmtree(run)
        found = asdict(train(experiment, run, unit.seed, begun, report))
        write_json(path, {"key": wanted, "result": found})
    return Trained(name=unit.training.name, seed=unit.seed, run=run, experiment=experiment, outcome=Outcome(**found))


def _is_begun(run: Path, experiment: Experiment, seed: int) -> bool:
    """Whether a run folder holds this very training, ready to go on."""
    if not (run / LAST).exists():
        return False
    try:
        begun, its_seed = stored_run(run)
    except ValueError:
        return False
    return digest(begun) == digest(experiment) and its_seed == seed


def _rows(unit: RowsUnit, bench: Bench, out: Path, path: Path, wanted: str, found: Any, note: Say) -> Part:
    """The rows of a unit, made now or kept."""
    if found is None:
        training, total = unit.method.training, len(bench.suite.scenes)
        policy = None if training is None else load_run(out / TRAININGS / f"{training.name}-{unit.seed}")[1]
        rows = unit.method.rows(bench, unit.protocol, policy, lambda done: note(f"{done} of {total} episodes"))
        write_json(path, {"key": wanted, "result": [asdict(row) for row in rows]})
    else:
        rows = [Row(**row) for row in found]
    method = unit.method
    return Part(
        method=method.name, family=method.family, training_seed=unit.seed, protocol=unit.protocol, rows=tuple(rows)
    )
