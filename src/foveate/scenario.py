"""The world of an experiment as plain, checked settings: agent, view, sensor, targets, and how scenes are drawn.

`Scenario` is what the `[scenario]` table of a configuration file holds; `Scenario.problem()` turns it into arrays.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from foveate.agent_settings import AgentSettings, DifferentialDrive
from foveate.checks import Matrix, covariance, matrix, not_negative, positive, representable, require
from foveate.models.sensor import Sensor
from foveate.models.target import LinearGaussian
from foveate.problem import Problem, Schedule
from foveate.target_settings import DriftTarget, TargetSettings, require_predictable
from foveate.view_settings import TriangleView, ViewSettings


@dataclass(frozen=True, kw_only=True)
class SensorSettings:
    """Linear measurement z = H y + eta inside the view.

    `std_m` is the noise of a position measurement [m]; `V` overrides it with a full covariance, `H` the measured
    part of the state. `frame` says in which frame V is given; its standard deviation grows with the range by
    the factor 1 + range_growth_per_m r. With `absence = "used"` the Kalman filter that really runs also learns from not
    seeing a target where it looked; left out, only from measurements.
    """

    std_m: float = 0.2
    V: Matrix | None = None
    H: Matrix | None = None
    frame: Literal["world", "body"] = "world"
    range_growth_per_m: float = 0.0
    """0 where noise does not depend on the range."""
    absence: Literal["used"] | None = None
    """What the filter makes of not seeing a target; see models/absence.py."""

    def __post_init__(self) -> None:
        positive(self, "std_m")
        not_negative(self, "range_growth_per_m")
        if self.H is not None:
            matrix(self.H, "H", (None, None))
        if self.V is not None:
            covariance(self.V, "V", len(self.V), definite=True)


@dataclass(frozen=True, kw_only=True)
class ScheduleSettings:
    """What changes from step to step, over and over: step k takes entry k modulo the length of a list.

    `tau_s`: the length of each step [s], for which motion that knows time (constant velocity, constant acceleration)
    is discretised anew. `W`, `V`: covariances in place of the targets' process noise and the sensor's noise.
    What is left empty stays as it is elsewhere in the scenario.
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
        """Steps after which it begins again; 0 where nothing changes."""
        return max(len(self.tau_s), len(self.W), len(self.V))


