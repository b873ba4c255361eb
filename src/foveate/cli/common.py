"""Shared by the commands: checks of output files, tables."""

import sys
from collections.abc import Sequence
from pathlib import Path

from foveate.errors import InputError


def check_seed(seed: int, name: str = "--seed") -> None:
    """Raise InputError for a seed outside of its range."""
    from foveate.io.validate import seed_number

    seed_number(seed, name)


def check_output(path: Path | None, *inputs: Path | str | None, folder: bool = False) -> None:
    """Raise InputError now, not after minutes of work, where a result could not be written or would hit an input."""
    if path is None:
        return
    if any(path.resolve() == Path(name).resolve() for name in inputs if name):
        raise InputError(f"{path}: is an input of this command: choose another file")
    if path.exists() and path.is_dir() != folder:
        raise InputError(f"{path}: is {'no ' * folder}a folder: choose another place")
    if not path.resolve().parent.is_dir():
        raise InputError(f"{path}: no folder {path.parent}: make it first, or choose another place")


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table; its first two columns are text, the others numbers."""
    from rich.console import Console

    from foveate.io.tables import TABLE_WIDTH, Table, draw

    table = Table(title=title, header=tuple(header), rows=tuple(tuple(row) for row in rows))
    # Not a terminal: no colours, and as wide as the table needs.
    draw(table, Console() if sys.stdout.isatty() else Console(width=TABLE_WIDTH, no_color=True))
