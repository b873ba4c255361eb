"""Scenes and first beliefs that `fit` derives, against recordings whose motion is known."""

import re

import numpy as np
import pytest
from helpers.recordings import recording, track

from foveate.recordings.fit import MAX_STEPS, MIN_STEPS, fit

SIDE, SPEED, PERIOD = 60.0, 1.5, 0.25


def crossings(scale=1.0, slower=1.0, period=PERIOD):
    """Targets that cross a street of SIDE along x at SPEED, all of it `scale` times as large and `slower`."""
    times = np.arange(0.0, SIDE / SPEED + 1e-9, period)
    tracks = [
        track(
            slower * (times + 3.0 * i),
            scale * np.stack([(-1.0) ** i * (SPEED * times - SIDE / 2), np.full_like(times, 0.1 * i)], axis=1),
            f"{i}",
        )
        for i in range(20)
    ]
    return recording(*tracks)


CROSSING_S = 0.98 * SIDE / SPEED
"""Time in the box of 98 % of the fixes; percentiles fall on fixes, so that it is known to 1 %."""


def test_an_episode_lasts_as_long_as_a_crossing():
    fitted = fit(crossings())
    steps = fitted.experiment.scenario.scenes.steps
    assert steps == pytest.approx(CROSSING_S / 0.5, rel=0.02)
    said = re.search(rf"episode of {steps} steps, {steps / 2:.3g} s; a target crosses in (\S+) s$", repr(fitted))
    assert said is not None
    assert float(said[1]) == pytest.approx(CROSSING_S, rel=0.01)


def test_lengths_and_times_have_no_scale_of_their_own():
    """Ships are walkers 100 times as large and 15 times as slow: the same numbers in other units."""
    here = fit(crossings(), tau=0.5, sensor_std_m=0.3, view_depth=10.0).experiment.scenario
    there = fit(crossings(100.0, 15.0), tau=7.5, sensor_std_m=30.0, view_depth=1000.0).experiment.scenario
    assert here.scenes.steps == there.scenes.steps
    ratio = there.target.initial_variance_m2 / here.target.initial_variance_m2
    assert ratio == pytest.approx(100.0**2, rel=1e-6)
    ratio = there.target.initial_velocity_variance_m2_s2 / here.target.initial_velocity_variance_m2_s2
    assert ratio == pytest.approx((100.0 / 15.0) ** 2, rel=1e-6)


def test_few_and_many_steps_are_bounded_and_the_longer_period_is_named():
    assert fit(crossings(), tau=2.0).experiment.scenario.scenes.steps == MIN_STEPS
    long = fit(crossings(100.0, 15.0), tau=0.5)
    assert long.experiment.scenario.scenes.steps == MAX_STEPS
    said = re.search(r"tau = (\S+) would cover it$", repr(long))
    assert said is not None
    assert float(said[1]) == pytest.approx(15 * CROSSING_S / MAX_STEPS, rel=0.03)


@pytest.mark.parametrize(("period", "tau", "age"), [(0.25, 0.5, 0.5), (4.0, 0.5, 4.0)])
def test_a_first_belief_is_that_of_one_detection(period, tau, age):
    """One step or one fix ago: sensor noise, and the way since then of a target that moves along one of two axes."""
    fitted = fit(crossings(period=period), tau=tau, sensor_std_m=0.3)
    target, scenes = fitted.experiment.scenario.target, fitted.experiment.scenario.scenes
    assert target.initial_variance_m2 == pytest.approx(0.09 + SPEED**2 / 2 * age**2, rel=1e-3)
    assert target.initial_velocity_variance_m2_s2 == pytest.approx(SPEED**2 / 2, rel=1e-3)
    assert (scenes.initial_error, scenes.first_mean_velocity) == ("consistent", "zero")
