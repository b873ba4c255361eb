"""The command `foveate` on a slow disk: `python -m endurance.slow_disk TRAIN_OPTIONS..`.

Every file is written in pieces, each on the disk before the next, so that a process can be killed within a write.
"""

import builtins
import os
import sys
import time
from typing import Any

from foveate.cli.main import main
from foveate.io import files

PIECES, PAUSE_S = 20, 0.01


class SlowFile:
    """A file that takes what is written to it piece by piece."""

    def __init__(self, file: Any) -> None:
        self.file = file

    def __getattr__(self, name: str) -> Any:
        return getattr(self.file, name)

    def __enter__(self) -> "SlowFile":
        return self

    def __exit__(self, *exception: object) -> None:
        self.file.close()

    def write(self, data: bytes) -> int:
        """Write in pieces."""
        size = max(1, -(-len(data) // PIECES))
        for begin in range(0, len(data), size):
            self.file.write(data[begin : begin + size])
            self.file.flush()
            os.fsync(self.file.fileno())
            time.sleep(PAUSE_S)
        return len(data)


def open_slowly(path: Any, mode: str = "r", **options: Any) -> Any:
    """As `open`; what is opened for writing is slow."""
    file = builtins.open(path, mode, **options)  # noqa: SIM115
    return SlowFile(file) if "x" in mode else file


if __name__ == "__main__":
    setattr(files, "open", open_slowly)  # noqa: B010  (a name that the module does not have yet)
    sys.exit(main())
