"""Many methods on one suite, in pieces that are kept: what is done is not done again, what was cut short goes on.

A unit of work is a training, or the rows of a method for one training seed and protocol. Its file holds a key of all
that its result depends on, and is written whole when the unit is done.
"""

import hashlib
import math
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from foveate.errors import InputError
from foveate.evaluation.evaluate import Row
from foveate.experiment.checkpoint import load_run
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PPOSettings
from foveate.experiment.run_folder import BEST, LAST, Outcome, Validation
from foveate.io.files import read_document, sole_writer, write_atomic, write_document
from foveate.learning.train import train
from foveate.simulation.records import Policy
from foveate.study.comparison import Part
from foveate.study.methods import Bench
from foveate.study.robustness import Point, points
from foveate.study.study import RowsUnit, Study, TrainingUnit, WorldsUnit, bench_of, key, units, worlds_of

VERSION = 1
"""Of the files of units."""


UNITS, TRAININGS = "units", "trainings"


T = TypeVar("T")


Say = Callable[[str], None]
"""Takes a line for the user."""


Report = Callable[[Validation, int], None]
"""Takes every check of a training, and of how many epochs or steps it has."""


@dataclass(frozen=True, kw_only=True)
class Trained:
    """A training that is done, and how it ended."""

    name: str
    seed: int
    run: Path
    experiment: Experiment
    outcome: Outcome


@dataclass(frozen=True, kw_only=True)
class Results:
    """What the units of a study gave: rows on the suite, trainings, scores in changed worlds."""

    parts: list[Part]
    trained: list[Trained]
    points: list[Point]


def reproduce(
    study: Study,
    out: Path,
    report: Callable[[int, str], None] = lambda done, what: None,
    say: Say = lambda line: None,
) -> Results:
    """Do what is not done yet, and give all results.

    `report` is called with the number of units that are done and what is being done now. Raises ValueError where
    another process is at work in `out`.
    """
    (out / UNITS).mkdir(parents=True, exist_ok=True)
    with sole_writer(out):
        return _reproduce(study, out, report, say)


def _reproduce(study: Study, out: Path, report: Callable[[int, str], None], say: Say) -> Results:
    benches = {error: bench_of(study, error) for error in study.initial_errors}
    worlds = {factor.name: worlds_of(study, factor) for factor in study.factors}
    found = Results(parts=[], trained=[], points=[])
    for done, unit in enumerate(units(study)):
        path = out / UNITS / unit.file

        def note(what: str, done: int = done, name: str = unit.what) -> None:
            report(done, f"{name}: {what}")

        note("beginning")
        if isinstance(unit, TrainingUnit):
            wanted = key(study, unit, ())
            found.trained.append(_training(unit, out / TRAININGS / unit.name, path, wanted, note, say))
        elif isinstance(unit, RowsUnit):
            bench = benches[unit.initial_error]
            wanted = _with_weights(key(study, unit, (bench,)), unit, out)
            found.parts.append(_rows(unit, bench, out, path, wanted, note, say))
        else:
            here = worlds[unit.factor.name]
            wanted = _with_weights(key(study, unit, list(here.values())), unit, out)
            found.points.extend(_points(unit, here, out, path, wanted, note, say))
    return found


def _kept(path: Path, wanted: str, say: Say, read: Callable[[Any], T]) -> T | None:
    """What a unit's file holds; None where there is none, or one made with other settings or damaged."""
    if not path.exists():
        return None
    try:
        found = read_document(path, "unit", VERSION, "file of a unit")
    except ValueError as error:
        say(f"{error}: made anew")
        return None
    if found.get("key") != wanted:
        say(f"{path}: was made with other settings, or by another version: made anew")
        return None
    try:
        return read(found["result"])
    except (KeyError, TypeError):
        say(f"{path}: holds something else than it should: made anew")
        return None


def _training(unit: TrainingUnit, run: Path, path: Path, wanted: str, note: Say, say: Say) -> Trained:
    """Train, or go on with what was begun, unless it is done."""
    experiment = unit.training.experiment
    outcome = _kept(path, wanted, say, lambda result: Outcome(**result))
    if outcome is None or not (run / BEST).exists():
        path.unlink(missing_ok=True)

        def report(check: Validation, total: int) -> None:
            done = check.env_steps if isinstance(experiment.training, PPOSettings) else check.epoch
            note(f"{done} of {total}, held-out {check.held_out:.2f}")
            if check.event:
                say(f"{run}: epoch {check.epoch}: {check.event}")

        outcome = _train(unit, run, path.with_suffix(".begun"), wanted, report, say)
        if not math.isfinite(outcome.best_score):
            raise InputError(f"{run}: no check of this training was finite, so there is no policy: {outcome.stopped}")
        write_document(path, "unit", VERSION, {"key": wanted, "result": asdict(outcome)})
    return Trained(name=unit.training.name, seed=unit.seed, run=run, experiment=experiment, outcome=outcome)


