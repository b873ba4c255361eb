"""Progress of long tasks on a terminal or in a notebook."""

import sys


class Bar:
    """Progress bar with the time left on a terminal, a line at each tenth in a notebook, nothing elsewhere.

    A `quiet` bar shows only the lines of `say`.
    """

    def __init__(self, description: str, total: int, unit: str, quiet: bool = False) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        words = [TextColumn(text) for text in ("{task.description}", unit, "{task.fields[note]}")]
        columns = (words[0], BarColumn(), MofNCompleteColumn(), *words[1:], TimeRemainingColumn())
        terminal = sys.stderr.isatty()
        self._progress = Progress(*columns, console=Console(stderr=True), disable=quiet or not terminal)
        self._task = self._progress.add_task(description, total=total, note="")
        self._description, self._total, self._unit = description, total, unit
        self._lines = not quiet and not terminal and Console().is_jupyter
        self._reported = 0

    def __enter__(self) -> "Bar":
        self._progress.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._progress.stop()

    def update(self, done: int, note: str = "") -> None:
        """Set the number of units done, and a note beside it."""
        self._progress.update(self._task, completed=done, note=note)
        tenth = 10 * done // max(1, self._total)
        if self._lines and tenth > self._reported:
            self._reported = tenth
            print(f"{self._description}: {done} of {self._total} {self._unit}  {note}", flush=True)

    def say(self, line: str) -> None:
        """Print a line above the bar, on standard error, with or without a terminal."""
        self._progress.console.print(line, highlight=False, markup=False, soft_wrap=True)
