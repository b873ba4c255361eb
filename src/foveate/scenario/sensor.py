"""Settings of the sensor, and of periodic values."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from foveate.errors import InputError
from foveate.io.settings import Settings
from foveate.io.validate import Matrix, at_least, covariance, matrix, positive, require
from foveate.models.polar import Coordinate, Polar

Measures = Literal["range-bearing", "bearing", "range", "azimuth-elevation-range", "azimuth-elevation"]
_COORDINATES: dict[Measures, tuple[Coordinate, ...]] = {
    "range-bearing": ("range", "bearing"),
    "bearing": ("bearing",),
    "range": ("range",),
    "azimuth-elevation-range": ("bearing", "elevation", "range"),
    "azimuth-elevation": ("bearing", "elevation"),
}
_STD: dict[Coordinate, str] = {
    "range": "std_range_m",
    "bearing": "std_bearing_rad",
    "elevation": "std_elevation_rad",
}
_DIMENSIONS: dict[Measures, tuple[int, ...]] = {
    "range-bearing": (2,),
    "bearing": (2,),
    "range": (2, 3),
    "azimuth-elevation-range": (3,),
    "azimuth-elevation": (3,),
}


@dataclass(frozen=True, kw_only=True)
class SensorSettings(Settings):
    """Linear measurement z = H y + eta, eta ~ N(0, V), of a target inside the view.

    `std_m` is the standard deviation of a measured position [m]; `V` replaces it by a full covariance, `H` measures
    another part of the state. V is given in `frame`; the standard deviation grows with the range r [m] by the factor
    1 + `range_growth_per_m` r. With `missed_detections` "used" the Kalman filter also learns from targets that were not
    detected inside the view (models/missed_detection.py); without, from measurements alone.

    With `measures` the sensor measures range, bearing or both in its own frame (azimuth and elevation in space) with
    the standard deviations `std_range_m`, `std_bearing_rad` (also of an azimuth) and `std_elevation_rad`, in place of a
    position; only that of the range grows by `range_growth_per_m`, those of angles by `angle_growth_per_m`. See
    docs/sensors.md.
    """

    RENAMED: ClassVar[dict[str, str]] = {"absence": "missed_detections"}
    std_m: float = 0.2
    V: Matrix | None = None
    H: Matrix | None = None
    frame: Literal["world", "body"] = "world"
    range_growth_per_m: float = 0.0
    missed_detections: Literal["used"] | None = None
    measures: Measures | None = None
    std_range_m: float | None = None
    std_bearing_rad: float | None = None
    std_elevation_rad: float | None = None
    angle_growth_per_m: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        positive(self, "std_m")
        at_least(0, self, "range_growth_per_m")
        if self.H is not None:
            matrix(self.H, "H", (None, None))
        if self.V is not None:
            covariance(self.V, "V", len(self.V), definite=True)
        self._check_coordinates()
        if self.measures is not None:
            self._check_alone()

    def _check_coordinates(self) -> None:
        """Raise InputError unless there is a standard deviation for each measured coordinate, and for no other."""
        for coordinate, name in _STD.items():
            value, kinds = getattr(self, name), [kind for kind, parts in _COORDINATES.items() if coordinate in parts]
            if coordinate not in self.coordinates:
                right = f"goes with measures = {' or '.join(map(repr, kinds))}, which is {self.measures or 'not set'}"
                require(value is None, name, value, right)
            elif value is None:
                raise InputError(f"{name}: is missing, with measures = {self.measures!r}: expected a number > 0")
            else:
                right = "expected > 0" if coordinate == "range" else "expected > 0, at most 1 rad"
                require(0 < value <= (np.inf if coordinate == "range" else 1.0), name, value, right)
        angle = self.angle_growth_per_m
        right = f"expected none with measures = {self.measures or 'not set'}, which has no angle"
        require(angle is None or bool(set(self.coordinates) - {"range"}), "angle_growth_per_m", angle, right)
        require(angle is None or angle >= 0, "angle_growth_per_m", angle, "expected >= 0")

    def _check_alone(self) -> None:
        """Raise InputError for what belongs to a measured position."""
        own = " and ".join(_STD[each] for each in self.coordinates)
        right = f"goes with a measured position; with measures = {self.measures!r} give {own}"
        default = {"std_m": type(self).std_m, "V": None, "H": None, "frame": "world"}
        for name, value in default.items():
            require(getattr(self, name) == value, name, getattr(self, name), right)
        growth = self.range_growth_per_m
        right = f"expected 0 with measures = {self.measures!r}, which has no range"
        require(growth == 0 or "range" in self.coordinates, "range_growth_per_m", growth, right)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Measured coordinates in order; none where a position is measured."""
        return () if self.measures is None else _COORDINATES[self.measures]

    @property
    def polar(self) -> Polar | None:
        """The measured coordinates with their growths; None where a position is measured."""
        growths = {"range": self.range_growth_per_m}
        growth = tuple(growths.get(each, self.angle_growth_per_m or 0.0) for each in self.coordinates)
        return None if self.measures is None else Polar(self.coordinates, growth)

    def noise(self, rows: int) -> np.ndarray:
        """V of `rows` measured numbers, at a range of 0."""
        if self.measures is not None:
            return np.diag([getattr(self, _STD[each]) ** 2 for each in self.coordinates])
        return self.std_m**2 * np.eye(rows) if self.V is None else np.array(self.V)

    def require_dimension(self, d: int) -> None:
        """Raise InputError unless what it measures exists in d dimensions."""
        fitting = [kind for kind, dimensions in _DIMENSIONS.items() if d in dimensions]
        right = f"expected {', '.join(map(repr, fitting))} or none in {'the plane' if d == 2 else 'space'}"
        require(self.measures is None or self.measures in fitting, "sensor.measures", self.measures, right)


@dataclass(frozen=True, kw_only=True)
class ScheduleSettings(Settings):
    """Periodic values: step k takes entry k modulo the length of a list.

    `tau_s` is the length of each step [s], for which continuous-time motion (constant velocity, constant acceleration)
    is discretised; `W` and `V` are covariances in place of the targets' process noise and the sensor's noise. If a list
    is empty, the constant value applies.
    """

    tau_s: tuple[float, ...] = ()
    W: tuple[Matrix, ...] = ()
    V: tuple[Matrix, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        require(min(self.tau_s, default=1.0) > 0, "tau_s", self.tau_s, "expected lengths of steps, each > 0")
        for W in self.W:
            covariance(W, "W", len(W), definite=False)
        for V in self.V:
            covariance(V, "V", len(V), definite=True)
        lengths = sorted({len(part) for part in (self.tau_s, self.W, self.V) if part})
        require(len(lengths) <= 1, "tau_s, W, V", lengths, "expected lists of one length")

    @property
    def length(self) -> int:
        """Period in steps; 0 if nothing changes."""
        return max(len(self.tau_s), len(self.W), len(self.V))
