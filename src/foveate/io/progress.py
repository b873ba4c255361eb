"""How far long work is: a bar on a terminal, now and then a line in a notebook, nothing elsewhere."""

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass


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
