"""Progress of long tasks: a bar on a terminal, lines in a notebook, records of the logger "foveate" elsewhere."""

import logging
import sys
import threading
import time

logger = logging.getLogger("foveate")
"""Logger of the package. Its level, if set, hides what is below it: progress is INFO, single steps are DEBUG."""
SILENT_S = 5.0
"""Time after which a line tells what began, where the first unit is not done yet [s]: compilation may take minutes."""


class Bar:
    """Progress bar with the time left on a terminal; elsewhere a line at the beginning and at each tenth.

    Lines are printed in a notebook, and logged elsewhere. A `quiet` bar shows only the lines of `say`, and so does
    every bar while the logger's level is WARNING.
    """

    def __init__(self, description: str, total: int, unit: str, quiet: bool = False) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        words = [TextColumn(text, markup=False) for text in ("{task.description}", unit, "{task.fields[note]}")]
        columns = (words[0], BarColumn(), MofNCompleteColumn(), *words[1:], TimeRemainingColumn())
        terminal, quiet = sys.stderr.isatty(), quiet or logger.level > logging.INFO
        self._progress = Progress(*columns, console=Console(stderr=True), disable=quiet or not terminal)
        self._task = self._progress.add_task(description, total=total, note="")
        self._description, self._total, self._unit = description, total, unit
        self._lines, self._in_notebook = not quiet and not terminal, Console().is_jupyter
        self._quiet, self._reported, self._began = quiet, -1, time.monotonic()
        self._first: tuple[int, float] | None = None
        self._timer = threading.Timer(SILENT_S, self._report, (0, ""))
        self._timer.daemon = True

    def __enter__(self) -> "Bar":
        self._progress.start()
        if self._lines:
            self._timer.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._timer.cancel()
        self._progress.stop()

    def update(self, done: int, note: str = "") -> None:
        """Set the number of units done, and a note beside it."""
        self._timer.cancel()
        self._progress.update(self._task, completed=done, note=note)
        self._first = self._first or (done, time.monotonic())
        if self._lines and 10 * done // max(1, self._total) > self._reported:
            self._report(done, note)
        elif not self._quiet:
            logger.debug(self._line(done, note))

    def say(self, line: str) -> None:
        """Log a line that is not to be missed, on a terminal above the bar."""
        logger.warning(line)

    def _report(self, done: int, note: str) -> None:
        """Print a line, or log it."""
        self._reported = 10 * done // max(1, self._total)
        if self._in_notebook:
            print(self._line(done, note), flush=True)
        else:
            logger.info(self._line(done, note))

    def _line(self, done: int, note: str) -> str:
        now, (before, since) = time.monotonic(), self._first or (0, 0.0)
        # From the first update on: what came before it is mostly compilation.
        rate_s = (now - since) / (done - before) if done > before else None
        left = "" if rate_s is None or done >= self._total else f", {_duration(rate_s * (self._total - done))} left"
        times = f" in {_duration(now - self._began)}{left}" if done else ""
        return f"{self._description}: {done} of {self._total} {self._unit}{times}  {note}".rstrip()


def _duration(seconds: float) -> str:
    """A time as 0:07 or 1:02:33."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}" if minutes < 60 else f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"
