"""How options are shown in --help."""

from typing import Any

import tyro


def option(metavar: str) -> Any:
    """An option whose value is called so; where its default is none, its text says what happens without it."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=_hint)


def _hint(default: str) -> str:
    return "" if default in ("None", "") else f"(default: {default})"
