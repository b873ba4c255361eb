"""The scenario of an experiment, the `[scenario]` table of a configuration file."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from foveate.geometry.space import SPACES
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
    """Checked settings of agent, field of view, sensor, targets and scenes, with `tau_s` [s] between decisions."""

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
        is_view_of_space = self.view.view().dimension == d
        require(is_view_of_space, "view.shape", self.view.shape, f"expected a shape in {d} dimensions, as the agent's")
        require(len(self.scenes.centre_m) == d, "scenes.centre_m", self.scenes.centre_m, f"expected {d} numbers")
        self._check_matrices()
        problem = self.problem()
        for W in self.schedule.W:
            for tau in self.schedule.tau_s or (self.tau_s,):
                require_predictable(self.target.motion(d, tau)[0], np.array(W), "target.A, schedule.W")
        right = "expected 0: these targets have no place for it (Z = [I 0] and a velocity, or Z = B = I)"
        drift = self.scenes.drift_m_s
        require(not any(drift) or problem.motion.takes_drift, "scenes.drift_m_s", drift, right)
        # The paper's initial mean errs by N(0, V) in the world frame, before any pose: V must be the same for all.
        V = np.asarray(problem.period.V[0])
        turns = self.sensor.frame == "body" and not np.array_equal(V, V[0, 0] * np.eye(len(V)))
        right = "expected 'consistent': an initial error from N(0, V) is not defined where V turns with the agent"
        error = self.scenes.initial_error
        require(not (turns and error == "paper"), "scenes.initial_error", error, right)

    def _check_matrices(self) -> None:
        """Raise InputError unless H, V and W fit the targets' state and each other."""
        sensor, d = self.sensor, self.dimension
        A, _, _, Z = self.target.motion(d, self.tau_s)
        (rows, columns), n_y = self._observation(Z).shape, len(A)
        of_state = "the length of a target's state"
        require(columns == n_y, "sensor.H", sensor.H, f"expected {n_y} columns, {of_state}")
        require(rows <= n_y, "sensor.H", sensor.H, f"expected at most {n_y} rows, {of_state}")
        right = f"expected 'world', or a sensor.H of {d} rows that measures positions"
        require(sensor.frame == "world" or rows == d, "sensor.frame", sensor.frame, right)
        for name, V in [*(("schedule.V", V) for V in self.schedule.V), ("sensor.V", sensor.V)]:
            require(V is None or len(V) == rows, name, V, f"expected {rows} x {rows}, a row per measured number")
        for W in self.schedule.W:
            require(len(W) == n_y, "schedule.W", W, f"expected {n_y} x {n_y}, {of_state}")

    def _observation(self, Z: np.ndarray) -> np.ndarray:
        """H (rows, n_y), by default that of the position."""
        return Z if self.sensor.H is None else matrix(self.sensor.H, "sensor.H", (None, None))

    @property
    def dimension(self) -> int:
        """Dimension of space."""
        return SPACES[self.agent.space].dimension

    def problem(self) -> Problem:
        """The scenario as arrays, for simulation."""
        H = self._observation(self.target.motion(self.dimension, self.tau_s)[-1])
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
            prior_information=_array(np.linalg.inv(self.target.prior_covariance(self.dimension))),
            schedule=self._schedule(V),
        )

    def _motion(self, tau_s: float, W: Matrix | None = None) -> LinearGaussian:
        A, B, own, Z = self.target.motion(self.dimension, tau_s)
        return LinearGaussian(A=_array(A), B=_array(B), W=_array(own if W is None else W), Z=_array(Z))

    def _schedule(self, V: np.ndarray) -> Schedule | None:
        """Values of each step of a period; an empty list repeats the constant value."""
        schedule, steps = self.schedule, self.schedule.length
        if steps == 0:
            return None
        taus = schedule.tau_s or (self.tau_s,) * steps
        motions = map(self._motion, taus, schedule.W or (None,) * steps)
        motion = jax.tree.map(lambda *parts: jnp.stack(parts), *motions)
        return Schedule(tau=_array(taus), motion=motion, V=_array(schedule.V or [V] * steps))


def _array(value: float | np.ndarray | Sequence) -> jnp.ndarray:
    return jnp.asarray(value, float)
