"""Settings of sensors: covariances of any scale reach the problem."""

import jax
import numpy as np
import pytest

from foveate.errors import InputError
from foveate.scenario.scenario import Scenario
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


@pytest.mark.parametrize("name", BAD)
def test_wrong_settings_are_rejected(name):
    make, words = BAD[name]
    with pytest.raises(InputError) as caught:
        make()
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
