"""Settings made in Python: types, tags and plain numbers, for each class that a configuration may hold."""

import re
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest

import foveate
from foveate.io.settings import Settings
from foveate.io.toml import digest, dumps_toml


def settings_classes(cls: Any) -> set[Any]:
    """All dataclasses that a class holds, itself included, at any depth."""
    if not is_dataclass(cls):
        return set().union(*map(settings_classes, get_args(cls)), set())
    return {cls}.union(*(settings_classes(get_type_hints(cls)[field.name]) for field in fields(cls)))


CLASSES = sorted(settings_classes(foveate.Experiment) | {foveate.PlanSettings}, key=lambda cls: cls.__name__)


def test_all_classes_of_a_configuration_are_found():
    assert {foveate.Scenario, foveate.Quadrotor, foveate.PrismView, foveate.PPOSettings} <= set(CLASSES)
    assert len(CLASSES) >= 25


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_a_field_of_a_wrong_type_is_named_when_the_object_is_made(cls: Any):
    """Of every class and every field: an object that no field can hold."""
    assert issubclass(cls, Settings)
    for field in fields(cls):
        with pytest.raises(foveate.InputError) as caught:
            made(cls, **{**required(cls), field.name: object})
        assert str(caught.value).startswith(f"{cls.__name__}: {field.name} = "), caught.value
        assert "\n" not in str(caught.value)


def made(cls: Any, **values: Any) -> Any:
    """An object as its constructor makes it: the types that tests check there would be in the way."""
    settings = object.__new__(cls)
    for field in fields(cls):
        default = field.default if field.default_factory is MISSING else field.default_factory()
        object.__setattr__(settings, field.name, values.get(field.name, default))
    settings.__post_init__()
    return settings


def required(cls: Any) -> dict[str, Any]:
    """Values of the fields without a default."""
    return {
        foveate.FreeBody: {"axes": ("vx",), "lower": (0.0,), "upper": (1.0,)},
        foveate.PolygonView: {"vertices_m": ((0.0, 1.0), (0.0, 0.0), (1.0, 0.0))},
        foveate.BallView: {"radius_m": 1.0, "center_m": (0.0, 0.0)},
        foveate.PrismView: {"base": foveate.TriangleView()},
        foveate.RegionSettings: {"low_m": (0.0, 0.0), "high_m": (1.0, 1.0)},
        foveate.OccupancyObstacles: {"file": "map.yaml"},
        foveate.TeamSettings: {"agents": 2},
        foveate.BirthSettings: {"rate": 0.1},
        foveate.DetectionSettings: {"low_m": (0.0, 0.0), "high_m": (1.0, 1.0)},
        foveate.LinearTarget: dict.fromkeys("ABWZ", ((1.0,),)) | {"prior": ((1.0,),)},
    }.get(cls, {})


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: made(foveate.VelocityTarget, kind="cv"), "VelocityTarget: kind = 'cv': expected 'constant_velocity'"),
        (lambda: made(foveate.DifferentialDrive, kind="omni"), "kind = 'omni': expected 'differential_drive'"),
        (
            lambda: made(foveate.Scenario, view="sector"),
            "Scenario: view = 'sector': expected TriangleView or SectorView or ",
        ),
        (lambda: made(foveate.Scenario, view={"shape": "sector"}), "expected TriangleView or SectorView"),
        (lambda: made(foveate.Scenario, tau_s="1"), "Scenario: tau_s = '1': expected a finite number"),
        (lambda: made(foveate.Scenario, tau_s=float("nan")), "Scenario: tau_s = nan: expected a finite number"),
        (lambda: made(foveate.Scenario, agent=foveate.SectorView()), "expected DifferentialDrive or Quadrotor or "),
        (lambda: made(foveate.SceneSettings, targets_min=2.5), "targets_min = 2.5: expected a whole number"),
        (lambda: made(foveate.SceneSettings, shared_drift=1), "shared_drift = 1: expected true or false"),
        (lambda: made(foveate.Experiment, scenario="paper"), "Experiment: scenario = 'paper': expected Scenario"),
    ],
)
def test_wrong_settings_give_one_line(make: Any, complaint: str):
    with pytest.raises(foveate.InputError, match=re.escape(complaint)):
        make()


def test_a_class_of_a_kind_needs_no_kind():
    """Programs choose by class; the file still names the kind."""
    assert foveate.Quadrotor().kind == "quadrotor"
    assert foveate.VelocityTarget().kind == "constant_velocity"
    assert 'kind = "quadrotor"' in dumps_toml(foveate.Quadrotor())
    assert foveate.PointerSettings().kind == "pointer"


def test_lists_arrays_and_whole_numbers_become_what_the_fields_hold():
    plain = foveate.SceneSettings(half_side_m=(3.0, 4.0), jitter_m_s=1.0, targets_min=2)
    other = made(foveate.SceneSettings, half_side_m=np.array([3, 4]), jitter_m_s=np.float32(1), targets_min=np.int64(2))
    assert other == plain
    assert hash(other) == hash(plain)
    assert digest(other) == digest(plain)
    assert type(other.jitter_m_s) is float
    assert made(foveate.SceneSettings, half_side_m=[3, 4]).half_side_m == (3.0, 4.0)
