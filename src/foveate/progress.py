"""How far long work is: a bar on a terminal, now and then a line in a notebook, nothing elsewhere."""

import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import threading
    from collections.abc import Iterator
    from types import FrameType

    from foveate.learning.judging import Check, Outcome
    from foveate.settings import Experiment


class Bar:
    """A progress bar with rate and time left on a terminal, a line at each tenth in a notebook, nothing elsewhere.

    `quiet`: nothing anywhere, but for what is said.
    """

    def __init__(self, what: str, total: int, unit: str, quiet: bool = False) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn(unit),
            TextColumn("{task.fields[note]}"),
            TimeRemainingColumn(),
        )
        terminal = sys.stderr.isatty()
        self._progress = Progress(*columns, console=Console(stderr=True), disable=quiet or not terminal)
        self._task = self._progress.add_task(what, total=total, note="")
        self._what, self._total, self._unit = what, total, unit
        self._lines = not quiet and not terminal and Console().is_jupyter
        self._told = 0

    def __enter__(self) -> "Bar":
        self._progress.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._progress.stop()

    def update(self, done: int, note: str = "") -> None:
        """Set how much is done, and a note beside it."""
        self._progress.update(self._task, completed=done, note=note)
        tenth = 10 * done // max(1, self._total)
        if self._lines and tenth > self._told:
            self._told = tenth
            print(f"{self._what}: {done} of {self._total} {self._unit}  {note}", flush=True)

    def say(self, line: str) -> None:
        """Print a line above the bar; on standard error, also where there is no terminal."""
        self._progress.console.print(line, highlight=False, markup=False, soft_wrap=True)


def train_watched(
    experiment: "Experiment", out: Path, name: str, seed: int = 0, resume: bool = False, quiet: bool = False
) -> "Outcome":
    """Train into a run folder, as `learning.learner.train`, with a bar that counts epochs, of PPO steps."""
    from foveate.learner_settings import PPOSettings
    from foveate.learning.learner import train

    settings = experiment.training
    by_ppo = isinstance(settings, PPOSettings)
    total, unit = (settings.steps, "steps") if by_ppo else (settings.epochs, "epochs")
    with Bar(f"training {name}", total, unit, quiet) as bar, _patience(bar, not by_ppo) as asked:

        def report(check: "Check", _: int) -> None:
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
