"""Progress of long work: a bar on a terminal, lines in a notebook, nothing elsewhere."""

import sys


class Bar:
    """A progress bar with rate and time left on a terminal, a line at each tenth in a notebook, nothing elsewhere.

    `quiet`: nothing anywhere, except for the lines of `say`.
    """

    def __init__(self, description: str, total: int, unit: str, quiet: bool = False) -> None:
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
        """Set how much is done, and a note beside it."""
        self._progress.update(self._task, completed=done, note=note)
        tenth = 10 * done // max(1, self._total)
        if self._lines and tenth > self._reported:
            self._reported = tenth
            print(f"{self._description}: {done} of {self._total} {self._unit}  {note}", flush=True)

    def say(self, line: str) -> None:
        """Print a line above the bar; on standard error, also where there is no terminal."""
        self._progress.console.print(line, highlight=False, markup=False, soft_wrap=True)
