"""Timing: medians, spreads, ratios free of the machine's speed, and compilations that are counted."""

import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.bench import timing
from foveate.bench.timing import (
    Metric,
    compilations,
    in_turn,
    measure_references,
    peak_memory_mib,
    rate_metric,
    spread,
    time_metric,
    timed,
)


def test_spread_is_that_of_the_quartiles():
    assert spread([1.0, 2.0, 3.0, 4.0, 5.0]) == pytest.approx(2 / 3)
    assert spread([2.0, 2.0, 2.0]) == 0.0


def test_ratios_do_not_change_with_the_machines_speed():
    """A machine that is three times as fast takes a third of the time, and its reference does three times as much."""
    for unit, slow, fast in (("s", 0.3, 0.1), ("us", 3.0, 1.0), ("1/s", 100.0, 300.0)):
        ratios = [
            Metric(key="a", value=value, unit=unit, better="lower", per="python").ratio({"python": rate})
            for value, rate in ((slow, 1e6), (fast, 3e6))
        ]
        assert ratios[0] == pytest.approx(ratios[1])
    assert Metric(key="a", value=0.5, unit="s", better="lower", per="matmul").ratio({"matmul": 4.0}) == 2.0
    assert Metric(key="a", value=7.0, unit="1", better="lower").ratio({}) == 7.0


def test_calls_alternate_after_a_warm_up_and_are_awaited():
    made = []
    seconds = in_turn([lambda: made.append("a"), lambda: made.append("b")], 2)
    assert made == ["a", "b", "a", "b", "a", "b"]
    assert seconds.shape == (2, 2)
    assert timed(lambda: time.sleep(0.02)) >= 0.02


def test_compilations_are_counted_and_only_inside():
    double = jax.jit(lambda x: 2.0 * x)
    with compilations() as found:
        double(jnp.ones(3)).block_until_ready()
        first = len(found)
        double(jnp.zeros(3)).block_until_ready()
        assert len(found) == first
        double(jnp.zeros(4)).block_until_ready()
        assert len(found) > first, "another shape is another program"
    inside = len(found)
    double(jnp.zeros(5)).block_until_ready()
    assert len(found) == inside >= 2


def test_times_in_one_run_are_in_the_proportion_of_the_work():
    """Sleeps of 20 and 100 ms: a busy machine makes both longer, but neither shorter."""
    seconds = in_turn([lambda: time.sleep(0.02), lambda: time.sleep(0.1)], 5)
    assert (seconds >= [0.02, 0.1]).all()
    short, long = (time_metric(key, column) for key, column in zip("ab", seconds.T, strict=True))
    assert 1.5 < long.value / short.value < 5.5
    rate = rate_metric("c", 7, seconds[:, 1])
    assert rate.value * long.value == pytest.approx(7)
    assert (rate.unit, rate.better, rate.spread) == ("1/s", "higher", long.spread)
    assert time_metric("d", seconds[:, 0], unit="us").value == pytest.approx(1e6 * short.value)


def test_references_are_rates(monkeypatch, clock):
    """In calls of 2 s: a product of 2,048 squared matrices of ones, and 100,000 rounds of a loop."""
    monkeypatch.setattr(timing, "in_turn", clock)
    size = timing.CPU_MATRIX
    assert measure_references(3) == {"matmul": 2.0 * size**3 / 2.0, "python": 100_000 / 2.0}
    product, total = clock.results
    np.testing.assert_array_equal(product, np.full((size, size), size))
    assert total == sum(i * i for i in range(100_000)) % 9973


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux")
def test_peak_memory_equals_that_of_the_kernel():
    fields = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    kernel_mib = int(fields["VmHWM"].split()[0]) / 1024
    assert peak_memory_mib() == pytest.approx(kernel_mib, rel=0.05)
