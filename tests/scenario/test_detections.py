"""Settings of detections: what cannot be is rejected in one line; the model has the numbers of the settings."""

import jax.numpy as jnp
import numpy as np
import pytest

from foveate.errors import InputError
from foveate.scenario.agent import Quadrotor
from foveate.scenario.detections import BirthSettings, DetectionSettings
from foveate.scenario.field_of_view import PrismView, SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import SensorSettings

BOX = {"low_m": (-10.0, -10.0), "high_m": (10.0, 10.0)}
PLANE = Scenario(view=SectorView(depth_m=5.0, angle_deg=90.0)).problem()

BAD = {
    "p_D of 0": ({"probability": 0.0}, "probability = 0.0: expected a probability above 0, up to 1"),
    "p_D above 1": ({"probability": 1.5}, "probability = 1.5: expected a probability"),
    "p_S of 0": ({"survival": 0.0}, "survival = 0.0: expected a probability"),
    "negative clutter": ({"clutter": -1.0}, "clutter = -1.0: expected >= 0"),
    "negative range": ({"half_range_m": -1.0}, "half_range_m = -1.0: expected > 0"),
    "no cell": ({"cells": (0, 5)}, "cells = (0, 5): expected 2 numbers >= 1"),
    "too few tracks": ({"tracks": 4, "undetected": 9.0}, "tracks = 4: expected at least undetected 9"),
    "too few detections": ({"detections": 3, "clutter": 3.0}, "detections = 3: expected more than clutter 3"),
    "a crossed box": ({"high_m": (-10.0, 10.0)}, "high_m = (-10.0, 10.0): expected > low_m"),
    "births beyond": (
        {"births": (BirthSettings(rate=1.0, low_m=(5.0, 5.0), high_m=(15.0, 10.0)),)},
        "expected a box within",
    ),
    "a threshold": ({"confirm": 1.0}, "confirm = 1.0: expected between 0 and 1"),
    "recycled above it": ({"recycle": 0.6}, "recycle = 0.6: expected between 0 and confirm 0.5"),
}


@pytest.mark.parametrize("name", BAD)
def test_wrong_settings_are_rejected(name):
    changes, words = BAD[name]
    with pytest.raises(InputError) as caught:
        DetectionSettings(**{**BOX, **changes})
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_births_need_a_rate_that_is_no_loss():
    with pytest.raises(InputError, match=r"rate = -1\.0: expected >= 0"):
        BirthSettings(rate=-1.0)


def test_a_box_of_the_plane_does_not_fit_space():
    in_space = Scenario(
        agent=Quadrotor(),
        view=PrismView(base=SectorView()),
        scenes=SceneSettings(centre_m=(0.0,) * 3, half_side_m=(0.0,) * 3, drift_m_s=(0.0,) * 3),
    ).problem()
    with pytest.raises(InputError, match="expected 3 numbers, one per axis"):
        DetectionSettings(**BOX).model(in_space)
    deep = {"low_m": (-10.0,) * 3, "high_m": (10.0,) * 3, "cutoff_m": 4.0}
    assert DetectionSettings(**deep).model(in_space).births.shape == (12, 12, 12)
    with pytest.raises(InputError, match="a view with an end"):
        DetectionSettings(**deep, clutter=1.0).model(in_space)


def test_ranges_and_bearings_without_ids_are_refused():
    sensor = SensorSettings(measures="range-bearing", std_range_m=0.2, std_bearing_rad=0.01)
    problem = Scenario(sensor=sensor, scenes=SceneSettings(initial_error="consistent")).problem()
    with pytest.raises(InputError, match=r"sensor\.measures = 'range, bearing': expected none"):
        DetectionSettings(**BOX).model(problem)


def test_false_alarms_fill_the_view():
    model = DetectionSettings(**BOX, clutter=1.0).model(PLANE)
    assert float(model.view_volume) == pytest.approx(np.pi * 25 / 4, rel=0.01)
    points = np.asarray(model.clutter_points_body)
    range_m, angle = np.linalg.norm(points, axis=1), np.arctan2(points[:, 1], points[:, 0])
    assert range_m.max() <= 5.0
    assert np.mean(range_m**2) == pytest.approx(12.5, rel=0.02)  # uniform in a sector: half of the radius squared
    assert np.abs(angle).max() <= np.pi / 4
    assert np.abs(angle).mean() == pytest.approx(np.pi / 8, rel=0.02)


def test_the_intensities_are_the_expected_numbers():
    births = (BirthSettings(rate=0.3, low_m=(0.0, 0.0), high_m=(5.0, 10.0)), BirthSettings(rate=0.1))
    model = DetectionSettings(**BOX, cells=(4, 4), undetected=6.0, births=births).model(PLANE)
    assert float(model.first.sum()) == pytest.approx(6.0)
    expected = np.full((4, 4), 0.1 / 16)
    expected[2, 2:] += 0.15
    np.testing.assert_allclose(model.births, expected)
    falling = DetectionSettings(**BOX, probability=0.8, half_range_m=3.0).model(PLANE)
    np.testing.assert_allclose(falling.probability_at(jnp.array([0.0, 3.0, 6.0])), [0.8, 0.4, 0.05])
