"""Tables of text, and the Markdown page that holds them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Table:
    """Text in rows; the first two columns are words, the others numbers."""

    title: str
    note: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def markdown(title: str, facts: Mapping[str, str], found: Sequence[Table], figures: Mapping[str, str]) -> str:
    """The page of a comparison: what it was made with, its figures (file: what it shows), its tables."""
    lines = [f"# {title}", ""]
    lines += [f"- {name}: {value}" for name, value in facts.items()] + [""]
    for file, what in figures.items():
        lines += [f"![{what}]({file})", ""]
    for table in found:
        lines += [f"## {table.title}", "", table.note, "", _line(table.header)]
        lines.append("|---|---|" + "---:|" * (len(table.header) - 2))
        lines += [*map(_line, table.rows), ""]
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
