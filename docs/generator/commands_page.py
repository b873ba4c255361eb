"""The page of every command and option, from the help that the command line itself prints."""

import contextlib
import io
import os
import re
from collections.abc import Iterator
from unittest.mock import patch

from foveate.cli.main import COMMANDS, main

INTRODUCTION = """# Commands

`foveate COMMAND --help` says the same in a terminal. Exit status: 0 done, 1 ran but a check failed, 2 wrong input (one
line on stderr), 70 a bug of foveate, 130 interrupted. `--debug`, beside any command, shows the traceback of an error. Where a command takes `RUN|PRESET`, the name of a preset stands for the trained policy
that the package brings.
"""
PANEL = re.compile(r"^ \S.*\n -+\n((?:  .*\n)+)", re.MULTILINE)
DEFAULT = re.compile(r" \((?:default: ([^()]*)|required)\)$")


def page() -> str:
    """The whole page, in Markdown."""
    return "\n\n".join([INTRODUCTION, *(_section(name) for name in COMMANDS)]) + "\n"


def help_of(command: str) -> str:
    """What `foveate COMMAND --help` prints, in lines so wide that no word of an explanation is broken off."""
    shown = io.StringIO()
    with patch.dict(os.environ, COLUMNS="500"), contextlib.redirect_stdout(shown), contextlib.suppress(SystemExit):
        main([command, "--help"])
    return "\n".join(line.rstrip() for line in shown.getvalue().splitlines()) + "\n"


def options(panel: str) -> Iterator[tuple[str, str]]:
    """Names and explanations of a panel of a help text: a name stands two columns in, all else further."""
    for entry in re.split(r"^  (?! )", panel, flags=re.MULTILINE)[1:]:
        name, *said = re.split(r"\s{2,}", entry.strip())
        yield name, " ".join(said)


def _section(command: str) -> str:
    text = help_of(command)
    usage, _, said = text.partition("\n")
    rows = [row for panel in PANEL.finditer(text) for row in options(panel[1])]
    shown = PANEL.split(said)[0].split("\n\n")
    table = [_row(name, what) for name, what in rows if not name.startswith("-h,")]
    return "\n\n".join(
        [
            f"## foveate {command}",
            f"```text\n{usage.removeprefix('usage: ')}\n```",
            *(_paragraph(part) for part in shown if part.strip()),
            "| option | default | |\n|---|---|---|\n" + "\n".join(table),
        ]
    )


def _paragraph(text: str) -> str:
    """A paragraph of an explanation, or commands to copy."""
    lines = [line.strip() for line in text.strip().splitlines()]
    return "\n".join(["```sh", *lines, "```"] if all(line.startswith("foveate ") for line in lines) else lines)


def _row(name: str, what: str) -> str:
    """A line of the table: choices may be broken into lines, and cells have no bars."""
    found = DEFAULT.search(what)
    text = what[: found.start()] if found else what
    default = "*required*" if found and found[1] is None else "" if not found or found[1] in ("None", "") else found[1]
    option = name.replace("{None}|", "").replace("{None,", "{").replace(",", ", ").replace("|", " \\| ")
    return f"| `{option}` | {default} | {text.replace('|', chr(92) + '|')} |"
