"""The scenario of an experiment, the `[scenario]` table of a configuration file."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from foveate.errors import InputError
from foveate.geometry.space import SPACES
from foveate.io.settings import Settings
from foveate.io.validate import Matrix, matrix, positive, representable, require
from foveate.models.obstacles import Obstacles
from foveate.models.problem import Problem, Schedule
from foveate.models.target import LinearGaussian
from foveate.scenario.agent import AgentSettings, DifferentialDrive
from foveate.scenario.detections import DetectionSettings
from foveate.scenario.field_of_view import TriangleView, ViewSettings
from foveate.scenario.kinds import Kind, check_kinds, stacked, with_inherited
from foveate.scenario.origin import OriginSettings
from foveate.scenario.population import detection_model
from foveate.scenario.random_obstacles import ObstacleSettings
from foveate.scenario.region import RegionSettings
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import ScheduleSettings, SensorSettings
from foveate.scenario.starts import start_box
from foveate.scenario.target import DriftTarget, TargetSettings, require_predictable
from foveate.scenario.team import TeamSettings


@dataclass(frozen=True, kw_only=True)
class Scenario(Settings):
    """Checked settings of agent, field of view, sensor, targets and scenes, with `tau_s` [s] between decisions.

    With `keep_off_m` the agent does not come nearer to a target than this: its way ends there for the rest of the step,
    though it turns as commanded; if a target comes nearer by itself, the agent may only move away. What steers to a
    target, heuristics and pointer policies, drives past others in the way.
    """

    tau_s: float = 1.0
    keep_off_m: float | None = None
    agent: AgentSettings = field(default_factory=DifferentialDrive)
    view: ViewSettings = field(default_factory=TriangleView)
    sensor: SensorSettings = field(default_factory=SensorSettings)
    target: TargetSettings = field(default_factory=DriftTarget)
    scenes: SceneSettings = field(default_factory=SceneSettings)
    schedule: ScheduleSettings = field(default_factory=ScheduleSettings)
    region: RegionSettings | None = None
    origin: OriginSettings | None = None
    obstacles: ObstacleSettings | None = None
    detections: DetectionSettings | None = None
    team: TeamSettings | None = None

    inherited = staticmethod(with_inherited)

    def __post_init__(self) -> None:
        super().__post_init__()
        positive(self, "tau_s")
        require(self.keep_off_m is None or self.keep_off_m > 0, "keep_off_m", self.keep_off_m, "expected > 0")
        representable(self)
        d = self.dimension
        is_view_of_space = self.view.view().dimension == d
        require(is_view_of_space, "view.shape", self.view.shape, f"expected a shape in {d} dimensions, as the agent's")
        require(len(self.scenes.centre_m) == d, "scenes.centre_m", self.scenes.centre_m, f"expected {d} numbers")
        on_map = () if self.origin is None else self.origin.position_m
        require(len(on_map) in (0, d), "origin.position_m", on_map, f"expected {d} numbers")
        self._check_matrices()
        self._check_kinds()
        problem = self.problem()
        if self.region is not None:
            self.region.check(self.dimension, problem.motion.begins_with_position, self.scenes.birth_and_death)
        self._check_obstacles(problem)
        self._check_team()
        for W in self.schedule.W:
            for tau in self.schedule.tau_s or (self.tau_s,):
                require_predictable(self.target.motion(d, tau)[0], np.array(W), "target.A, schedule.W")
        right = "expected 0: these targets have no place for it (Z = [I 0] and a velocity, or Z = B = I)"
        drift = self.scenes.drift_m_s
        require(not any(drift) or problem.motion.takes_drift, "scenes.drift_m_s", drift, right)
        # The paper's initial mean errs by N(0, V) in the world frame, before any pose: V must be the same for all.
        V = np.asarray(problem.period.V[0])
        turns = self.sensor.frame == "body" and not np.array_equal(V, V[0, 0] * np.eye(len(V)))
        turns = turns or self.sensor.measures is not None
        right = "expected 'consistent': an initial error from N(0, V) is not defined where V turns with the agent"
        error, std = self.scenes.initial_error, self.scenes.first_error_std
        require(not (turns and error == "paper") or bool(std), "scenes.initial_error", error, right)
        blocks = problem.motion.state_size // d if problem.motion.begins_with_position else 0
        right = f"expected {blocks} numbers, one per block of the state (position, velocity, ..)"
        right = right if blocks else "expected none: the targets' state does not begin with their position (Z = [I 0])"
        require(not std or len(std) == blocks, "scenes.first_error_std", std, right)

    def _check_matrices(self) -> None:
        """Raise InputError unless H, V and W fit the targets' state and each other."""
        sensor, d = self.sensor, self.dimension
        sensor.require_dimension(d)
        A, _, _, Z = self.target.motion(d, self.tau_s)
        (rows, columns), n_y = self._observation(Z).shape, len(A)
        of_state = "the length of a target's state"
        require(columns == n_y, "sensor.H", sensor.H, f"expected {n_y} columns, {of_state}")
        require(rows <= n_y, "sensor.H", sensor.H, f"expected at most {n_y} rows, {of_state}")
        right = f"expected 'world', or a sensor.H of {d} rows that measures positions"
        require(sensor.frame == "world" or rows == d, "sensor.frame", sensor.frame, right)
        rows = len(sensor.coordinates) or rows
        for name, V in [*(("schedule.V", V) for V in self.schedule.V), ("sensor.V", sensor.V)]:
            require(V is None or len(V) == rows, name, V, f"expected {rows} x {rows}, a row per measured number")
        for W in self.schedule.W:
            require(len(W) == n_y, "schedule.W", W, f"expected {n_y} x {n_y}, {of_state}")

    def _check_obstacles(self, problem: Problem) -> None:
        """Raise InputError unless the agent can keep off obstacles, if it is to, and targets can go around them."""
        obstacles = self.obstacles
        if obstacles is not None and obstacles.keep_off_m is not None:
            try:
                for own in problem.kinds:
                    own.require_shortening()
            except InputError as error:
                raise InputError(f"obstacles.keep_off_m: {error}") from error
        if obstacles is None or obstacles.targets == "free":
            return
        right = "expected 'free': these targets have no position at an obstacle (Z = [I 0])"
        require(problem.motion.begins_with_position, "obstacles.targets", "around", right)
        right = "expected 'free' with scenes.birth_and_death: there targets leave and enter"
        require(not self.scenes.birth_and_death, "obstacles.targets", "around", right)

    def _check_kinds(self) -> None:
        """Raise InputError unless every robot of a team fits the scenario, and the others."""
        if self.team is None or self.team.robots is None:
            return
        check_kinds(self._own, self.team.robots, has_schedule=bool(self.schedule.V))
        for i, kind in enumerate(self.kinds):
            try:
                self._alone(kind, obstacles=None)
            except InputError as error:
                raise InputError(f"team.robots[{i}]: {error}") from error

    def _check_team(self) -> None:
        """Raise InputError unless the beliefs of a team can be fused."""
        if self.team is None or self.team.agents == 1:
            return
        side, d = self.team.half_side_m, self.dimension
        require(side is None or len(side) == d, "team.half_side_m", side, f"expected {d} numbers")
        right = "expected none for a team, whose messages hold measurements only"
        require(self.sensor.missed_detections != "used", "sensor.missed_detections", "used", right)
        if self.detections is not None:
            self.team.require_tracks(self.view)
        right = "expected false for a team, whose members know all targets from the start"
        require(not self.scenes.birth_and_death, "scenes.birth_and_death", True, right)

    def _obstacles(self) -> Obstacles | None:
        """Obstacles as arrays, on grids that hold the starts of agent and targets."""
        if self.obstacles is None:
            return None
        fits = self.obstacles.dimension == self.dimension
        right = f"expected obstacles in {self.dimension} dimensions, as the agent's"
        require(fits, "obstacles.kind", self.obstacles.kind, right)
        try:
            depth_m = max(float(kind.view.depth_m) for kind in self.kinds)
            return self.obstacles.obstacles(start_box(self.scenes, self.region), depth_m)
        except InputError as error:
            raise InputError(f"obstacles.{error}") from error

    def _observation(self, Z: np.ndarray) -> np.ndarray:
        """H (rows, n_y), by default that of the position."""
        return Z if self.sensor.H is None else matrix(self.sensor.H, "sensor.H", (None, None))

    @property
    def _own(self) -> Kind:
        return Kind(agent=self.agent, view=self.view, sensor=self.sensor)

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """The kinds of a team's robots in order; the scenario's own where all are alike."""
        robots = () if self.team is None else self.team.robots or ()
        return tuple(self._own.own(robot) for robot in robots) or (self._own,)

    def _alone(self, kind: Kind, **changes: Any) -> "Scenario":
        """The scenario of a robot of a kind, in a team of robots like it; itself where all are alike."""
        if self.team is None or self.team.robots is None:
            return self
        own = {"agent": kind.agent, "view": kind.view, "sensor": kind.sensor}
        return replace(self, **own, team=replace(self.team, robots=None), **changes)

    def of_robot(self, number: int) -> "Scenario":
        """The scenario of one robot of a team, by its number from 0: agent, view and sensor are its own.

        Raises InputError for a number that the team does not have.
        """
        last = 0 if self.team is None else self.team.agents - 1
        require(0 <= number <= last, "robot", number, f"expected 0 to {last}, a robot of the team")
        return self._alone(self.kinds[number % len(self.kinds)])

    @property
    def dimension(self) -> int:
        """Dimension of space."""
        return SPACES[self.agent.space].dimension

    def problem(self) -> Problem:
        """The scenario as arrays, for simulation."""
        if self.detections is None:
            return self._problem()
        with jax.ensure_compile_time_eval():  # what fills a view is counted, also where a program is being traced
            problem = self._problem()
            return replace(problem, detections=detection_model(self.detections, problem, self.scenes))

    def _problem(self) -> Problem:
        """The problem without detections."""
        H, kinds = self._observation(self.target.motion(self.dimension, self.tau_s)[-1]), self.kinds
        agent, sensor = kinds[0].models(H)
        period = 0 if self.schedule.V else self.schedule.length  # a scheduled V is that of all robots
        several = stacked(kinds, H, period) if any(kind != kinds[0] for kind in kinds) else None
        return Problem(
            agent=agent,
            sensor=sensor,
            motion=self._motion(self.tau_s),
            tau=_array(self.tau_s),
            prior_information=_array(np.linalg.inv(self.target.prior_covariance(self.dimension))),
            schedule=self._schedule(kinds[0].sensor.noise(len(H))),
            region=None if self.region is None else self.region.region(),
            keep_off_m=None if self.keep_off_m is None else _array(self.keep_off_m),
            obstacles=self._obstacles(),
            team=None if self.team is None else self.team.team(several),
        )

    def _motion(self, tau_s: float, W: Matrix | None = None) -> LinearGaussian:
        A, B, own, Z = self.target.motion(self.dimension, tau_s)
        H, noise = self._observation(Z), own if W is None else np.asarray(W, float)
        gains = [kind.finest_gain(H, kind.sensor.noise(len(H)), self.keep_off_m) for kind in self.kinds]
        gains += [self.kinds[0].finest_gain(H, np.array(V), self.keep_off_m) for V in self.schedule.V]
        return LinearGaussian.of(A, B, noise, Z, gains)

    def _schedule(self, V: np.ndarray) -> Schedule | None:
        """Values of each step of a period; an empty list repeats the constant value."""
        schedule, steps = self.schedule, self.schedule.length
        if steps == 0:
            return None
        taus = schedule.tau_s or (self.tau_s,) * steps
        motions = [self._motion(*each) for each in zip(taus, schedule.W or (None,) * steps, strict=True)]
        reversible = all(motion.is_reversible for motion in motions)
        motions = [replace(motion, is_reversible=reversible) for motion in motions]
        motion = jax.tree.map(lambda *parts: jnp.stack(parts), *motions)
        return Schedule(tau=_array(taus), motion=motion, V=_array(schedule.V or [V] * steps))


def _array(value: float | np.ndarray | Sequence) -> jnp.ndarray:
    return jnp.asarray(value, float)
