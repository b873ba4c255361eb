"""Rows of text files in blocks of columns, and the line on which each row begins."""

import csv
from collections.abc import Iterator, Sequence
from itertools import chain, islice
from typing import BinaryIO, NamedTuple

import numpy as np
from jaxtyping import Int

from foveate.errors import InputError

MAX_LINE_BYTES = 4096
BLOCK_BYTES, BLOCK_ROWS = 1 << 21, 1 << 16
"""Size of a block: enough that numpy does the work, few enough that a file may have any length."""


class Block(NamedTuple):
    """Columns of some rows as texts, and the numbers of the lines on which the rows begin.

    `has_underscores`: there may be one in a text, which Python would read within a number.
    """

    columns: list[Sequence[str]]
    starts: Int[np.ndarray, " rows"]
    has_underscores: bool = True


class RowReader:
    """Blocks of rows with the columns `names`, from the line number `line` on, which counts along.

    `first` is a line that has been read from the file already, and is a row. `delimiter` None: blanks and tabs. With
    `comments`, lines that begin with # are skipped; blank lines always are.
    """

    def __init__(
        self, file: BinaryIO, first: str, line: int, delimiter: str | None, names: tuple[str, ...], comments: bool
    ) -> None:
        self._file, self._first, self.line = file, first, line
        self._delimiter, self._names, self._comments = delimiter, names, comments

    def __iter__(self) -> Iterator[Block]:
        """Raise InputError "line N: .." for a row that cannot be told apart, after the block of those before it."""
        text = self._first
        # Whole blocks at once while their lines are plain; from the first other one on, line by line.
        while raw := self._file.read(BLOCK_BYTES) + self._file.readline(MAX_LINE_BYTES + 1):
            if (columns := self._plain(text, raw)) is None:
                yield from self._careful(text, raw)
                return
            starts = self.line + np.arange(len(columns[0]))
            self.line += len(starts)
            yield Block(columns, starts, "_" in text or b"_" in raw)
            text = ""
        if text:
            yield from self._careful(text, b"")

    def _plain(self, text: str, raw: bytes) -> list[Sequence[str]] | None:
        """Columns of lines without quotes, blank lines and comments, all of the expected fields; None for others."""
        try:
            text += raw.decode("utf-8")
        except UnicodeDecodeError:
            return None
        text = text.replace("\r\n", "\n").removesuffix("\n")
        is_comment = self._comments and (text.startswith("#") or "\n#" in text)
        if '"' in text or "\r" in text or "\0" in text or is_comment or _longest(raw) > MAX_LINE_BYTES // 4:
            return None
        count, width = text.count("\n") + 1, len(self._names)
        # The end of a line becomes a field of its own: where it is always the last, all rows have as many fields.
        delimiter = self._delimiter
        parts = text.replace("\n", " \0 " if delimiter is None else f"{delimiter}\0{delimiter}").split(delimiter)
        if len(parts) != count * (width + 1) - 1 or parts[width :: width + 1].count("\0") != count - 1:
            return None
        return [parts[i :: width + 1] for i in range(width)]

    def _careful(self, text: str, raw: bytes) -> Iterator[Block]:
        """The same for any lines, one at a time."""
        lines = chain([text] if text else [], _decoded(raw, self._file))
        if self._comments:
            lines = ("\n" if line.startswith("#") else line for line in lines)
        delimiter = self._delimiter
        rows = map(str.split, lines) if delimiter is None else csv.reader(lines, delimiter=delimiter, strict=True)
        while True:
            block, failed = [], None
            try:
                for row in islice(rows, BLOCK_ROWS):
                    block.append(row)
            except (InputError, csv.Error) as error:
                failed = error
            yield from self._block(block)
            if failed is not None:
                expected = "; every row must be plain comma-separated text" if isinstance(failed, csv.Error) else ""
                raise InputError(f"line {self.line}: {failed}{expected}") from None
            if not block:
                return

    def _block(self, rows: list[list[str]]) -> Iterator[Block]:
        # A text in quotes may hold the ends of lines, and a blank line is an empty row.
        lengths = np.array([1 + sum(field.count("\n") for field in row) for row in rows], int)
        starts = self.line + np.cumsum(lengths) - lengths
        kept = [i for i, row in enumerate(rows) if row]
        width, bad = len(self._names), next((i for i in kept if len(rows[i]) != len(self._names)), None)
        good = kept if bad is None else kept[: kept.index(bad)]
        if good:
            yield Block(list(zip(*(rows[i] for i in good), strict=True)), starts[good])
        if bad is not None:
            names = ",".join(self._names)[:200]
            raise InputError(f"line {starts[bad]}: {len(rows[bad])} fields; there must be {width}: {names}")
        self.line += int(lengths.sum())


def _longest(raw: bytes) -> int:
    """Bytes of the longest line."""
    ends = np.flatnonzero(np.frombuffer(raw, np.uint8) == ord("\n"))
    return int(np.diff(ends, prepend=-1, append=len(raw)).max())


def decoded_line(file: BinaryIO, is_first: bool = False) -> str:
    """The next line of bounded length, so that a binary file does not fill the memory; "" at the end."""
    return _decode(file.readline(MAX_LINE_BYTES + 1), "utf-8-sig" if is_first else "utf-8")


def _decoded(raw: bytes, file: BinaryIO) -> Iterator[str]:
    for line in raw.splitlines(keepends=True):
        yield _decode(line, "utf-8")
    while line := file.readline(MAX_LINE_BYTES + 1):
        yield _decode(line, "utf-8")


def _decode(raw: bytes, encoding: str) -> str:
    if len(raw) > MAX_LINE_BYTES:
        raise InputError(f"longer than {MAX_LINE_BYTES} bytes; a row is a time, a track id and a position")
    try:
        return raw.decode(encoding)
    except UnicodeDecodeError as error:
        byte = raw[error.start : error.start + 1]
        raise InputError(f"byte {byte!r} is not UTF-8; save the file as UTF-8 text") from None
