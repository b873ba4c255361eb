"""Fit an experiment to a recording: a scenario with its targets, for the user's robot, and a policy to train."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from foveate.experiment.experiment import POINTER_LENGTH_DEPTHS, Experiment
from foveate.experiment.learners import ActorCriticSettings
from foveate.io.toml import save_toml
from foveate.io.validate import require
from foveate.names import Goal
from foveate.policies.pointer import PointerSettings
from foveate.recordings.formats import load_window
from foveate.recordings.motion import MotionStatistics, fit_statistics
from foveate.recordings.recording import Recording
from foveate.scenario.agent import DifferentialDrive, Quadrotor
from foveate.scenario.field_of_view import FrustumView, SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import VelocityTarget


@dataclass(frozen=True, kw_only=True, repr=False)
class Fitted:
    """An experiment for the targets of a recording, ready for `foveate.train`; shows their statistics as text."""

    experiment: Experiment
    statistics: MotionStatistics
    recording: Recording

    def save(self, path: str | Path) -> None:
        """Write the experiment as an editable TOML file, with the statistics as comments."""
        header = f"Fitted to {Path(self.recording.name).name} by foveate fit.\n{self!r}"
        save_toml(self.experiment, path, header, sealed=False)

    def __repr__(self) -> str:
        return "\n".join(self.statistics.lines())


def fit(
    recording: Recording | str | Path,
    *,
    start: float | None = None,
    end: float | None = None,
    max_gap: float | None = None,
    v_max: float = 3.0,
    w_max: float = 1.5,
    view_depth: float = 10.0,
    view_angle_deg: float = 90.0,
    tau: float = 0.5,
    sensor_std_m: float = 0.3,
    goal: Goal = "seen",
) -> Fitted:
    """Derive an experiment from a recording of real targets: train its `experiment`, or `save` it.

    `start`, `end` and `max_gap` [s] as for `replay`; the others are of the robot that will move there: largest speed
    [m/s] and turn rate [rad/s], depth [m] and angle [deg] of its view, time between decisions [s], standard deviation
    of a measured position [m]. `goal`: keep targets in view for as long as possible ("seen"), or estimate all of them
    well ("information": the policy then looks around instead of staying with a few).
    """
    require(tau > 0, "tau", tau, "expected > 0")
    part = load_window(recording, start, end)
    statistics = fit_statistics(part, tau, max_gap)
    agent, view = _robot(part.dimension, v_max, w_max, view_depth, view_angle_deg)
    experiment = Experiment(
        scenario=Scenario(
            tau_s=tau,
            agent=agent,
            view=view,
            sensor=SensorSettings(std_m=sensor_std_m),
            target=_target(statistics),
            scenes=_scenes(statistics),
        ),
        policy=PointerSettings(kind="pointer", length_m=POINTER_LENGTH_DEPTHS * view_depth),
        training=ActorCriticSettings(
            algorithm="actor-critic", epochs=150, episodes=192, objective="seen" if goal == "seen" else "mean"
        ),
    )
    return Fitted(experiment=experiment, statistics=statistics, recording=part)


def _robot(
    dimension: int, v_max: float, w_max: float, depth_m: float, angle_deg: float
) -> tuple[DifferentialDrive | Quadrotor, SectorView | FrustumView]:
    """Agent and view: in space a quadrotor that climbs at half its speed, with a camera two thirds as high as wide."""
    if dimension == 2:
        return DifferentialDrive(v_max_m_s=v_max, w_max_rad_s=w_max), SectorView(depth_m=depth_m, angle_deg=angle_deg)
    agent = Quadrotor(kind="quadrotor", v_max_m_s=v_max, climb_max_m_s=0.5 * v_max, yaw_rate_max_rad_s=w_max)
    view = FrustumView(
        shape="frustum",
        near_m=min(0.3, 0.05 * depth_m),
        depth_m=depth_m,
        width_deg=angle_deg,
        height_deg=2 / 3 * angle_deg,
    )
    return agent, view


def _target(statistics: MotionStatistics) -> VelocityTarget:
    """Target with velocities driven by white noise of the recording's accelerations, damped as its speeds are bounded.

    A speed of stationary second moment s^2 under noise of density q has a memory of 2 s^2 / q.
    """
    square_speed = float(np.trace(statistics.walk_covariance_m2)) / statistics.tau_s**2
    density, d = statistics.acceleration_intensity, len(statistics.robust_lower_m)
    if density is None:  # the recording is too short to tell: a speed with a memory of 2 s
        density = square_speed / d * np.eye(d)
    total = float(np.trace(density))
    return VelocityTarget(
        kind="constant_velocity",
        acceleration_m2_s3=total / d,
        Q=tuple(tuple(row) for row in density.tolist()),
        memory_s=max(2 * square_speed / total, statistics.tau_s),
        initial_variance_m2=1.0,
        initial_velocity_variance_m2_s2=square_speed / d,
    )


def _scenes(statistics: MotionStatistics) -> SceneSettings:
    """Scenes of 20 s with as many targets as the recording, equally fast, uniform in the box of 98 % of its fixes."""
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
        steps=max(10, round(20.0 / statistics.tau_s)),
        initial_error="consistent",
    )
