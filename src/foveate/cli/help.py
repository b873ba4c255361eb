"""Texts of --help, wrapped to the terminal: paragraphs in the source are wrapped for the source."""

import ast
import functools
import inspect
import shutil
import textwrap
from typing import Annotated

import tyro

WIDEST = 100
"""Most characters of a line of a text."""


def wrapped(text: str) -> str:
    """Wrap the paragraphs of a text to the terminal's width; indented lines, commands to copy, stay.

    Every line begins with a space, without which the parser would join it to the one before.
    """
    columns = shutil.get_terminal_size().columns
    width = columns if columns > 2 * WIDEST else min(columns, WIDEST)
    lines = []
    for paragraph in inspect.cleandoc(text).split("\n\n"):
        parts = paragraph.splitlines()
        first = next((i for i, line in enumerate(parts) if line.startswith(" ")), len(parts))
        prose = textwrap.wrap(" ".join(parts[:first]), width, initial_indent=" ", subsequent_indent=" ")
        lines += [*prose, *(f" {line}" for line in parts[first:]), ""]
    return "\n".join(lines[:-1])


@functools.cache
def explained(kind: type) -> type:
    """Give the options of a command their docstrings as help without the line breaks of the source; return it."""
    body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    assert isinstance(body, ast.ClassDef)
    kind.__annotations__ = kind.__annotations__ | {
        field.target.id: Annotated[kind.__annotations__[field.target.id], tyro.conf.arg(help=text)]
        for field, after in zip(body.body, body.body[1:], strict=False)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and (text := _text(after))
    }
    return kind


def _text(node: ast.stmt) -> str:
    """The docstring that a statement is, in one line; "" for another statement."""
    value = node.value.value if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) else ""
    return " ".join(value.split()) if isinstance(value, str) else ""
