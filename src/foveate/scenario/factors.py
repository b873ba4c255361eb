"""Factors of robustness: properties of a scenario that are varied one at a time."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from foveate.scenario.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class Factor:
    """A property of the scenario and its values; `trained` is the range (low, high) in training.

    With `same_scenes`, scenes of different values differ in nothing else, and can be compared in pairs.
    """

    name: str
    label: str
    values: tuple[float, ...]
    trained: tuple[float, float]
    change: Callable[[Scenario, float], Scenario]
    same_scenes: bool = True

    @property
    def nominal(self) -> float:
        """The first of the values within the range of training."""
        return next(value for value in self.values if self.trained[0] <= value <= self.trained[1])


def _set(part: str, *names: str, scale: float = 1.0) -> Callable[[Scenario, float], Scenario]:
    """Return a change that sets these fields of a part of the scenario to the value times `scale`."""

    def change(scenario: Scenario, value: float) -> Scenario:
        settings = getattr(scenario, part)
        fields: dict[str, Any] = {name: getattr(settings, name) for name in names}
        for name, old in fields.items():
            fields[name] = (value,) * len(old) if isinstance(old, tuple) else type(old)(scale * value)
        return replace(scenario, **{part: replace(settings, **fields)})

    return change


FACTORS = (
    Factor(name="W", label="process noise, std [m]", values=(0.0125, 0.025, 0.05, 0.1, 0.2), trained=(0.05, 0.05),
           change=_set("target", "process_std_m")),
    Factor(name="V", label="sensor noise, std [m]", values=(0.05, 0.1, 0.2, 0.4, 0.8), trained=(0.2, 0.2),
           change=_set("sensor", "std_m")),
    Factor(name="drift", label="drift up to [m/s]", values=(0.2, 0.4, 0.8, 1.6, 3.2), trained=(0.8, 0.8),
           change=_set("scenes", "drift_m_s")),
    Factor(name="targets", label="targets", values=(3.0, 5.0, 8.0, 12.0, 20.0), trained=(3.0, 8.0),
           change=_set("scenes", "targets_min", "targets_max"), same_scenes=False),
    Factor(name="depth", label="depth of the view [m]", values=(0.5, 1.0, 2.0, 4.0, 8.0), trained=(2.0, 2.0),
           change=_set("view", "depth_m")),
    Factor(name="angle", label="angle of the view [deg]", values=(30.0, 60.0, 90.0, 120.0, 150.0),
           trained=(120.0, 120.0), change=_set("view", "angle_deg")),
    Factor(name="speed", label="speed up to [m/s]", values=(1.0, 2.0, 4.0, 8.0, 16.0), trained=(4.0, 4.0),
           change=_set("agent", "v_max_m_s")),
    Factor(name="turn", label="turn rate up to [deg/s]", values=(15.0, 30.0, 60.0, 120.0, 240.0), trained=(60.0, 60.0),
           change=_set("agent", "w_max_rad_s", scale=np.pi / 180)),
)  # fmt: skip
"""Factors of the paper's scenario: a quarter to four times the value in training, within the factor's limits."""
