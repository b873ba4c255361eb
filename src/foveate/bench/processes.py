"""Time whole processes: the start of the command line, and the paper's training."""

import functools
import os
import subprocess
import sys
import tempfile
import time

from foveate.bench.timing import Metric, in_turn, time_metric
from foveate.errors import InputError

MAX_STARTS = 5
"""Repeats of starting: a process takes a second, and varies little."""


def starting(repeats: int) -> list[Metric]:
    """Time the start of every command: its help, and the import of all that training needs."""
    commands = {"help_s": ["-m", "foveate.cli.main", "--help"], "import_s": ["-c", "import foveate.learning.loop"]}
    calls = [functools.partial(process_time, *command) for command in commands.values()]
    seconds = in_turn(calls, min(repeats, MAX_STARTS))
    return [time_metric(key, column) for key, column in zip(commands, seconds.T, strict=True)]


def whole_training() -> list[Metric]:
    """Time `foveate train --preset paper` without verdict, with an empty cache of compiled programs, and a full one."""
    command = ("-m", "foveate.cli.main", "train", "--preset", "paper", "--no-verdict", "--out")
    with tempfile.TemporaryDirectory() as folder:
        return [
            time_metric(
                f"train_process_{name}_s", [process_time(*command, f"{folder}/{name}", cache=f"{folder}/cache")]
            )
            for name in ("cold", "warm")
        ]


def process_time(*arguments: str, cache: str | None = None) -> float:
    """Wall time of a Python process [s]; an InputError with its last line where it fails."""
    environment = os.environ | ({} if cache is None else {"JAX_COMPILATION_CACHE_DIR": cache})
    began = time.perf_counter()
    process = subprocess.run([sys.executable, *arguments], env=environment, capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - began
    if process.returncode != 0:
        last = (process.stderr.strip().splitlines() or ["no message"])[-1]
        raise InputError(f"{' '.join(arguments)}: ended with {process.returncode}: {last}")
    return seconds
