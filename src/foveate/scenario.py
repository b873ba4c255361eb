"""The world of an experiment as plain, checked settings: agent, view, sensor, targets, and how scenes are drawn.

`Scenario` is what the `[scenario]` table of a configuration file holds; `Scenario.problem()` turns it into arrays.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import jax.numpy as jnp
import numpy as np

from foveate.geometry import fov
from foveate.geometry.space import SPACES
from foveate.models.agent import Agent
from foveate.models.sensor import Sensor
from foveate.models.target import LinearGaussian
from foveate.problem import Problem

Matrix = tuple[tuple[float, ...], ...]


def _require(condition: bool, name: str, value: object, right: str) -> None:
    if not condition:
        raise ValueError(f"{name} = {value!r}: {right}")


def _matrix(value: Matrix, name: str, shape: tuple[int | None, int | None]) -> np.ndarray:
    rows = {len(row) for row in value}
    _require(len(rows) == 1 and 0 not in rows, name, value, "expected a matrix with rows of one length")
    matrix = np.array(value, float)
    fits = all(want is None or have == want for have, want in zip(matrix.shape, shape, strict=True))
    wanted = " x ".join("any" if size is None else str(size) for size in shape)
    _require(fits, name, value, f"expected shape {wanted}, got {matrix.shape[0]} x {matrix.shape[1]}")
    return matrix


def _covariance(value: Matrix, name: str, size: int, definite: bool) -> np.ndarray:
    matrix = _matrix(value, name, (size, size))
    scale = np.abs(matrix).max()
    _require(bool(np.abs(matrix - matrix.T).max() <= 1e-9 * scale), name, value, "a covariance is symmetric")
    smallest = np.linalg.eigvalsh(matrix).min()
    if definite:
        _require(bool(smallest > 1e-12 * scale), name, value, "expected positive definite (all eigenvalues > 0)")
    else:
        _require(bool(smallest >= -1e-12 * scale), name, value, "a covariance has no negative eigenvalue")
    return matrix


@dataclass(frozen=True, kw_only=True)
class DifferentialDrive:
    """A ground vehicle that drives ahead and turns. Speeds in [m/s], turn rate in [rad/s]."""

    kind: Literal["differential_drive"] = "differential_drive"
    v_min_m_s: float = 0.0
    v_max_m_s: float = 4.0
    w_max_rad_s: float = math.pi / 3

    def __post_init__(self) -> None:
        _require(
            self.v_min_m_s < self.v_max_m_s,
            "v_max_m_s",
            self.v_max_m_s,
            f"expected > v_min_m_s {self.v_min_m_s}",
        )
        _require(self.w_max_rad_s > 0, "w_max_rad_s", self.w_max_rad_s, "expected > 0")

    @property
    def dimension(self) -> int:
        """Dimension of space."""
        return 2

    def agent(self) -> Agent:
        """The body with its limits as arrays."""
        return Agent(
            space=SPACES["planar"],
            axes=(0, 2),
            lower=jnp.array([self.v_min_m_s, -self.w_max_rad_s]),
            upper=jnp.array([self.v_max_m_s, self.w_max_rad_s]),
        )


@dataclass(frozen=True, kw_only=True)
class TriangleView:
    """A triangle with its apex at the agent, opening ahead: depth [m] along the axis, full angle [deg]."""

    shape: Literal["triangle"] = "triangle"
    depth_m: float = 2.0
    angle_deg: float = 120.0

    def __post_init__(self) -> None:
        _require(self.depth_m > 0, "depth_m", self.depth_m, "expected > 0")
        _require(0 < self.angle_deg < 180, "angle_deg", self.angle_deg, "expected between 0 and 180")

    dimension = 2

    def view(self) -> fov.FieldOfView:
        """The shape."""
        return fov.triangle(self.depth_m, math.radians(self.angle_deg))


@dataclass(frozen=True, kw_only=True)
class SectorView:
    """A circular sector with its apex at the agent: radius [m], full angle [deg]."""

    shape: Literal["sector"] = "sector"
    depth_m: float = 10.0
    angle_deg: float = 90.0

    def __post_init__(self) -> None:
        _require(self.depth_m > 0, "depth_m", self.depth_m, "expected > 0")
        _require(0 < self.angle_deg <= 360, "angle_deg", self.angle_deg, "expected between 0 and 360")

    dimension = 2

    def view(self) -> fov.FieldOfView:
        """The shape."""
        return fov.sector(self.depth_m, math.radians(self.angle_deg))


@dataclass(frozen=True, kw_only=True)
class PolygonView:
    """Any convex polygon in the body frame [m]."""

    shape: Literal["polygon"]
    vertices_m: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        fov.polygon(self.vertices_m)

    dimension = 2

    @property
    def depth_m(self) -> float:
        """Largest distance from the agent to a point of the view [m]."""
        return max(math.hypot(*vertex) for vertex in self.vertices_m)

    def view(self) -> fov.FieldOfView:
        """The shape."""
        return fov.polygon(self.vertices_m)


@dataclass(frozen=True, kw_only=True)
class SensorSettings:
    """Linear measurement z = H y + eta inside the view.

    `std_m` is the noise of a position measurement [m]; `V` overrides it with a full covariance, `H` the measured
    part of the state. `frame` says in which frame V is given; its standard deviation grows with the range by
    the factor 1 + range_growth_per_m r.
    """

    std_m: float = 0.2
    V: Matrix | None = None
    H: Matrix | None = None
    frame: Literal["world", "body"] = "world"
    range_growth_per_m: float = 0.0

    def __post_init__(self) -> None:
        _require(self.std_m > 0, "std_m", self.std_m, "expected > 0")
        _require(self.range_growth_per_m >= 0, "range_growth_per_m", self.range_growth_per_m, "expected >= 0")
        if self.H is not None:
            _matrix(self.H, "H", (None, None))
        if self.V is not None:
            _covariance(self.V, "V", len(self.V), definite=True)


@dataclass(frozen=True, kw_only=True)
class DriftTarget:
    """Position only: y' = y + xi + w, the paper's target. `process_std_m` [m] per step; `W` overrides it in full."""

    kind: Literal["drift"] = "drift"
    process_std_m: float = 0.05
    W: Matrix | None = None
    initial_variance_m2: float = 2.0

    def __post_init__(self) -> None:
        _require(self.process_std_m >= 0, "process_std_m", self.process_std_m, "expected >= 0")
        _require(self.initial_variance_m2 > 0, "initial_variance_m2", self.initial_variance_m2, "expected > 0")
        if self.W is not None:
            _covariance(self.W, "W", len(self.W), definite=False)

    def motion(self, dimension: int, tau_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A, B, W, Z."""
        del tau_s
        eye = np.eye(dimension)
        W = self.process_std_m**2 * eye if self.W is None else _covariance(self.W, "W", dimension, definite=False)
        return eye, eye, W, eye

    def prior_covariance(self, dimension: int) -> np.ndarray:
        """Covariance of the first belief [m^2]."""
        return self.initial_variance_m2 * np.eye(dimension)


