"""Messages of a command: what the logger "foveate" says goes to standard error."""

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from foveate.io.progress import logger


class _Handler(logging.StreamHandler):  # type: ignore[type-arg]
    """Writes to what is standard error at the time: a progress bar puts lines above itself there."""

    def emit(self, record: logging.LogRecord) -> None:
        self.stream = sys.stderr
        super().emit(record)


@contextmanager
def logged(quiet: bool, verbose: bool) -> Iterator[None]:
    """Print messages on standard error: warnings alone if `quiet`, every step, with its time, if `verbose`."""
    handler, before = _Handler(), logger.level
    handler.setFormatter(logging.Formatter("%(asctime)s  %(message)s" if verbose else "%(message)s", "%H:%M:%S"))
    logger.addHandler(handler)
    logger.setLevel(logging.WARNING if quiet else logging.DEBUG if verbose else logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
