"""Jobs that a study shares: trainings into run folders, and the loop that does what is not done yet."""

import hashlib
import json
import math
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from foveate import __version__
from foveate.errors import InputError
from foveate.experiment.checkpoint import load_run
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PPOSettings
from foveate.experiment.run_folder import BEST, LAST, Outcome, Validation, outcome_of
from foveate.io.cache import Job
from foveate.io.files import sole_writer, write_atomic
from foveate.io.toml import digest
from foveate.learning.train import train
from foveate.simulation.records import Policy
from foveate.study.methods import Training

VERSION = 1
"""Of the files of jobs; raised, too, when a method gives other rows than before."""
JOBS, TRAININGS = "units", "trainings"
"""Folders of the results of jobs, and of run folders."""
Say = Callable[[str], None]
"""Takes a line for the user."""
OnJob = Callable[[int, str], None]
"""Takes the number of completed jobs and a line about the current one."""


@dataclass(frozen=True, kw_only=True)
class Trained:
    """A completed training and its outcome."""

    name: str
    seed: int
    run: Path
    experiment: Experiment
    outcome: Outcome


def do_all(out: Path, jobs: Sequence[Job[Any]], on_progress: OnJob, say: Say) -> list[Any]:
    """Do the jobs that are not done yet, and return the records of all.

    Raises InputError while another process works in `out`.
    """
    (out / JOBS).mkdir(parents=True, exist_ok=True)
    records: list[Any] = []
    with sole_writer(out):
        for done, job in enumerate(jobs):

            def note(line: str, done: int = done, label: str = job.label) -> None:
                on_progress(done, f"{label}: {line}")

            note("beginning")
            records += job.result(note, on_rejected=say)
    return records


def job_in(out: Path, file: str, **fields: Any) -> Job[Any]:
    """A job whose result is kept in a file of the folder `out`."""
    return Job(path=out / JOBS / file, kind="unit", version=VERSION, **fields)


def key_of(**words: Any) -> str:
    """Digest of all that a result depends on, this version of foveate included."""
    text = json.dumps({"foveate": __version__, "version": VERSION, **words}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def training_key(training: Training, seed: int) -> str:
    """Key of a training."""
    return key_of(experiment=digest(training.experiment), seed=seed)


def run_of(out: Path, training: Training, seed: int) -> Path:
    """Run folder of a training."""
    return out / TRAININGS / f"{training.name}-{seed}"


def trained_policy(out: Path, training: Training, seed: int) -> Policy:
    """Load the policy that a training gave for a seed."""
    return load_run(run_of(out, training, seed))[1]


def weights_digest(out: Path, training: Training, seed: int) -> str:
    """Digest of a run folder's weights: the same training may give others on another machine."""
    return hashlib.sha256((run_of(out, training, seed) / BEST).read_bytes()).hexdigest()[:16]


def training_job(out: Path, training: Training, seed: int, say: Say) -> Job[Any]:
    """Job of a training, into its own run folder."""
    run = run_of(out, training, seed)

    def records(outcome: Outcome) -> list[Trained]:
        if not (run / BEST).exists():
            raise InputError(f"{run}: has no weights")
        return [Trained(name=training.name, seed=seed, run=run, experiment=training.experiment, outcome=outcome)]

    return job_in(
        out,
        f"training-{run.name}.json",
        label=f"training {run.name}",
        key=lambda: training_key(training, seed),
        compute=lambda note: records(_train(out, training, seed, note, say)),
        encode=lambda records: asdict(records[0].outcome),
        decode=lambda result: records(outcome_of(result)),
    )


def _train(out: Path, training: Training, seed: int, note: Say, say: Say) -> Outcome:
    """Resume the run folder if it was begun under the same key; else train from the start."""
    experiment, key, run = training.experiment, training_key(training, seed), run_of(out, training, seed)
    is_ppo = isinstance(experiment.training, PPOSettings)

    def report(validation: Validation, total: int) -> None:
        done = validation.env_steps if is_ppo else validation.epoch
        note(f"{done} of {total}, held-out {validation.held_out:.2f}")
        if validation.event:
            say(f"{run}: iteration {validation.epoch}: {validation.event}")

    outcome, mark = None, out / JOBS / f"training-{run.name}.begun"
    is_begun = all(path.exists() for path in (mark, run / LAST, run / BEST)) and mark.read_text() == key
    if is_begun and not is_ppo:  # PPO cannot resume
        try:
            outcome = train(experiment, run, seed, True, report)
        except InputError as error:
            say(str(error))
    if outcome is None:
        if run.exists():
            say(f"{run}: cannot be resumed: trained again")
            shutil.rmtree(run)
        write_atomic(mark, key.encode())
        outcome = train(experiment, run, seed, False, report)
    if not math.isfinite(outcome.best_score):
        raise InputError(f"{run}: no validation was finite, so there is no policy: {outcome.stopped}")
    return outcome