@dataclass(frozen=True, kw_only=True)
class LinearTarget:
    """Any linear-Gaussian target y' = A y + B xi + w, position Z y, covariance of the first belief `prior`."""

    kind: Literal["linear"]
    A: Matrix
    B: Matrix
    W: Matrix
    Z: Matrix
    prior: Matrix

    def __post_init__(self) -> None:
        size = len(self.A)
        A = _matrix(self.A, "A", (size, size))
        _matrix(self.B, "B", (size, None))
        W = _covariance(self.W, "W", size, definite=False)
        _covariance(self.prior, "prior", size, definite=True)
        smallest = np.linalg.svd(np.hstack([A, W]), compute_uv=False).min()
        singular = smallest <= 1e-12 * max(np.abs(A).max(), np.abs(W).max())
        right = "the predicted covariance A P A^T + W is singular: W must add noise wherever A loses rank"
        _require(not singular, "A, W", (self.A, self.W), right)

    def motion(self, dimension: int, tau_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A, B, W, Z."""
        del tau_s
        Z = _matrix(self.Z, "Z", (dimension, len(self.A)))
        _require(int(np.linalg.matrix_rank(Z)) == dimension, "Z", self.Z, f"expected rank {dimension}")
        return np.array(self.A), np.array(self.B), np.array(self.W), Z

    def prior_covariance(self, dimension: int) -> np.ndarray:
        """Covariance of the first belief."""
        del dimension
        return np.array(self.prior)


@dataclass(frozen=True, kw_only=True)
class SceneSettings:
    """The distribution that training scenes are drawn from, and what an episode of it is.

    Targets: n uniform on targets_min .. targets_max, positions uniform in a box about `centre_m` whose half side is
    `half_side_m` + n `half_side_per_target_m`. Agent: uniform in `agent_spread` times that box in training, within
    `agent_test_half_side_m` of the centre in test scenes, any heading. Drift: uniform in
    [-drift_m_s, drift_m_s] of each axis, one for all targets of a scene (`shared_drift`) or each its own, plus
    [-jitter_m_s, jitter_m_s] anew at each step; `known_drift` says whether the agent is told (the paper: yes), and
    `process_noise` whether the targets are pushed by N(0, W) as well. With `turnover`, in training, a target that
    leaves the box is replaced by a new one that enters at the other side.
    Horizon: `steps`, or `steps_per_target` n. First mean: truth + N(0, V) ("paper": claims more than it errs) or
    drawn from the first belief ("consistent").
    """

    targets_min: int = 3
    targets_max: int = 8
    centre_m: tuple[float, ...] = (0.0, 0.0)
    half_side_m: tuple[float, ...] = (0.0, 0.0)
    half_side_per_target_m: float = 2.0
    agent_spread: float = 1.25
    agent_test_half_side_m: float = 2.0
    drift_m_s: tuple[float, ...] = (0.8, 0.8)
    shared_drift: bool = True
    known_drift: bool = True
    process_noise: bool = True
    turnover: bool = False
    jitter_m_s: float = 0.5
    steps_per_target: int = 3
    steps: int | None = None
    initial_error: Literal["paper", "consistent"] = "paper"

    def __post_init__(self) -> None:
        _require(self.targets_min >= 1, "targets_min", self.targets_min, "expected >= 1")
        right = f"expected >= targets_min {self.targets_min}"
        _require(self.targets_max >= self.targets_min, "targets_max", self.targets_max, right)
        for name in (
            "half_side_per_target_m",
            "agent_spread",
            "agent_test_half_side_m",
            "jitter_m_s",
        ):
            _require(getattr(self, name) >= 0, name, getattr(self, name), "expected >= 0")
        _require(min(self.half_side_m, default=-1) >= 0, "half_side_m", self.half_side_m, "expected >= 0 per axis")
        _require(min(self.drift_m_s, default=-1) >= 0, "drift_m_s", self.drift_m_s, "expected >= 0 per axis")
        right = "expected one number per axis, as many as half_side_m"
        for name in ("centre_m", "drift_m_s"):
            _require(len(getattr(self, name)) == len(self.half_side_m), name, getattr(self, name), right)
        smallest = min(self.half_side_m) + self.half_side_per_target_m
        _require(not self.turnover or smallest > 0, "half_side_m", self.half_side_m, "expected > 0 with turnover")
        _require(self.steps_per_target >= 1, "steps_per_target", self.steps_per_target, "expected >= 1")
        _require(self.steps is None or self.steps >= 1, "steps", self.steps, "expected >= 1")

    def horizon(self, targets: int) -> int:
        """Steps of an episode with that many targets."""
        return self.steps if self.steps is not None else self.steps_per_target * max(1, targets)


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """One world: what moves, who looks, how well, and how often (`tau_s` [s] between decisions)."""

    tau_s: float = 1.0
    agent: DifferentialDrive = field(default_factory=DifferentialDrive)
    view: TriangleView | SectorView | PolygonView = field(default_factory=TriangleView)
    sensor: SensorSettings = field(default_factory=SensorSettings)
    target: DriftTarget | LinearTarget = field(default_factory=DriftTarget)
    scenes: SceneSettings = field(default_factory=SceneSettings)

    def __post_init__(self) -> None:
        _require(self.tau_s > 0, "tau_s", self.tau_s, "expected > 0")
        d = self.agent.dimension
        right = f"expected a shape in {d} dimensions, as the agent's"
        _require(self.view.dimension == d, "view.shape", self.view.shape, right)
        _require(len(self.scenes.centre_m) == d, "scenes.centre_m", self.scenes.centre_m, f"expected {d} numbers")
        A, _, _, Z = self.target.motion(d, self.tau_s)
        H = self._observation(Z)
        if H.shape[1] != len(A):
            raise ValueError(f"sensor.H has {H.shape[1]} columns: expected {len(A)}, the length of a target's state")
        size = 1 if self.sensor.V is None else len(self.sensor.V)
        if self.sensor.V is not None and size != H.shape[0]:
            raise ValueError(
                f"sensor.V is {size} x {size}: expected {H.shape[0]} x {H.shape[0]}, one row per measurement"
            )
        if len(H) > len(A):
            raise ValueError(f"sensor.H has {len(H)} rows: expected at most {len(A)}, the length of a target's state")
        if any(self.scenes.drift_m_s) and not self.problem().motion.takes_drift:
            right = (
                "expected 0: these targets have no place for it (Z = [I 0] and a velocity, or an input for each axis)"
            )
            raise ValueError(f"scenes.drift_m_s = {self.scenes.drift_m_s!r}: {right}")
        if self.sensor.frame == "body" and H.shape[0] != d:
            raise ValueError(f"sensor.frame = 'body' needs measured positions: H has {H.shape[0]} rows, expected {d}")

    def _observation(self, Z: np.ndarray) -> np.ndarray:
        return Z if self.sensor.H is None else _matrix(self.sensor.H, "sensor.H", (None, None))

    @property
    def dimension(self) -> int:
        """Dimension of space."""
        return self.agent.dimension

    def problem(self) -> Problem:
        """The arrays that simulation works on."""
        d = self.dimension
        A, B, W, Z = self.target.motion(d, self.tau_s)
        H = self._observation(Z)
        V = self.sensor.std_m**2 * np.eye(len(H)) if self.sensor.V is None else np.array(self.sensor.V)
        sensor = Sensor(
            H=_array(H),
            V=_array(V),
            view=self.view.view(),
            range_growth=self.sensor.range_growth_per_m,
            frame=self.sensor.frame,
        )
        return Problem(
            agent=self.agent.agent(),
            sensor=sensor,
            motion=LinearGaussian(A=_array(A), B=_array(B), W=_array(W), Z=_array(Z)),
            tau=_array(self.tau_s),
            prior_information=_array(np.linalg.inv(self.target.prior_covariance(d))),
        )


def _array(value: float | np.ndarray | Sequence) -> jnp.ndarray:
    return jnp.asarray(value, float)
