"""Settings of the sensor, and of periodic values."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from foveate.io.validate import Matrix, at_least, covariance, matrix, positive, require


@dataclass(frozen=True, kw_only=True)
class SensorSettings:
    """Linear measurement z = H y + eta, eta ~ N(0, V), of a target inside the view.

    `std_m` is the standard deviation of a measured position [m]; `V` replaces it by a full covariance, `H` measures
    another part of the state. V is given in `frame`; the standard deviation grows with the range r [m] by the factor
    1 + `range_growth_per_m` r. With `missed_detections` "used" the Kalman filter also learns from targets that were not
    detected inside the view (models/missed_detection.py); without, from measurements alone.
    """

    RENAMED: ClassVar[dict[str, str]] = {"absence": "missed_detections"}
    std_m: float = 0.2
    V: Matrix | None = None
    H: Matrix | None = None
    frame: Literal["world", "body"] = "world"
    range_growth_per_m: float = 0.0
    missed_detections: Literal["used"] | None = None

    def __post_init__(self) -> None:
        positive(self, "std_m")
        at_least(0, self, "range_growth_per_m")
        if self.H is not None:
            matrix(self.H, "H", (None, None))
        if self.V is not None:
            covariance(self.V, "V", len(self.V), definite=True)


@dataclass(frozen=True, kw_only=True)
class ScheduleSettings:
    """Periodic values: step k takes entry k modulo the length of a list.

    `tau_s` is the length of each step [s], for which continuous-time motion (constant velocity, constant acceleration)
    is discretised; `W` and `V` are covariances in place of the targets' process noise and the sensor's noise. If a list
    is empty, the constant value applies.
    """

    tau_s: tuple[float, ...] = ()
    W: tuple[Matrix, ...] = ()
    V: tuple[Matrix, ...] = ()

    def __post_init__(self) -> None:
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
