"""Local coordinates on a map, against distances that geodesy knows."""

import numpy as np
import pytest

from foveate.errors import InputError
from foveate.scenario.origin import OriginSettings


@pytest.mark.parametrize(
    ("latitude", "north_m", "east_m"),
    # Metres in a degree of latitude and of longitude on WGS 84, from the tables of the US National
    # Geospatial-Intelligence Agency.
    [(0.0, 110_574.3, 111_319.5), (45.0, 111_131.8, 78_846.8), (60.0, 111_412.3, 55_800.1)],
)
def test_a_degree_is_as_long_as_tables_of_the_ellipsoid_say(latitude, north_m, east_m):
    origin = OriginSettings(latitude_deg=latitude, longitude_deg=10.0)
    local = origin.local(np.array([[latitude + 0.001, 10.0], [latitude, 10.001]]))
    np.testing.assert_allclose(local, [[0.0, north_m / 1000], [east_m / 1000, 0.0]], rtol=1e-5, atol=1e-9)


def test_positions_return_to_the_map_and_cross_the_date_line():
    origin = OriginSettings(latitude_deg=-17.0, longitude_deg=179.99)
    there = np.array([[-17.1, 179.9, 30.0], [-16.9, -179.9, 0.0]])
    local = origin.local(there)
    assert 0 < local[1, 0] < 12_000
    back = origin.on_map(local)
    np.testing.assert_allclose(back, [there[0], [-16.9, 180.1, 0.0]], atol=1e-11)
    metres = OriginSettings(position_m=(5e5, 5e6))
    np.testing.assert_array_equal(metres.local(np.array([[5e5 + 1, 5e6 + 2]])), [[1, 2]])
    np.testing.assert_array_equal(metres.on_map(np.array([[1.0, 2.0]])), [[5e5 + 1, 5e6 + 2]])


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"latitude_deg": 1.0},
        {"position_m": (1.0,)},
        {"position_m": (1.0, 2.0), "latitude_deg": 1.0, "longitude_deg": 1.0},
        {"latitude_deg": 90.0, "longitude_deg": 0.0},
        {"latitude_deg": 0.0, "longitude_deg": 361.0},
    ],
)
def test_an_origin_is_in_metres_or_in_degrees(wrong):
    with pytest.raises(InputError, match="expected"):
        OriginSettings(**wrong)
