"""Timing: medians, spreads, ratios free of the machine's speed, and compilations that are counted."""

import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foveate.bench.timing import Metric, compilations, in_turn, measure_references, peak_memory_mib, spread, timed


def test_spread_is_that_of_the_quartiles():
    assert spread([1.0, 2.0, 3.0, 4.0, 5.0]) == pytest.approx(2 / 3)
    assert spread([2.0, 2.0, 2.0]) == 0.0


def test_ratios_do_not_change_with_the_machines_speed():
    """A machine that is three times as fast takes a third of the time, and its yardstick does three times as much."""
    for unit, slow, fast in (("s", 0.3, 0.1), ("us", 3.0, 1.0), ("1/s", 100.0, 300.0)):
        ratios = [
            Metric(key="a", value=value, unit=unit, better="lower", per="python").ratio({"python": rate})
            for value, rate in ((slow, 1e6), (fast, 3e6))
        ]
        assert ratios[0] == pytest.approx(ratios[1])
    assert Metric(key="a", value=0.5, unit="s", better="lower", per="matmul").ratio({"matmul": 4.0}) == 2.0
    assert Metric(key="a", value=7.0, unit="1", better="lower").ratio({}) == 7.0


def test_calls_are_made_in_turn_after_a_warm_up_and_waited_for():
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


def test_yardsticks_and_memory_are_of_this_machine():
    found = measure_references(1)
    assert found["matmul"] > 1e8, "operations a second"
    assert found["python"] > 1e4, "rounds of a loop a second"
    held = np.ones(2**23)  # 64 MiB, written to
    assert peak_memory_mib() >= held.nbytes / 2**20
