"""Tables of text for terminals, notebooks and Markdown pages."""

import io
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

TABLE_WIDTH = 200
"""Characters per line if the output is not a terminal."""
GAP = 2
"""Spaces between two columns."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """Rows of text; the first two columns are words, the others numbers.

    `keys`: number of leading columns that name a row, repeated where a table has to be printed in parts. `details`:
    columns that only `draw(.., wide=True)` and pages show.
    """

    title: str
    note: str = ""
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    keys: int = 1
    details: tuple[str, ...] = ()

    @property
    def brief(self) -> "Table":
        """The table without its details."""
        kept = [i for i, name in enumerate(self.header) if name not in self.details]
        rows = tuple(tuple(row[i] for i in kept) for row in self.rows)
        return replace(self, header=tuple(self.header[i] for i in kept), rows=rows, details=())


def draw(table: Table, console: "Console", wide: bool = False) -> None:
    """Print a table and its note, in lines of the console's width.

    Columns that do not fit beside the first ones follow below them, in a part of their own that repeats the keys.
    """
    from rich.text import Text

    shown = table if wide else table.brief
    # As Text: in a plain string rich would look for markup and emoji, which a scene or a file may have in its name.
    console.print(Text(shown.title, "table.title"))
    for i, columns in enumerate(parts(shown, console.width)):
        if i > 0:
            console.print()
        _draw_part(shown, columns, console)
    if shown.note:
        console.print(Text(shown.note, "dim"))


def parts(table: Table, width: int) -> list[list[int]]:
    """Indices of the columns of each part of a table that is printed in lines of a width.

    Headings of several words take several lines where that saves a part.
    """
    return min((_parts(table, width, one_line) for one_line in (True, False)), key=len)


def _parts(table: Table, width: int, one_line: bool) -> list[list[int]]:
    widths = [_width(table, i, one_line) for i in range(len(table.header))]
    keys = list(range(min(table.keys, len(widths))))
    found = [keys.copy()]
    for i in range(len(keys), len(widths)):
        columns = [*found[-1], i]
        if sum(widths[j] for j in columns) + GAP * (len(columns) - 1) > width and len(found[-1]) > len(keys):
            columns = [*keys, i]
            found.append(columns)
        found[-1] = columns
    return found


def _widths(table: Table, columns: Sequence[int], width: int) -> dict[int, int]:
    """Widths of columns beside each other: as many headings are on one line as fit into a width, the shortest first."""
    widths = {i: _width(table, i, one_line=False) for i in columns}
    room = width - sum(widths.values()) - GAP * (len(columns) - 1)
    for i in sorted(columns, key=lambda i: _width(table, i, one_line=True) - widths[i]):
        more = _width(table, i, one_line=True) - widths[i]
        if more <= room:
            widths[i], room = widths[i] + more, room - more
    return widths


def _width(table: Table, column: int, one_line: bool) -> int:
    """Characters that a column needs; its heading may be broken between words, unless it is to be on one line."""
    from rich.cells import cell_len

    heading = table.header[column]
    words = [heading] if one_line else heading.split() or [""]
    return max(map(cell_len, [*words, *(row[column] for row in table.rows)]))


def draw_facts(title: str, facts: Mapping[str, str], console: "Console") -> None:
    """Print facts below a title, their names in a column of their own."""
    from rich.table import Table as Lines
    from rich.text import Text

    lines = Lines(box=None, show_header=False, padding=(0, GAP, 0, 0), pad_edge=False)
    lines.add_column(no_wrap=True, style="bold")
    lines.add_column(overflow="fold")
    for name, value in facts.items():
        lines.add_row(Text(name), Text(value))
    console.print(Text(title, "table.title"))
    console.print(lines)


def _draw_part(table: Table, columns: Sequence[int], console: "Console") -> None:
    from rich import box
    from rich.table import Table as Lines
    from rich.text import Text

    widths = _widths(table, columns, console.width)
    lines = Lines(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, GAP - 1, 0, 0), pad_edge=False, header_style="bold")
    for i in columns:
        is_word = i < 2 and not all(row[i].isdigit() for row in table.rows)
        justify = "left" if is_word else "right"
        lines.add_column(Text(table.header[i]), justify=justify, max_width=widths[i], overflow="fold")
    for row in table.rows:
        lines.add_row(*(Text(row[i]) for i in columns))
    console.print(lines)


def console_of_output() -> "Console":
    """Console of standard output: if it is not a terminal, without colours, and as wide as tables need."""
    from rich.console import Console

    return Console() if sys.stdout.isatty() else Console(width=TABLE_WIDTH, no_color=True)


def text(table: Table) -> str:
    """Return the text that `draw` prints on standard output, without colours."""
    from rich.console import Console

    file = io.StringIO()
    draw(table, Console(file=file, width=console_of_output().width, no_color=True, force_jupyter=False))
    return "\n".join(line.rstrip() for line in file.getvalue().rstrip().splitlines())


def html(table: Table) -> str:
    """Return a table as HTML, for a notebook."""

    def row(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    lines = [row(table.header, "th"), *(row(cells, "td") for cells in table.rows)]
    return f"<table><caption>{escape(table.title)}</caption>{''.join(lines)}</table>"


def markdown(title: str, facts: Mapping[str, str], tables: Sequence[Table], figures: Mapping[str, str]) -> str:
    """Return a Markdown page of a comparison: provenance facts, figures (file to caption), tables."""
    lines = [f"# {title}", "", *(f"- {name}: {literal(value)}" for name, value in facts.items()), ""]
    for file, caption in figures.items():
        lines += [f"![{literal(caption)}]({file})", ""]
    for table in tables:
        rule = "|---|---|" + "---:|" * (len(table.header) - 2)
        lines += [
            f"## {literal(table.title)}",
            "",
            table.note,
            "",
            _line(table.header),
            rule,
            *map(_line, table.rows),
            "",
        ]
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(map(literal, cells))} |"


def counted(number: int, noun: str) -> str:
    """A number with its noun: "1 scene", "2 scenes"."""
    return f"{number} {noun}{'s' * (number != 1)}"


def literal(text: str) -> str:
    """Text for a Markdown page, in which a name can make no cell, line, link, picture or HTML."""
    # A backslash first: before a "|" it would take its own away.
    for mark, entity in (("\\", "&#92;"), ("|", "\\|"), ("<", "&lt;"), ("](", "]&#40;")):
        text = text.replace(mark, entity)
    return " ".join(text.splitlines())
