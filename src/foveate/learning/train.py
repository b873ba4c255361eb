"""The one place that knows which learner an experiment asks for."""

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from foveate.errors import InputError

if TYPE_CHECKING:
    import threading
    from collections.abc import Iterator
    from types import FrameType

    from foveate.experiment.experiment import Experiment
    from foveate.experiment.run_folder import Outcome, Validation
from collections.abc import Callable

from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PPOSettings
from foveate.experiment.run_folder import CONFIG, Outcome, Validation, require_free
from foveate.io.files import LOCK, sole_writer
from foveate.io.progress import Bar
from foveate.learning import loop as training
from foveate.learning.sb3 import ppo


def train_watched(
    experiment: "Experiment", out: Path, name: str, seed: int = 0, resume: bool = False, quiet: bool = False
) -> "Outcome":
    """Train into a run folder, as `learning.learner.train`, with a bar that counts epochs, of PPO steps."""
    from foveate.experiment.learners import PPOSettings

    settings = experiment.training
    by_ppo = isinstance(settings, PPOSettings)
    total, unit = (settings.steps, "steps") if by_ppo else (settings.epochs, "epochs")
    with Bar(f"training {name}", total, unit, quiet) as bar, _patience(bar, not by_ppo) as asked:

        def report(check: "Validation", _: int) -> None:
            done, rate = check.epoch, check.epochs_per_s
            if by_ppo:
                done, rate = check.env_steps, check.epochs_per_s * check.env_steps / check.epoch
            bar.update(done, f"held-out {check.held_out:.2f}  {rate:.0f}/s")
            if check.event:
                bar.say(f"epoch {check.epoch}: {check.event}")
            if asked.is_set():  # here all of the check is on the disk
                raise KeyboardInterrupt

        return train(experiment, out, seed, resume, report)


@contextmanager
def _patience(bar: "Bar", finishes: bool) -> "Iterator[threading.Event]":
    """Where a training `finishes` its check, the first ctrl-C sets the event and the second one interrupts."""
    import signal
    import threading

    asked = threading.Event()
    before = signal.getsignal(signal.SIGINT)

    def ask(number: int, frame: "FrameType | None") -> None:
        if asked.is_set():
            raise KeyboardInterrupt
        asked.set()
        bar.say("stopping when the check that is under way is saved; ctrl-C once more stops at once")

    # A caller's own way with ctrl-C is left alone, and only the main thread may choose one.
    mine = finishes and before is signal.default_int_handler and threading.current_thread() is threading.main_thread()
    if mine:
        signal.signal(signal.SIGINT, ask)
    try:
        yield asked
    finally:
        if mine:
            signal.signal(signal.SIGINT, before)


def train(
    experiment: Experiment,
    out: Path,
    seed: int = 0,
    resume: bool = False,
    report: Callable[[Validation, int], None] = lambda check, total: None,
) -> Outcome:
    """Train a policy into the run folder `out` by the experiment's own algorithm; `report` is called at every check.

    Raises ValueError where `out` already holds a run (or, resumed, another one), or another process trains into it, and
    where PPO is to be resumed.
    """
    by_ppo = isinstance(experiment.training, PPOSettings)
    if resume and by_ppo:
        raise InputError(f"{out}: PPO cannot go on where it was: train it anew")
    if resume and not (out / CONFIG).exists():
        raise InputError(f"{out}: holds no training to go on with: begin one there")
    if not resume:
        require_free(out, experiment)
        out.mkdir(parents=True, exist_ok=True)
    with sole_writer(out):
        try:
            if by_ppo:
                return ppo.train(experiment, out, seed, report)
            return training.train(experiment, out, seed, resume, report)
        except ValueError:
            if [path.name for path in out.iterdir()] == [LOCK]:  # rejected before anything was written
                (out / LOCK).unlink()
                out.rmdir()
            raise
