"""Detections of a scenario: expected numbers by closed forms, and what cannot be in one line."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import poisson

from foveate.errors import InputError
from foveate.io.toml import dumps_toml, load_toml
from foveate.scenario.detections import BirthSettings, DetectionSettings
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.population import RAREST, expected_others, most_of
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.target import VelocityTarget

BOX = {"low_m": (-10.0, -10.0), "high_m": (10.0, 10.0)}
SCENES = SceneSettings(
    targets_min=2, targets_max=4, half_side_m=(8.0, 8.0), half_side_per_target_m=0.0, drift_m_s=(0.5, 0.5), steps=20
)
WORLD = Scenario(
    view=SectorView(depth_m=5.0, angle_deg=90.0),
    target=VelocityTarget(),
    scenes=SCENES,
    detections=DetectionSettings(**BOX),
)


def with_detections(scenes: SceneSettings = SCENES, **changes) -> Scenario:
    return replace(WORLD, scenes=scenes, detections=DetectionSettings(**{**BOX, **changes}))


def test_a_table_of_a_file_is_the_scenario(tmp_path):
    births = (BirthSettings(rate=0.1, first=1, low_m=(0.0, 0.0), high_m=(2.0, 2.0)), BirthSettings(rate=0.01))
    scenario = with_detections(births=births, known=False, clutter=1.0, half_range_m=3.0)
    (tmp_path / "world.toml").write_text(dumps_toml(scenario), encoding="utf-8")
    assert load_toml(Scenario, tmp_path / "world.toml") == scenario


def test_without_the_table_there_are_no_detections():
    assert replace(WORLD, detections=None).problem().detections is None


def test_unknown_targets_are_expected_where_scenes_have_them():
    """3 in the mean of 2, 3, 4, uniform in the scenes' box; as tracks, none."""
    cells = np.asarray(with_detections(known=False, cells=(20, 20)).problem().detections.first)
    np.testing.assert_allclose(cells[2:-2, 2:-2], 3.0 / 16**2, rtol=1e-5)
    np.testing.assert_allclose(cells.sum(), 3.0, rtol=1e-5)
    assert with_detections().problem().detections.first.sum() == 0


def test_expected_numbers_follow_their_recursion():
    settings = DetectionSettings(
        **BOX, survival=0.9, undetected=1.5, births=(BirthSettings(rate=0.2, first=2), BirthSettings(rate=0.1))
    )
    numbers = [3.5]
    for _ in range(12):
        numbers.append(0.9 * numbers[-1] + 0.3)
    assert expected_others(settings, 12) == pytest.approx(max(numbers))
    grows = replace(settings, survival=1.0)
    assert expected_others(grows, 12) == pytest.approx(3.5 + 12 * 0.3)


@pytest.mark.parametrize("mean", [0.0, 0.05, 0.3, 2.0, 30.0])
def test_room_is_enough_but_once_in_a_billion(mean):
    most = most_of(mean)
    assert poisson.sf(most, mean) <= RAREST
    assert most == 0 or poisson.sf(most - 1, mean) > RAREST


def test_gospa_is_at_half_the_depth_unless_it_is_told():
    assert float(WORLD.problem().detections.cutoff) == 2.5
    assert float(with_detections(cutoff_m=0.7).problem().detections.cutoff) == pytest.approx(0.7)


BAD = {
    "inputs of no id": (
        lambda: replace(WORLD, target=type(Scenario().target)()),
        "scenes.known_drift = True: expected false",
    ),
    "two kinds of births": (
        lambda: with_detections(replace(SCENES, birth_and_death=True)),
        "scenes.birth_and_death = True: expected false",
    ),
    "few tracks": (
        lambda: with_detections(tracks=3),
        "detections.tracks = 3: expected at least 4, the expected number",
    ),
    "scenes beyond the box": (
        lambda: with_detections(replace(SCENES, half_side_m=(11.0, 8.0)), known=False),
        "scenes.half_side_m = [11.0, 8.0]: expected a box within",
    ),
    "scenes of no area": (
        lambda: with_detections(replace(SCENES, half_side_m=(0.0, 8.0)), known=False),
        "scenes.half_side_m = (0.0, 8.0): expected > 0",
    ),
    "a ring": (
        lambda: with_detections(replace(SCENES, target_ring_m=(1.0, 2.0)), known=False),
        "scenes.target_ring_m = (1.0, 2.0): expected none",
    ),
    "certain death": (lambda: with_detections(survival=0.0), "survival = 0.0: expected a probability above 0"),
    "all told": (lambda: with_detections(tell=1.0), "tell = 1.0: expected a probability below 1"),
    "no distance": (lambda: with_detections(cutoff_m=0.0), "cutoff_m = 0.0: expected > 0"),
    "fewer than none": (lambda: BirthSettings(rate=0.1, first=-1), "first = -1: expected >= 0"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_is_one_line(name):
    make, words = BAD[name]
    with pytest.raises(InputError) as caught:
        make()
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
