"""Time programs: medians of repeats as metrics with unit and direction, reference rates, compilation counts.

Seconds of one machine say little about another. Every metric therefore has a `ratio` to a reference that was measured
in the same run: the operations of a large matrix product, or rounds of a Python loop, that the machine does in that
time.
"""

import contextlib
import functools
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

MAX_SPREAD = 0.25
"""Spread of repeats above which their median is unreliable."""

CPU_MATRIX, ACCELERATOR_MATRIX = 2048, 8192
"""Side of the reference's matrix product: large enough for the full rate, small enough to be short."""

Unit = Literal["s", "us", "1/s", "GFLOP/s", "MiB", "1"]
Seconds = Sequence[float] | np.ndarray

_COMPILATION_EVENT = "/jax/core/compile/backend_compile_duration"


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A result of a benchmark; `spread` is that of its repeats, `per` the reference of its ratio."""

    key: str
    value: float
    unit: Unit
    better: Literal["lower", "higher"]
    per: Literal["matmul", "python"] | None = None
    spread: float = 0.0

    def ratio(self, references: dict[str, float]) -> float:
        """The value in operations of its reference, which a uniformly faster machine does not change."""
        if self.per is None:
            return self.value
        rate = references[self.per]
        return {"s": self.value * rate, "us": 1e-6 * self.value * rate, "1/s": self.value / rate}[self.unit]


def spread(seconds: Seconds) -> float:
    """Distance between the quartiles, as a share of the median."""
    low, median, high = np.percentile(seconds, (25, 50, 75))
    return float((high - low) / median)


def time_metric(
    key: str, seconds: Seconds, unit: Literal["s", "us"] = "s", per: Literal["matmul", "python"] = "python"
) -> Metric:
    """Median time of a call, from the seconds of its repeats."""
    value = float(np.median(seconds)) * {"s": 1.0, "us": 1e6}[unit]
    return Metric(key=key, value=value, unit=unit, better="lower", per=per, spread=spread(seconds))


def rate_metric(key: str, count: int | float, seconds: Seconds) -> Metric:
    """Median rate of a call that processes `count` items, from the seconds of its repeats."""
    value = count / float(np.median(seconds))
    return Metric(key=key, value=value, unit="1/s", better="higher", per="matmul", spread=spread(seconds))


def timed(call: Callable[[], Any]) -> float:
    """Wall time of a call until its arrays are ready [s]."""
    began = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - began


def in_turn(calls: Sequence[Callable[[], Any]], repeats: int) -> np.ndarray:
    """Wall times [s], repeats x calls, after a warm-up. Calls alternate, so that other load slows all alike."""
    for call in calls:
        jax.block_until_ready(call())
    return np.array([[timed(call) for call in calls] for _ in range(repeats)])


@functools.cache
def matrix_product() -> tuple[Callable[[], jax.Array], float]:
    """Return a large float32 matrix product on one device, and its number of floating-point operations."""
    size = CPU_MATRIX if jax.default_backend() == "cpu" else ACCELERATOR_MATRIX
    matrix = jnp.ones((size, size), jnp.float32)
    product = jax.jit(lambda a, b: jnp.matmul(a, b, precision="highest"))
    return lambda: product(matrix, matrix), 2.0 * size**3


def _python_loop(rounds: int) -> int:
    total = 0
    for i in range(rounds):
        total = (total + i * i) % 9973
    return total


def measure_references(repeats: int) -> dict[str, float]:
    """Rate of each reference [1/s]: floating-point operations of a matrix product, rounds of a Python loop."""
    (product, operations), rounds = matrix_product(), 100_000
    product_s, loop_s = np.median(in_turn([product, lambda: _python_loop(rounds)], repeats), axis=0)
    return {"matmul": operations / float(product_s), "python": rounds / float(loop_s)}


@contextlib.contextmanager
def compilations() -> Iterator[list[float]]:
    """Collect the seconds of each compilation inside the context, in the order in which they end."""
    compiled: list[float] = []

    def listen(event: str, duration_secs: float, **_: str | int) -> None:
        if event == _COMPILATION_EVENT:
            compiled.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield compiled
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def peak_memory_mib() -> float:
    """Peak memory of this process, or of the first device where that is an accelerator, so far [MiB]."""
    facts = jax.local_devices()[0].memory_stats()
    if facts and "peak_bytes_in_use" in facts:
        return facts["peak_bytes_in_use"] / 2**20
    import resource  # which Windows does not have

    unit = 1 if sys.platform == "darwin" else 1024  # getrusage counts bytes there, KiB elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20
