"""Measure whole processes: the start of the command line, and the paper's training."""

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
    """Time before every command: its help, and the import of all that training needs."""
    commands = {
        "help_s": ["-m", "foveate.cli.main", "--help"],
        "import_s": ["-c", "import foveate.learning.loop"],
    }
    calls = [lambda command=command: process_time(*command) for command in commands.values()]
    seconds = in_turn(calls, min(repeats, MAX_STARTS))
    return [time_metric(key, column) for key, column in zip(commands, seconds.T, strict=True)]


def whole_training() -> list[Metric]:
    """`foveate train --preset paper` with an empty cache of compiled programs, and again with the full one."""
    metrics = []
    with tempfile.TemporaryDirectory() as folder:
        for name in ("cold", "warm"):
            command = ["-m", "foveate.cli.main", "train", "--preset", "paper", "--out", f"{folder}/{name}"]
            metrics.append(time_metric(f"train_process_{name}_s", [process_time(*command, cache=f"{folder}/cache")]))
    return metrics


def process_time(*arguments: str, cache: str | None = None) -> float:
    """Wall time of a process of this Python [s]. Raises InputError with its last line where it fails."""
    variables = {} if cache is None else {"JAX_COMPILATION_CACHE_DIR": cache}
    began = time.perf_counter()
    process = subprocess.run(
        [sys.executable, *arguments], env={**os.environ, **variables}, capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - began
    if process.returncode != 0:
        last = (process.stderr.strip().splitlines() or ["no message"])[-1]
        raise InputError(f"{' '.join(arguments)}: ended with {process.returncode}: {last}")
    return seconds
