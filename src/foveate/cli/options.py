"""Options of commands: their base class, and how --help shows an option."""

from typing import Any

import tyro


class Command:
    """Options of a command; `cli.run` has a module of the same name whose `run` does the work."""

    def prepare(self) -> None:
        """Configure JAX before it makes its first array: called before the module of `run` is imported."""


def option(metavar: str) -> Any:
    """Name the value of an option in --help; the text of an option without default says what happens without it."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=_hint)


def _hint(default: str) -> str:
    return "" if default in ("None", "") else f"(default: {default})"
