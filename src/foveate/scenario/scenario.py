"""The world of an experiment as plain, checked settings: agent, view, sensor, targets, and how scenes are drawn.

`Scenario` is what the `[scenario]` table of a configuration file holds; `Scenario.problem()` turns it into arrays.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from foveate.errors import InputError
from foveate.io.validate import Matrix, matrix, positive, representable, require
from foveate.models.problem import Problem, Schedule
from foveate.models.sensor import Sensor
from foveate.models.target import LinearGaussian
from foveate.scenario.agent import AgentSettings, DifferentialDrive
from foveate.scenario.field_of_view import TriangleView, ViewSettings
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import ScheduleSettings, SensorSettings
from foveate.scenario.target import DriftTarget, TargetSettings, require_predictable


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
            raise InputError(f"sensor.H has {H.shape[1]} columns: expected {len(A)}, the length of a target's state")
        if len(H) > len(A):
            raise InputError(f"sensor.H has {len(H)} rows: expected at most {len(A)}, the length of a target's state")
        noises = [("sensor.V", V) for V in (self.sensor.V,) if V is not None]
        for name, V in [*noises, *(("schedule.V", V) for V in self.schedule.V)]:
            if len(V) != len(H):
                raise InputError(
                    f"{name} is {len(V)} x {len(V)}: expected {len(H)} x {len(H)}, one row per measurement"
                )
        for W in self.schedule.W:
            if len(W) != len(A):
                raise InputError(f"schedule.W is {len(W)} x {len(W)}: expected {len(A)} x {len(A)}, as targets' states")
        problem = self.problem()
        for tau in self.schedule.tau_s:
            self.target.motion(d, tau)
        for W in self.schedule.W:
            for tau in self.schedule.tau_s or (self.tau_s,):
                require_predictable(self.target.motion(d, tau)[0], np.array(W), "target.A, schedule.W")
        if any(self.scenes.drift_m_s) and not problem.motion.takes_drift:
            right = "expected 0: these targets have no place for it (Z = [I 0] and a velocity, or Z = B = I)"
            raise InputError(f"scenes.drift_m_s = {self.scenes.drift_m_s!r}: {right}")
        if self.sensor.frame == "body" and H.shape[0] != d:
            raise InputError(f"sensor.frame = 'body' needs measured positions: H has {H.shape[0]} rows, expected {d}")
        V = np.asarray(problem.period.V[0])
        turns = self.sensor.frame == "body" and not np.array_equal(V, V[0, 0] * np.eye(len(V)))
        if turns and self.scenes.initial_error == "paper":
            raise InputError(
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
            uses_missed_detections=self.sensor.missed_detections == "used",
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
