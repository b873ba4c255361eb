"""Options of commands: what all commands have, and how an option is shown in --help."""

from typing import Any

import tyro


class Command:
    """Options of a command; its work is `run` of the module of its name in `cli.run`."""

    def prepare(self) -> None:
        """Set what JAX must know before it makes its first array: called before the module of `run` is imported."""


def option(metavar: str) -> Any:
    """An option whose value is called so; where its default is none, its text says what happens without it."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=_hint)


def _hint(default: str) -> str:
    return "" if default in ("None", "") else f"(default: {default})"