@dataclass(frozen=True, kw_only=True)
class SceneSettings:
    """The distribution that training scenes are drawn from, and what an episode of it is.

    Targets: n uniform on targets_min .. targets_max, positions uniform in a box about `centre_m` whose half side is
    `half_side_m` + n `half_side_per_target_m`. Agent: uniform in `agent_spread` times that box in training, within
    `agent_test_half_side_m` of the centre in test scenes, any heading. Drift: uniform in
    [-drift_m_s, drift_m_s] of each axis, one for all targets of a scene (`shared_drift`) or each its own, plus
    [-jitter_m_s, jitter_m_s] anew at each step, where targets are positions that an input drives (other kinds have no
    jitter: the drift is their first velocity); `known_drift` says whether the agent is told (the paper: yes), and
    `process_noise` whether the targets are pushed by N(0, W) as well. With `turnover`, in training, a target that
    leaves the box is replaced by a new one that enters at the other side.
    Horizon: `steps`, or `steps_per_target` n. First mean: truth + N(0, V), V of the first step at no range ("paper":
    claims more than it errs), or drawn from the first belief ("consistent").
    """

    targets_min: int = 3
    """Fewest targets of a scene."""
    targets_max: int = 8
    """Most targets of a scene in training; a policy takes any number."""
    centre_m: tuple[float, ...] = (0.0, 0.0)
    half_side_m: tuple[float, ...] = (0.0, 0.0)
    half_side_per_target_m: float = 2.0
    agent_spread: float = 1.25
    agent_test_half_side_m: float = 2.0
    drift_m_s: tuple[float, ...] = (0.8, 0.8)
    """Largest drift on each axis."""
    shared_drift: bool = True
    known_drift: bool = True
    process_noise: bool = True
    turnover: bool = False
    jitter_m_s: float = 0.5
    """Largest change of the drift at a step, on each axis."""
    steps_per_target: int = 3
    steps: int | None = None
    initial_error: Literal["paper", "consistent"] = "paper"
    """How far first means are from the truth."""

    def __post_init__(self) -> None:
        require(self.targets_min >= 1, "targets_min", self.targets_min, "expected >= 1")
        right = f"expected >= targets_min {self.targets_min}"
        require(self.targets_max >= self.targets_min, "targets_max", self.targets_max, right)
        not_negative(self, "half_side_per_target_m", "agent_spread", "agent_test_half_side_m", "jitter_m_s")
        require(min(self.half_side_m, default=-1) >= 0, "half_side_m", self.half_side_m, "expected >= 0 per axis")
        require(min(self.drift_m_s, default=-1) >= 0, "drift_m_s", self.drift_m_s, "expected >= 0 per axis")
        right = "expected one number per axis, as many as half_side_m"
        for name in ("centre_m", "drift_m_s"):
            require(len(getattr(self, name)) == len(self.half_side_m), name, getattr(self, name), right)
        smallest = min(self.half_side_m) + self.half_side_per_target_m
        require(not self.turnover or smallest > 0, "half_side_m", self.half_side_m, "expected > 0 with turnover")
        require(self.steps_per_target >= 1, "steps_per_target", self.steps_per_target, "expected >= 1")
        require(self.steps is None or self.steps >= 1, "steps", self.steps, "expected >= 1")

    def horizon(self, targets: int) -> int:
        """Steps of an episode with that many targets."""
        return self.steps if self.steps is not None else self.steps_per_target * max(1, targets)

    @property
    def mean_horizon(self) -> float:
        """Steps of an episode in the mean over the scenes that are drawn."""
        numbers = range(self.targets_min, self.targets_max + 1)
        return sum(map(self.horizon, numbers)) / len(numbers)

    @property
    def middle_steps_left(self) -> int:
        """The steps to the end in the middle of an episode: what a robot without an end tells its policy every time."""
        return round(self.mean_horizon / 2)


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """One world: what moves, who looks, how well, and how often (`tau_s` [s] between decisions)."""

    tau_s: float = 1.0
    agent: AgentSettings = field(default_factory=DifferentialDrive)
    view: ViewSettings = field(default_factory=TriangleView)
    sensor: SensorSettings = field(default_factory=SensorSettings)
    target: TargetSettings = field(default_factory=DriftTarget)
    scenes: SceneSettings = field(default_factory=SceneSettings)
    schedule: ScheduleSettings = field(default_factory=ScheduleSettings)

    def __post_init__(self) -> None:
        positive(self, "tau_s")
        representable(self)
        d = self.dimension
        right = f"expected a shape in {d} dimensions, as the agent's"
        require(self.view.dimension == d, "view.shape", self.view.shape, right)
        require(len(self.scenes.centre_m) == d, "scenes.centre_m", self.scenes.centre_m, f"expected {d} numbers")
        A, _, _, Z = self.target.motion(d, self.tau_s)
        H = self._observation(Z)
        if H.shape[1] != len(A):
            raise ValueError(f"sensor.H has {H.shape[1]} columns: expected {len(A)}, the length of a target's state")
        if len(H) > len(A):
            raise ValueError(f"sensor.H has {len(H)} rows: expected at most {len(A)}, the length of a target's state")
        noises = [("sensor.V", V) for V in (self.sensor.V,) if V is not None]
        for name, V in [*noises, *(("schedule.V", V) for V in self.schedule.V)]:
            if len(V) != len(H):
                raise ValueError(
                    f"{name} is {len(V)} x {len(V)}: expected {len(H)} x {len(H)}, one row per measurement"
                )
        for W in self.schedule.W:
            if len(W) != len(A):
                raise ValueError(f"schedule.W is {len(W)} x {len(W)}: expected {len(A)} x {len(A)}, as targets' states")
        problem = self.problem()
        for tau in self.schedule.tau_s:
            self.target.motion(d, tau)
        for W in self.schedule.W:
            for tau in self.schedule.tau_s or (self.tau_s,):
                require_predictable(self.target.motion(d, tau)[0], np.array(W), "target.A, schedule.W")
        if any(self.scenes.drift_m_s) and not problem.motion.takes_drift:
            right = "expected 0: these targets have no place for it (Z = [I 0] and a velocity, or Z = B = I)"
            raise ValueError(f"scenes.drift_m_s = {self.scenes.drift_m_s!r}: {right}")
        if self.sensor.frame == "body" and H.shape[0] != d:
            raise ValueError(f"sensor.frame = 'body' needs measured positions: H has {H.shape[0]} rows, expected {d}")
        V = np.asarray(problem.period.V[0])
        turns = self.sensor.frame == "body" and not np.array_equal(V, V[0, 0] * np.eye(len(V)))
        if turns and self.scenes.initial_error == "paper":
            raise ValueError(
                "scenes.initial_error = 'paper': N(0, V) says nothing of the world where V turns with the agent: "
                "expected 'consistent' with this sensor"
            )

    def _observation(self, Z: np.ndarray) -> np.ndarray:
        return Z if self.sensor.H is None else matrix(self.sensor.H, "sensor.H", (None, None))

    @property
    def dimension(self) -> int:
        """Dimension of space."""
        return self.agent.dimension

    def problem(self) -> Problem:
        """The arrays that simulation works on."""
        d = self.dimension
        H = self._observation(self.target.motion(d, self.tau_s)[-1])
        V = self.sensor.std_m**2 * np.eye(len(H)) if self.sensor.V is None else np.array(self.sensor.V)
        sensor = Sensor(
            H=_array(H),
            V=_array(V),
            view=self.view.view(),
            range_growth=self.sensor.range_growth_per_m,
            frame=self.sensor.frame,
            uses_absence=self.sensor.absence == "used",
        )
        return Problem(
            agent=self.agent.agent(),
            sensor=sensor,
            motion=self._motion(self.tau_s),
            tau=_array(self.tau_s),
            prior_information=_array(np.linalg.inv(self.target.prior_covariance(d))),
            schedule=self._schedule(V),
        )

    def _motion(self, tau_s: float, W: Matrix | None = None) -> LinearGaussian:
        A, B, own, Z = self.target.motion(self.dimension, tau_s)
        return LinearGaussian(A=_array(A), B=_array(B), W=_array(own if W is None else W), Z=_array(Z))

    def _schedule(self, V: np.ndarray) -> Schedule | None:
        """One entry a step; what the settings leave empty is as at all times."""
        given = self.schedule
        if given.length == 0:
            return None
        taus = given.tau_s or (self.tau_s,) * given.length
        motions = [self._motion(tau, W) for tau, W in zip(taus, given.W or (None,) * given.length, strict=True)]
        return Schedule(
            tau=_array(taus),
            motion=jax.tree.map(lambda *parts: jnp.stack(parts), *motions),
            V=_array(given.V or [V] * given.length),
        )


def _array(value: float | np.ndarray | Sequence) -> jnp.ndarray:
    return jnp.asarray(value, float)
