"""Settings of sensors: covariances of any scale reach the problem."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.rejections import assert_rejected

from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import SensorSettings


def test_badly_scaled_covariances_are_valid_in_float32():
    """A kilometre beside a millimetre: what scales the axes costs no digits."""
    V = ((1e6, 0.0), (0.0, 1e-6))
    with jax.enable_x64(False):
        problem = Scenario(sensor=SensorSettings(V=V)).problem()
    np.testing.assert_array_equal(problem.sensor.V, np.float32(V))


TURNED = ((0.5, 0.5), (0.5, 0.5))
"""Rank 1, not along an axis."""
SPARSE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
BAD = {
    "std": (lambda: SensorSettings(std_m=0.0), "std_m = 0.0"),
    "growth": (lambda: SensorSettings(range_growth_per_m=-0.1), "range_growth_per_m = -0.1"),
    "V singular": (lambda: SensorSettings(V=TURNED), "V = ((0.5, 0.5)"),
    "V negative": (lambda: SensorSettings(V=((-1.0,),)), "V = ((-1.0,),)"),
    "V not symmetric": (lambda: SensorSettings(V=((1.0, 0.1), (0.0, 1.0))), "symmetric"),
    "V not square": (lambda: SensorSettings(V=SPARSE), "expected shape 2 x 2, got 2 x 3"),
    "H ragged": (lambda: SensorSettings(H=((1.0, 0.0), (1.0,))), "H = ((1.0, 0.0), (1.0,))"),
    "H empty": (lambda: SensorSettings(H=()), "H = ()"),
    "V that float32 takes for singular": (
        lambda: SensorSettings(V=((1.0, 1.0 - 1e-8), (1.0 - 1e-8, 1.0))),
        "also in float32",
    ),
}
POLAR = {"measures": "range-bearing", "std_range_m": 0.2, "std_bearing_rad": 0.01}
BAD |= {
    "std of a range without a range": (
        lambda: SensorSettings(std_range_m=0.2),
        "std_range_m = 0.2: goes with measures = 'range-bearing' or 'range' or 'azimuth-elevation-range', which is not",
    ),
    "range without its std": (
        lambda: SensorSettings(measures="range-bearing", std_bearing_rad=0.01),
        "std_range_m: is missing, with measures = 'range-bearing'",
    ),
    "position's std": (
        lambda: SensorSettings(**POLAR, std_m=0.1),
        "std_m = 0.1: goes with a measured position; with measures = 'range-bearing' give std_range_m",
    ),
    "bearing's std negative": (
        lambda: SensorSettings(measures="bearing", std_bearing_rad=-1.0),
        "std_bearing_rad = -1.0: expected > 0, at most 1 rad",
    ),
    "bearing's std in degrees": (
        lambda: SensorSettings(measures="bearing", std_bearing_rad=5.0),
        "std_bearing_rad = 5.0: expected > 0, at most 1 rad",
    ),
    "growth of a range not measured": (
        lambda: SensorSettings(measures="bearing", std_bearing_rad=0.1, range_growth_per_m=0.1),
        "range_growth_per_m = 0.1: expected 0 with measures = 'bearing'",
    ),
    "growth of an angle not measured": (
        lambda: SensorSettings(measures="range", std_range_m=0.1, angle_growth_per_m=0.1),
        "angle_growth_per_m = 0.1: expected none",
    ),
    "in the plane": (
        lambda: Scenario(
            sensor=SensorSettings(measures="azimuth-elevation", std_bearing_rad=0.1, std_elevation_rad=0.1)
        ),
        "sensor.measures = 'azimuth-elevation': expected 'range-bearing', 'bearing', 'range' or none in the plane",
    ),
    "paper's first error": (lambda: Scenario(sensor=SensorSettings(**POLAR)), "expected 'consistent'"),
}


def test_own_coordinates_reach_the_problem_with_their_noise():
    growth = {"range_growth_per_m": 0.5, "angle_growth_per_m": 0.25}
    sensor = (
        Scenario(sensor=SensorSettings(**POLAR, **growth), scenes=SceneSettings(initial_error="consistent"))
        .problem()
        .sensor
    )
    assert sensor.polar == (("range", "bearing"), (0.5, 0.25))
    expected = np.diag([0.2 * 3, 0.01 * 2]) ** 2
    np.testing.assert_allclose(sensor.covariance(jnp.eye(2), jnp.array([0.0, 4.0])), expected, rtol=1e-12)


@pytest.mark.parametrize("name", BAD)
def test_wrong_settings_are_rejected(name):
    assert_rejected(*BAD[name])
