"""Many methods on one suite, in pieces that are kept: what is done is not done again, what was cut short goes on.

A unit of work is a training, or the rows of a method for one training seed and protocol. Its file holds a key of all
that its result depends on, and is written whole when the unit is done.
"""

import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from foveate.checkpoint import BEST, LAST, load_run
from foveate.comparison import Part
from foveate.configuration import digest
from foveate.evaluation import Row
from foveate.files import read_json, write_json
from foveate.learning.judging import Check, Outcome
from foveate.learning.learner import train
from foveate.learning.training import stored_run
from foveate.methods import Bench
from foveate.problem import Policy
from foveate.settings import Experiment, PPOSettings
from foveate.study import RowsUnit, Study, TrainingUnit, bench_of, key, units

UNITS, TRAININGS = "units", "trainings"
Say = Callable[[str], None]
"""Takes a line for the user."""


@dataclass(frozen=True, kw_only=True)
class Trained:
    """A training that is done: how it ended, and how long it took [s], interruptions left out."""

    name: str
    seed: int
    run: Path
    experiment: Experiment
    outcome: Outcome


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
            done = check.env_steps if isinstance(experiment.training, PPOSettings) else check.epoch
            note(f"{done} of {total}, held-out {check.held_out:.2f}")
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
        total = len(bench.suite.scenes)
        policy = None if unit.training is None else trained_policy(out, unit.training)
        rows = unit.method.rows(bench, unit.protocol, policy, lambda done: note(f"{done} of {total} episodes"))
        write_json(path, {"key": wanted, "result": [asdict(row) for row in rows]})
    else:
        rows = [Row(**row) for row in found]
    method = unit.method
    return Part(
        method=method.name, family=method.family, training_seed=unit.seed, protocol=unit.protocol, rows=tuple(rows)
    )


def trained_policy(out: Path, unit: TrainingUnit) -> Policy:
    """The policy of a training that is done."""
    return load_run(out / TRAININGS / unit.name)[1]
