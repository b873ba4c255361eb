"""How programs are timed: metrics with unit and direction, medians of repeats, yardsticks, compilations counted.

A number of seconds says little about another machine. Beside it stands its `ratio` to a yardstick that was measured in
the same run: how many of the machine's own large matrix products, or of its own plain Python, fit into that time.
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

WIDE = 0.25
"""A spread of repeats (half of them lie in this share of the median) from which on a number is not to be trusted."""


MATRIX = {"cpu": 2048}
"""Side of the matrix product that is the yardstick; on accelerators OTHER_MATRIX."""


OTHER_MATRIX = 8192


_COMPILED = "/jax/core/compile/backend_compile_duration"


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One number of a benchmark; `spread` is that of its repeats, `per` the yardstick that its ratio is taken to."""

    key: str
    value: float
    unit: Literal["s", "us", "1/s", "GFLOP/s", "MiB", "1"]
    better: Literal["lower", "higher"]
    per: Literal["matmul", "python"] | None = None
    spread: float = 0.0

    @property
    def is_wide(self) -> bool:
        """Whether the repeats differ too much."""
        return self.spread > WIDE

    def ratio(self, yardsticks: dict[str, float]) -> float:
        """The value in units of its yardstick, operations a second: free of how fast the machine is as a whole."""
        if self.per is None:
            return self.value
        rate = yardsticks[self.per]
        return {"s": self.value * rate, "us": 1e-6 * self.value * rate, "1/s": self.value / rate}[self.unit]


def spread(seconds: Sequence[float] | np.ndarray) -> float:
    """The distance between the quartiles, as a share of the median."""
    low, middle, high = np.percentile(seconds, (25, 50, 75))
    return float((high - low) / middle)


def timed(call: Callable[[], Any]) -> float:
    """Wall time of one call that is waited for [s]."""
    began = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - began


def in_turn(calls: Sequence[Callable[[], Any]], repeats: int) -> np.ndarray:
    """Wall times [s], repeats x calls: after a warm-up one call after the other, so that a busy machine slows all."""
    for call in calls:
        jax.block_until_ready(call())
    return np.array([[timed(call) for call in calls] for _ in range(repeats)])


@functools.cache
def matrix_product() -> tuple[Callable[[], jax.Array], float]:
    """A large float32 matrix product on one device, and its floating-point operations."""
    size = MATRIX.get(jax.default_backend(), OTHER_MATRIX)
    matrix = jnp.ones((size, size), jnp.float32)
    product = jax.jit(lambda a, b: jnp.matmul(a, b, precision="highest"))
    return lambda: product(matrix, matrix), 2.0 * size**3


def plain_python(loops: int = 100_000) -> int:
    """What plain Python is measured by, on one core."""
    total = 0
    for i in range(loops):
        total = (total + i * i) % 9973
    return total


def measure_references(repeats: int) -> dict[str, float]:
    """Rate of each yardstick [1/s]: floating-point operations of a matrix product, rounds of a Python loop."""
    product, operations = matrix_product()
    loops = 100_000
    seconds = np.median(in_turn([product, lambda: plain_python(loops)], repeats), axis=0)
    return {"matmul": operations / float(seconds[0]), "python": loops / float(seconds[1])}


@contextlib.contextmanager
def compilations() -> Iterator[list[float]]:
    """The seconds of each compilation that happens inside, in the order in which they end."""
    found: list[float] = []

    def listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
        del kwargs
        if event == _COMPILED:
            found.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield found
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def peak_memory_mib() -> float:
    """The most memory that this process, or on an accelerator the first device, has held so far [MiB]."""
    facts = jax.local_devices()[0].memory_stats()
    if facts and "peak_bytes_in_use" in facts:
        return facts["peak_bytes_in_use"] / 2**20
    import resource  # which Windows does not have

    unit = 1 if sys.platform == "darwin" else 1024  # getrusage counts bytes there, KiB elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20
