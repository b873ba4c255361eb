"""Standard streams of a command: closed ones, closed pipes and names that they cannot encode do not end it."""

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any


@contextmanager
def steady_streams() -> Iterator[None]:
    """Replace standard output and error by streams that go on.

    Where a pipe is no longer read, the rest goes nowhere, and the command finishes its work and its files. Other
    failures of standard output, as a full disk, raise OSError that names it.
    """
    _fill_descriptors()
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _Steady(sys.stdout, "standard output"), _Steady(sys.stderr)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def _fill_descriptors() -> None:
    """Open closed standard descriptors: the next file would take their place, and prints would go into it."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest one that is free, which is this one


class _Steady:
    """A text stream, or nothing in place of a closed one; with a name, failures other than a closed pipe are raised."""

    def __init__(self, stream: Any, name: str = "") -> None:
        self._stream: Any = io.StringIO() if stream is None else stream
        self._name, self._is_open = name, stream is not None
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write, unless the stream is closed."""
        if self._is_open:
            self._call(self._stream.write, text)
        return len(text)

    def flush(self) -> None:
        """Flush, unless the stream is closed."""
        if self._is_open:
            self._call(self._stream.flush)

    def _call(self, method: Any, *arguments: str) -> None:
        try:
            method(*arguments)
        except OSError as error:
            self._is_open = False
            with suppress(OSError, ValueError):  # what is left in its buffer would fail again at the end of Python
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
            if self._name and not isinstance(error, BrokenPipeError):
                raise OSError(error.errno, error.strerror, self._name) from error
