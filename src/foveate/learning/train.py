"""Train an experiment by its own learner, with a progress bar and orderly interruption."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from foveate.errors import InputError
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import PPOSettings
from foveate.experiment.run_folder import CONFIG, Outcome, Validation, require_free
from foveate.io.files import LOCK, sole_writer
from foveate.io.progress import Bar
from foveate.learning import loop
from foveate.learning.sb3 import ppo
from foveate.learning.validation import OnValidation, no_report
from foveate.models.precision import warn_of_rounding


def train(
    experiment: Experiment, out: Path, seed: int = 0, resume: bool = False, report: OnValidation = no_report
) -> Outcome:
    """Train a policy into the run folder `out` by the experiment's own learner; `report` is called at every validation.

    Raises InputError if `out` already holds a run (or, resumed, another one), if another process trains into it, to
    resume PPO, or for an objective that the scenario does not have.
    """
    experiment.require_learner()
    by_ppo = isinstance(experiment.training, PPOSettings)
    if resume and by_ppo:
        raise InputError(f"{out}: PPO cannot be resumed: train again")
    if resume and not (out / CONFIG).exists():
        raise InputError(f"{out}: holds no training to resume: begin one there")
    if not resume:
        require_free(out, experiment)
        out.mkdir(parents=True, exist_ok=True)
    scenario = experiment.scenario
    warn_of_rounding(scenario.problem(), scenario.scenes.horizon(scenario.scenes.targets_max))
    with sole_writer(out):
        try:
            if by_ppo:
                return ppo.train(experiment, out, seed, report)
            return loop.train(experiment, out, seed, resume, report)
        except InputError:
            if [path.name for path in out.iterdir()] == [LOCK]:  # rejected before anything was written
                (out / LOCK).unlink()
                out.rmdir()
            raise


@contextmanager
def watched(
    experiment: Experiment, name: str, callback: Callable[[Validation], object] | None = None, quiet: bool = False
) -> Iterator[OnValidation]:
    """A progress bar around a training; yields the `report` for `train`, which calls `callback` first.

    The first Ctrl+C ends the training at its next validation, when everything is on the disk, the second one at once.
    PPO, which cannot be resumed, ends at the first.
    """
    settings = experiment.training
    by_ppo = isinstance(settings, PPOSettings)
    total, unit = (settings.steps, "steps") if by_ppo else (settings.epochs, "iterations")
    with Bar(f"training {name}", total, unit, quiet) as bar, _deferred_interrupt(bar, not by_ppo) as interrupted:

        def report(validation: Validation, _: int) -> None:
            if callback is not None:
                callback(validation)
            done, rate = validation.epoch, validation.epochs_per_s
            if by_ppo:
                done, rate = validation.env_steps, rate * validation.env_steps / validation.epoch
            bar.update(done, f"held-out {validation.held_out:.2f}  {rate:.0f}/s")
            if validation.event:
                bar.say(f"iteration {validation.epoch}: {validation.event}")
            if interrupted.is_set():  # the validation is on the disk
                raise KeyboardInterrupt

        yield report


@contextmanager
def _deferred_interrupt(bar: Bar, defers: bool) -> Iterator[threading.Event]:
    """An event that the first Ctrl+C sets if `defers`; the second one raises KeyboardInterrupt."""
    interrupted = threading.Event()
    before = signal.getsignal(signal.SIGINT)

    def handle(number: int, frame: FrameType | None) -> None:
        if interrupted.is_set():
            raise KeyboardInterrupt
        interrupted.set()
        bar.say("stopping when the current validation is saved; press Ctrl+C again to stop at once")

    # A caller's own handler stays, and only the main thread may set one.
    ours = defers and before is signal.default_int_handler and threading.current_thread() is threading.main_thread()
    if ours:
        signal.signal(signal.SIGINT, handle)
    try:
        yield interrupted
    finally:
        if ours:
            signal.signal(signal.SIGINT, before)