def _train(unit: TrainingUnit, run: Path, mark: Path, wanted: str, report: Report, say: Say) -> Outcome:
    """Go on with the run folder where it was begun under the same key, which `mark` holds; else train anew."""
    experiment = unit.training.experiment
    if _is_begun(run, mark, wanted, experiment):
        try:
            return train(experiment, run, unit.seed, True, report)
        except ValueError as error:
            say(str(error))
    if run.exists():
        say(f"{run}: cannot be gone on with: trained anew")
        shutil.rmtree(run)
    write_atomic(mark, wanted.encode())
    return train(experiment, run, unit.seed, False, report)


def _is_begun(run: Path, mark: Path, wanted: str, experiment: Experiment) -> bool:
    can_resume = not isinstance(experiment.training, PPOSettings)
    there = mark.exists() and (run / LAST).exists() and (run / BEST).exists()
    return can_resume and there and mark.read_text() == wanted


def _with_weights(wanted: str, unit: RowsUnit | WorldsUnit, out: Path) -> str:
    """The key of a unit; what a trained policy does is of the very weights that lie there."""
    if unit.training is None:
        return wanted
    weights = (out / TRAININGS / unit.training.name / BEST).read_bytes()
    return f"{wanted}-{hashlib.sha256(weights).hexdigest()[:16]}"


def _rows(unit: RowsUnit, bench: Bench, out: Path, path: Path, wanted: str, note: Say, say: Say) -> Part:
    """The rows of a unit, made now or kept."""
    rows = _kept(path, wanted, say, lambda result: [Row(**row) for row in result])
    if rows is None:
        total = len(bench.suite.scenes)
        policy = None if unit.training is None else trained_policy(out, unit.training)
        rows = unit.method.rows(bench, unit.protocol, policy, lambda done: note(f"{done} of {total} episodes"))
        _check(unit, bench, rows)
        write_document(path, "unit", VERSION, {"key": wanted, "result": [asdict(row) for row in rows]})
    method = unit.method
    return Part(
        method=method.name,
        family=method.family,
        training_seed=unit.seed,
        protocol=unit.protocol,
        rows=tuple(rows),
        initial_error=unit.initial_error,
    )


def _points(
    unit: WorldsUnit, worlds: Mapping[float, Bench], out: Path, path: Path, wanted: str, note: Say, say: Say
) -> list[Point]:
    """The points of a unit, made now or kept."""
    found = _kept(path, wanted, say, lambda result: [_point(one) for one in result])
    if found is None:
        policy = None if unit.training is None else trained_policy(out, unit.training)

        def report(done: int) -> None:
            note(f"{done} of {len(worlds)} worlds")

        found = points(worlds, unit.factor, unit.method, unit.seed, policy, unit.protocol, report)
        write_document(path, "unit", VERSION, {"key": wanted, "result": [asdict(point) for point in found]})
    return found


def _point(fields: dict[str, Any]) -> Point:
    """A point as it was before it was written: JSON knows lists only."""
    return replace(Point(**fields), scores=tuple(fields["scores"]), seen=tuple(fields["seen"]))


def _check(unit: RowsUnit, bench: Bench, rows: Sequence[Row]) -> None:
    """Raise ValueError where rows are not one an episode of the suite, under the unit's method and protocol."""
    suite = bench.suite
    expected = [(scene.id, episode) for scene in suite.scenes for episode in range(suite.episodes_per_scene)]
    if sorted((row.scene, row.episode) for row in rows) != sorted(expected):
        raise InputError(f"method {unit.method.name}: gave {len(rows)} rows: expected one an episode of the suite")
    if {(row.method, row.protocol) for row in rows} - {(unit.method.name, unit.protocol)}:
        raise InputError(f"method {unit.method.name}: its rows name another method or protocol than {unit.protocol}")


def trained_policy(out: Path, unit: TrainingUnit) -> Policy:
    """The policy of a training that is done."""
    return load_run(out / TRAININGS / unit.name)[1]
