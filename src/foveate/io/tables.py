"""Tables of text for terminals, notebooks and Markdown pages."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

TABLE_WIDTH = 200
"""Characters per line if the output is not a terminal."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """Rows of text; the first two columns are words, the others numbers."""

    title: str
    note: str = ""
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def draw(table: Table, console: "Console") -> None:
    """Print a table, without its note, on a console."""
    from rich.markup import escape
    from rich.table import Table as Lines

    lines = Lines(title=escape(table.title), title_justify="left", header_style="bold")
    for i, name in enumerate(table.header):
        lines.add_column(escape(name), justify="left" if i < 2 else "right", no_wrap=True)
    for row in table.rows:
        lines.add_row(*row)
    console.print(lines)


def text(table: Table) -> str:
    """Return the text that `draw` prints, without colours."""
    from rich.console import Console

    file = io.StringIO()
    draw(table, Console(file=file, width=TABLE_WIDTH, no_color=True, force_jupyter=False))
    return "\n".join(line.rstrip() for line in file.getvalue().rstrip().splitlines())


def html(table: Table) -> str:
    """Return a table as HTML, for a notebook."""

    def row(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    lines = [row(table.header, "th"), *(row(cells, "td") for cells in table.rows)]
    return f"<table><caption>{escape(table.title)}</caption>{''.join(lines)}</table>"


def markdown(title: str, facts: Mapping[str, str], tables: Sequence[Table], figures: Mapping[str, str]) -> str:
    """Return a Markdown page of a comparison: provenance facts, figures (file to caption), tables."""
    lines = [f"# {title}", "", *(f"- {name}: {value}" for name, value in facts.items()), ""]
    for file, caption in figures.items():
        lines += [f"![{caption}]({file})", ""]
    for table in tables:
        rule = "|---|---|" + "---:|" * (len(table.header) - 2)
        lines += [f"## {table.title}", "", table.note, "", _line(table.header), rule, *map(_line, table.rows), ""]
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
