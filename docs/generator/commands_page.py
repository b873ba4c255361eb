"""Generate the page of all commands and options from the `--help` of the command line."""

import contextlib
import io
import os
import re
from collections.abc import Iterator
from dataclasses import fields
from unittest.mock import patch

from foveate.cli.main import COMMANDS, main

INTRODUCTION = """# Commands

All commands and options, as in `foveate COMMAND --help`. Exit status: 0 success, 1 ran but a check failed, 2 invalid
input (one line on stderr), 70 a bug of foveate, 130 interrupted. For a command that takes `RUN|PRESET`, a
[preset](presets.md) name means its trained policy in the package.

With any command, `-q` (`--quiet`) prints warnings and results alone, `-v` (`--verbose`) every step with its time, and
`--debug` the traceback of an error. On a terminal long work shows a bar with the time left; where standard error is a
file or a pipe, a line at each tenth. Tables fit into the terminal's width; `--wide` adds columns where there are more.

Completion of options in bash: `eval "$(foveate --tyro-print-completion bash)"` (or `zsh`, `tcsh`).
"""
PANEL = re.compile(r"^ \S.*\n -+\n((?:  .*\n)+)", re.MULTILINE)
DEFAULT = re.compile(r" \((?:default: ([^()]*)|required)\)$")


def page() -> str:
    """Return the whole page as Markdown."""
    return "\n\n".join([INTRODUCTION, *(_section(name) for name in COMMANDS)]) + "\n"


def help_of(command: str) -> str:
    """Return the output of `foveate COMMAND --help`, in lines wide enough that no explanation is wrapped."""
    shown = io.StringIO()
    with patch.dict(os.environ, COLUMNS="500"), contextlib.redirect_stdout(shown), contextlib.suppress(SystemExit):
        main([command, "--help"])
    return "\n".join(line.rstrip() for line in shown.getvalue().splitlines()) + "\n"


def options(panel: str) -> Iterator[tuple[str, str]]:
    """Yield the names and explanations in a panel of a help text; names are indented by two columns, the rest more."""
    for entry in re.split(r"^  (?! )", panel, flags=re.MULTILINE)[1:]:
        name, *said = re.split(r"\s{2,}", entry.strip())
        yield name, " ".join(said)


def _section(command: str) -> str:
    text = help_of(command)
    usage, _, said = text.partition("\n")
    rows = [row for panel in PANEL.finditer(text) for row in options(panel[1])]
    shown = PANEL.split(said)[0].split("\n\n")
    current = {field.name.replace("_", "-") for field in fields(COMMANDS[command])}
    table = [_row(_without_aliases(name, current), what) for name, what in rows if not name.startswith("-h,")]
    return "\n\n".join(
        [
            f"## foveate {command}",
            f"```text\n{usage.removeprefix('usage: ')}\n```",
            *(_paragraph(part) for part in shown if part.strip()),
            "| option | default | |\n|---|---|---|\n" + "\n".join(table),
        ]
    )


def _paragraph(text: str) -> str:
    """Format a paragraph of an explanation, or commands to copy."""
    lines = [line.strip() for line in text.strip().splitlines()]
    return "\n".join(["```sh", *lines, "```"] if all(line.startswith("foveate ") for line in lines) else lines)


def _without_aliases(name: str, current: set[str]) -> str:
    """Remove the names of earlier versions from an option; `current` are the present names."""
    parts = name.split(", ")
    kept = [part for part in parts if part.removeprefix("--").removeprefix("no-") in current]
    return ", ".join(kept) if len(kept) > 1 else name


def _row(name: str, what: str) -> str:
    """Format a row of the table; long choices may wrap, and bars in cells are escaped."""
    found = DEFAULT.search(what)
    text = what[: found.start()] if found else what
    default = "*required*" if found and found[1] is None else "" if not found or found[1] in ("None", "") else found[1]
    option = re.sub(r",\s*", ", ", name.replace("{None}|", "").replace("{None,", "{")).replace("|", " \\| ")
    return f"| `{option}` | {default} | {text.replace('|', chr(92) + '|')} |"
