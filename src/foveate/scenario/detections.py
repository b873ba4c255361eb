"""Settings of detections without identities: an unknown number of targets, missed detections, false alarms, births."""

import math
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from foveate.geometry.fov import FieldOfView
from foveate.io.settings import Settings
from foveate.io.validate import at_least, require
from foveate.models.detections.grid import Grid
from foveate.models.detections.records import DetectionModel
from foveate.models.gate import gate_limit
from foveate.models.problem import Problem
from foveate.names import GATE

CLUTTER_POINTS = 4096
"""Places in the view from which false alarms are drawn."""
SAMPLES = 2**18
"""Points of a box about the view by which its volume is measured."""
MAX_SLOTS, MAX_CELLS = 1000, 1_000_000


@dataclass(frozen=True, kw_only=True)
class BirthSettings(Settings):
    """Targets that appear: Poisson, `rate` a step in the mean, uniform in the box from `low_m` to `high_m`.

    Without a box they appear anywhere in that of the detections. `first` of them are there before the first step.
    """

    rate: float
    first: int = 0
    low_m: tuple[float, ...] | None = None
    high_m: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(0, self, "rate", "first")
        low, high = self.low_m, self.high_m
        require((low is None) == (high is None), "high_m", high, "expected both corners of the box, or none")
        if low is not None and high is not None:
            _check_box(low, high)


