"""Fit an experiment to a recording: a scenario with its targets, for the user's robot, and a policy to train."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings
from foveate.io.toml import save_toml
from foveate.io.validate import require
from foveate.names import Goal
from foveate.policies.pointer_settings import PointerSettings
from foveate.recordings.formats import AnyPath, load_window
from foveate.recordings.maps import inside, map_of
from foveate.recordings.motion import MotionStatistics, fit_statistics
from foveate.recordings.outliers import clean
from foveate.recordings.recording import Recording
from foveate.recordings.split import parsed_split, part_of
from foveate.scenario.agent import DifferentialDrive, Quadrotor
from foveate.scenario.field_of_view import FrustumView, SectorView
from foveate.scenario.obstacles import OccupancyObstacles
from foveate.scenario.region import RegionSettings
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import VelocityTarget

MIN_STEPS, MAX_STEPS = 40, 200
"""Steps of an episode: enough to reach several targets, few enough to train on."""

BOTH_GIVEN = "Where both are given, Q replaces acceleration_m2_s3, and steps replaces steps_per_target."


@dataclass(frozen=True, kw_only=True, repr=False)
class Fitted:
    """An experiment for the targets of a recording, ready for `foveate.train`; shows their statistics as text."""

    experiment: Experiment
    statistics: MotionStatistics
    recording: Recording

    def save(self, path: str | Path) -> None:
        """Write the experiment as an editable TOML file, with the statistics as comments."""
        header = f"Fitted to {self.recording.short_name} by foveate fit.\n{self!r}\n{BOTH_GIVEN}"
        save_toml(self.experiment, path, header, sealed=False)

    def __repr__(self) -> str:
        return "\n".join([*self.recording.notes, *self.statistics.lines(), self._episode(), *self._in_obstacles()])

    def _episode(self) -> str:
        """Length of an episode beside the time that crossing the scene takes."""
        scenario, crossing_s = self.experiment.scenario, self.statistics.crossing_s
        steps = scenario.scenes.horizon(1)
        hint = f"; tau = {crossing_s / steps:.2g} would cover it" if crossing_s > (steps + 1) * scenario.tau_s else ""
        return f"episode of {steps} steps, {steps * scenario.tau_s:.3g} s; a target crosses in {crossing_s:.3g} s{hint}"

    def _in_obstacles(self) -> list[str]:
        """The number of fixes in the walls of the map, if there is one."""
        settings, obstacles = self.experiment.scenario.obstacles, self.experiment.scenario.problem().obstacles
        if not isinstance(settings, OccupancyObstacles) or obstacles is None:
            return []
        fixes = np.concatenate([track.positions_m for track in self.recording.tracks])
        return [f"map {settings.file}: {inside(obstacles, fixes).sum()} of {len(fixes)} fixes are in its walls"]


def fit(
    recording: Recording | AnyPath | Sequence[AnyPath],
    *,
    start: float | None = None,
    end: float | None = None,
    split: str | Sequence[float] | None = None,
    max_gap: float | None = None,
    max_speed: float | None = None,
    v_max: float = 3.0,
    w_max: float = 1.5,
    view_depth: float = 10.0,
    view_angle_deg: float = 90.0,
    tau: float = 0.5,
    sensor_std_m: float = 0.3,
    goal: Goal = "seen",
    map: str | Path | None = None,
) -> Fitted:
    """Derive an experiment from a recording of real targets: train its `experiment`, or `save` it.

    `recording`: files with the header time_s,track_id,x_m,y_m[,z_m], or what `foveate.load_recording` reads of others.

    `start`, `end`, `max_gap` [s], and `max_speed` [m/s], as for `replay`; with a `split` it is fitted to the part to
    train on. The others are of the robot that will move
    there: largest speed [m/s] and turn rate [rad/s], depth [m] and angle [deg] of its view, time between decisions [s],
    standard deviation of a measured position [m]. `goal`: keep targets in view for as long as possible ("seen"), or
    estimate all of them well ("information": the policy then looks around instead of staying with a few). `map`: the
    YAML file of the robot's map (ROS's map_server), in the recording's frame, whose walls become the obstacles.
    """
    require(tau > 0, "tau", tau, "expected > 0")
    whole = load_window(recording, start, end)
    part = whole if split is None else part_of(whole, parsed_split(split), "train")
    statistics = fit_statistics(part, tau, max_gap, max_speed)
    walls = None if map is None else map_of(clean(part, max_speed).recording, map)
    agent, view = _robot(part.dimension, v_max, w_max, view_depth, view_angle_deg)
    experiment = Experiment(
        scenario=Scenario(
            tau_s=tau,
            agent=agent,
            view=view,
            sensor=SensorSettings(std_m=sensor_std_m),
            target=_target(statistics, sensor_std_m),
            region=_region(statistics),
            scenes=_scenes(statistics),
            origin=part.origin,
            obstacles=walls,
        ),
        policy=PointerSettings(),
        training=ActorCriticSettings(objective="seen" if goal == "seen" else "mean"),
    )
    return Fitted(experiment=experiment, statistics=statistics, recording=part)


def _robot(
    dimension: int, v_max: float, w_max: float, depth_m: float, angle_deg: float
) -> tuple[DifferentialDrive | Quadrotor, SectorView | FrustumView]:
    """Agent and view: in space a quadrotor that climbs at half its speed, with a camera two thirds as high as wide."""
    if dimension == 2:
        return DifferentialDrive(v_max_m_s=v_max, w_max_rad_s=w_max), SectorView(depth_m=depth_m, angle_deg=angle_deg)
    agent = Quadrotor(v_max_m_s=v_max, climb_max_m_s=0.5 * v_max, yaw_rate_max_rad_s=w_max)
    view = FrustumView(
        near_m=min(0.3, 0.05 * depth_m),
        depth_m=depth_m,
        width_deg=angle_deg,
        height_deg=2 / 3 * angle_deg,
    )
    return agent, view


def _region(statistics: MotionStatistics) -> RegionSettings:
    """The box of 98 % of the fixes, without borders: it tells a policy where to wait for those who come."""
    lower, upper = statistics.robust_lower_m, statistics.robust_upper_m
    middle, half = (lower + upper) / 2, np.maximum((upper - lower) / 2, 1.0)
    low, high = (tuple((middle + side * half).tolist()) for side in (-1, 1))
    return RegionSettings(low_m=low, high_m=high, agent="free", targets="free")


def _target(statistics: MotionStatistics, sensor_std_m: float) -> VelocityTarget:
    """Target with velocities driven by white noise of the recording's accelerations, damped as its speeds are bounded.

    A speed of stationary second moment s^2 under noise of density q has a memory of 2 s^2 / q. The initial belief is
    that of a target detected once, a step or a fix of the recording ago, whose velocity is unknown.
    """
    density, d = statistics.acceleration_intensity, len(statistics.robust_lower_m)
    square_speed, age_s = statistics.mean_square_speed_m2_s2, max(statistics.tau_s, statistics.fix_interval_s)
    if density is None:  # the recording is too short to tell: a speed with a memory of 2 s
        density = square_speed / d * np.eye(d)
    if statistics.is_walk:  # the shortest memory, and as far in a long time: memory^2 q t = W t / tau
        density = statistics.walk_covariance_m2 / statistics.tau_s**3
        square_speed = 0.5 * statistics.tau_s * float(np.trace(density))
    total = float(np.trace(density))
    return VelocityTarget(
        acceleration_m2_s3=total / d,
        Q=tuple(tuple(row) for row in density.tolist()),
        memory_s=max(2 * square_speed / total, statistics.tau_s),
        initial_variance_m2=sensor_std_m**2 + square_speed / d * age_s**2,
        initial_velocity_variance_m2_s2=square_speed / d,
    )


def _scenes(statistics: MotionStatistics) -> SceneSettings:
    """Scenes with as many targets as the recording, equally fast, uniform in the box of 98 % of its fixes.

    An episode lasts as long as a target takes to cross that box: each comes and goes.
    """
    lower, upper = statistics.robust_lower_m, statistics.robust_upper_m
    sides = tuple(np.maximum((upper - lower) / 2, 1.0).tolist())
    # Uniform velocities with the recording's own second moment: a street has many walkers along it, few across.
    drift = np.sqrt(3 * np.diag(statistics.walk_covariance_m2)) / statistics.tau_s
    return SceneSettings(
        targets_min=1,  # the number present at once varies: train for few, too
        targets_max=max(2, int(np.ceil(statistics.at_once_p95))),
        centre_m=tuple(((lower + upper) / 2).tolist()),
        half_side_m=sides,
        half_side_per_target_m=0.0,
        agent_spread=1.0,
        agent_test_half_side_m=min(sides),
        drift_m_s=tuple(drift.tolist()),
        shared_drift=False,
        known_drift=False,
        birth_and_death=True,
        jitter_m_s=0.0,
        steps=int(np.clip(np.ceil(statistics.crossing_s / statistics.tau_s), MIN_STEPS, MAX_STEPS)),
        initial_error="consistent",
        first_mean_velocity="zero",
    )