@dataclass(frozen=True, kw_only=True)
class DetectionSettings(Settings):
    """Detections that do not say of which target they are, of targets unknown in number; without the table they do.

    The filter is a Poisson multi-Bernoulli one: tracks with a probability of existence, and a grid of the intensity of
    targets that were never detected, on the box from `low_m` to `high_m`. Targets beyond the box count in the cells at
    its border; where there are false alarms, what is detected beyond the box begins no track.
    """

    low_m: tuple[float, ...]
    high_m: tuple[float, ...]
    cells: tuple[int, ...] | None = None
    """Number of cells along each axis. Left out: 32, and 12 in space."""
    probability: float = 0.9
    """Probability that a target in the view is detected, at range 0."""
    half_range_m: float | None = None
    """Range at which a target is detected half as often as at range 0: the factor is 2^-(r / half_range_m)^2. Left out:
    the same probability at any range."""
    clutter: float = 0.0
    """Expected number of false alarms a scan, uniform in the view."""
    survival: float = 1.0
    """Probability that a target survives a step."""
    undetected: float = 0.0
    """Expected number of targets in the box, uniform, before the first step, beside those with a first belief."""
    births: tuple[BirthSettings, ...] = ()
    tracks: int = 24
    """Most tracks at a time; beyond, those least likely to exist are dropped, and counted."""
    detections: int = 16
    """Most detections a scan."""
    confirm: float = 0.5
    """A track is reported while r (1 - E min(d^2, c^2) / c^2) is above this, where r is its probability of existence, d
    the error of its position and c `cutoff_m`. The expected GOSPA is least at 0.5."""
    recycle: float = 0.01
    """Probability of existence at which a track returns to the intensity of undetected targets."""
    gate: float = GATE
    """Probability that the gate of a track holds its own detection."""
    tell: float = 0.1
    """Probability of existence above which a policy is told of a track."""
    known: bool = True
    """Every target of a scene begins as a track with a first belief; or else the filter expects as many targets as
    scenes have in the mean, anywhere in their box."""
    cutoff_m: float | None = None
    """Distance c of GOSPA: a target without an estimate nearer than this is missed. Left out: half the view's depth."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_box(self.low_m, self.high_m)
        d = len(self.low_m)
        for name in ("probability", "survival"):
            value = getattr(self, name)
            require(0 < value <= 1, name, value, "expected a probability above 0, up to 1")
        require(self.half_range_m is None or self.half_range_m > 0, "half_range_m", self.half_range_m, "expected > 0")
        at_least(0, self, "clutter", "undetected")
        for name in ("tracks", "detections"):
            value = getattr(self, name)
            require(1 <= value <= MAX_SLOTS, name, value, f"expected 1 to {MAX_SLOTS}")
        require(0 <= self.tell < 1, "tell", self.tell, "expected a probability below 1")
        require(self.cutoff_m is None or self.cutoff_m > 0, "cutoff_m", self.cutoff_m, "expected > 0")
        require(0 < self.confirm < 1, "confirm", self.confirm, "expected between 0 and 1")
        require(
            0 < self.recycle < self.confirm, "recycle", self.recycle, f"expected between 0 and confirm {self.confirm}"
        )
        gate_limit(self.gate, d)
        cells = self.shape
        fits = len(cells) == d and min(cells) >= 1 and math.prod(cells) <= MAX_CELLS
        require(fits, "cells", cells, f"expected {d} numbers >= 1, one per axis, at most {MAX_CELLS} cells")
        self._check_capacities()
        for birth in self.births:
            self._check_birth(birth)

    def _check_capacities(self) -> None:
        right = f"expected at least undetected {self.undetected:g}, the expected number of targets"
        require(self.tracks >= self.undetected, "tracks", self.tracks, right)
        right = f"expected more than clutter {self.clutter:g}, the expected number of false alarms"
        require(self.detections > self.clutter, "detections", self.detections, right)

    def _check_birth(self, birth: BirthSettings) -> None:
        if birth.low_m is None or birth.high_m is None:
            return
        require(len(birth.low_m) == len(self.low_m), "births.low_m", birth.low_m, "expected as many numbers as low_m")
        within = zip(birth.low_m, birth.high_m, self.low_m, self.high_m, strict=True)
        inside = all(low >= box_low and high <= box_high for low, high, box_low, box_high in within)
        box = [birth.low_m, birth.high_m]
        require(inside, "births.low_m, high_m", box, f"expected a box within {self.low_m} .. {self.high_m}, the grid's")

    def _cutoff_m(self, view: FieldOfView) -> float:
        depth_m = float(view.depth)
        right = "is missing; expected a number, as the view has no end"
        require(self.cutoff_m is not None or math.isfinite(depth_m), "detections.cutoff_m", None, right)
        return 0.5 * depth_m if self.cutoff_m is None else self.cutoff_m

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of cells along each axis."""
        return self.cells or (12 if len(self.low_m) == 3 else 32,) * len(self.low_m)

    def model(self, problem: Problem) -> DetectionModel:
        """The settings as arrays, for a problem.

        Raises InputError for a box of another dimension, for clutter in a view without bounds, and for a sensor that
        does not measure positions.
        """
        view, d = problem.sensor.view, problem.agent.space.dimension
        right = "expected none: detections without ids are positions; convert them by the robot's pose"
        measured = None if problem.sensor.polar is None else ", ".join(problem.sensor.polar.coordinates)
        require(measured is None, "sensor.measures", measured, right)
        require(len(self.low_m) == d, "detections.low_m", self.low_m, f"expected {d} numbers, one per axis")
        grid = Grid(jnp.asarray(self.low_m, float), jnp.asarray(self.high_m, float), self.shape)
        volume, points = (1.0, np.zeros((1, d))) if self.clutter == 0 else _filled(view)
        births, first = jnp.zeros(self.shape), self.undetected * grid.overlap(grid.low, grid.high)
        for birth in self.births:
            share = grid.overlap(*(jnp.asarray(corner, float) for corner in self.box(birth)))
            births, first = births + birth.rate * share, first + birth.first * share
        return DetectionModel(
            probability=jnp.asarray(self.probability, float),
            half_range_m=None if self.half_range_m is None else jnp.asarray(self.half_range_m, float),
            clutter=jnp.asarray(self.clutter, float),
            view_volume=jnp.asarray(volume, float),
            survival=jnp.asarray(self.survival, float),
            grid=grid,
            births=births,
            first=first,
            clutter_points_body=jnp.asarray(points, float),
            cutoff=jnp.asarray(self._cutoff_m(view), float),
            gate=gate_limit(self.gate, len(problem.sensor.H)),
            recycle=self.recycle,
            confirm=self.confirm,
            tracks=self.tracks,
            detections=self.detections,
            tell=self.tell,
            known=self.known,
        )

    def box(self, birth: BirthSettings) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Both corners of the box of births [m]."""
        if birth.low_m is None or birth.high_m is None:
            return self.low_m, self.high_m
        return birth.low_m, birth.high_m


def _check_box(low: tuple[float, ...], high: tuple[float, ...]) -> None:
    require(len(low) in (2, 3), "low_m", low, "expected 2 or 3 numbers, one per axis")
    require(len(low) == len(high), "high_m", high, f"expected {len(low)} numbers, as low_m has")
    below = all(a < b for a, b in zip(low, high, strict=True))
    require(below, "high_m", high, f"expected > low_m {low} on every axis")


def _filled(view: FieldOfView) -> tuple[float, Float[np.ndarray, "points d"]]:
    """Volume of the view [m^d], and points that fill it evenly [m]."""
    depth, d = float(view.depth), view.dimension
    require(math.isfinite(depth), "clutter", "> 0", "expected 0, or a view with an end: false alarms are uniform in it")
    ratio = max(np.roots([1.0, *[0.0] * (d - 1), -1.0, -1.0]).real)
    steps = ratio ** -np.arange(1.0, d + 1)
    cube = depth * (2.0 * ((0.5 + np.arange(1, SAMPLES + 1)[:, None] * steps) % 1.0) - 1.0)
    inside = np.asarray(view.contains(jnp.asarray(cube, float)))
    require(inside.any(), "clutter", "> 0", "expected 0: the view is too thin for false alarms that fill it")
    return (2.0 * depth) ** d * inside.mean(), cube[inside][:CLUTTER_POINTS]
