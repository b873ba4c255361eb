"""From a recording to a scenario: who moves there and how, as an experiment that trains a policy for it."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from foveate.agent_settings import DifferentialDrive, Quadrotor
from foveate.motion_fit import MotionStatistics
from foveate.policies.attention import AttentionSettings
from foveate.scenario import Scenario, SceneSettings, SensorSettings
from foveate.settings import DEEPER, Experiment, TrainingSettings
from foveate.target_settings import DriftTarget, VelocityTarget
from foveate.view_settings import FrustumView, SectorView


@dataclass(frozen=True, kw_only=True)
class Robot:
    """The user's agent and sensor: top speed [m/s], turn rate [rad/s], depth [m] and angle [deg] of view, noise [m].

    In space a quadrotor that climbs at half its speed, with a camera two thirds as high as wide.
    """

    v_max: float
    w_max: float
    depth_m: float
    angle_deg: float
    std_m: float


def fit_experiment(
    statistics: MotionStatistics, robot: Robot, goal: Literal["seen", "information"] = "seen"
) -> Experiment:
    """A scenario whose targets appear where the recording has them and move as it says, for the user's robot.

    `goal`: to have the targets in view for as long as possible ("seen"), or to know all of them well ("information":
    the policy then looks around rather than stays).
    """
    if len(statistics.robust_lower_m) == 3:
        return _in_space(statistics, robot, goal)
    return _in_the_plane(statistics, robot, goal)


def _scenes(statistics: MotionStatistics, turnover: bool) -> SceneSettings:
    """Targets as many and as fast as the recording's, uniform in the box of 98 % of its fixes, for 20 s."""
    lower, upper = statistics.robust_lower_m, statistics.robust_upper_m
    sides = tuple(float(x) for x in np.maximum((upper - lower) / 2, 1.0))
    return SceneSettings(
        targets_min=max(1, statistics.at_once_min),
        targets_max=max(2, int(np.ceil(statistics.at_once_p95))),
        centre_m=tuple(float(x) for x in (lower + upper) / 2),
        half_side_m=sides,
        half_side_per_target_m=0.0,
        agent_spread=1.0,
        agent_test_half_side_m=min(sides),
        # Uniform velocities of the recording's own second moment: a street has walkers along it, few across.
        drift_m_s=tuple(float(x) for x in np.sqrt(3 * np.diag(statistics.walk_covariance_m2)) / statistics.tau_s),
        shared_drift=False,
        known_drift=False,
        process_noise=False,
        turnover=turnover,
        jitter_m_s=0.0,
        steps=max(10, round(20.0 / statistics.tau_s)),
        initial_error="consistent",
    )


def _in_the_plane(statistics: MotionStatistics, robot: Robot, goal: Literal["seen", "information"]) -> Experiment:
    """Targets walk straight; the filter is not told, and supposes a random walk of the recording's displacements."""
    depth = robot.depth_m
    scenario = Scenario(
        tau_s=statistics.tau_s,
        agent=DifferentialDrive(v_max_m_s=robot.v_max, w_max_rad_s=robot.w_max),
        view=SectorView(depth_m=depth, angle_deg=robot.angle_deg),
        sensor=SensorSettings(std_m=robot.std_m),
        target=DriftTarget(W=_rows(statistics.walk_covariance_m2), initial_variance_m2=1.0),
        # Measured: a stationary crowd keeps a watcher from spinning; pursuit is learned where targets disperse.
        scenes=_scenes(statistics, turnover=goal == "seen"),
    )
    # One soft level reaches across the arena and one keeps near the real view; both scale with what the sensor sees.
    training = TrainingSettings(
        epochs=600,
        episodes=128,
        learning_rate=1e-3,
        schedule="cosine",
        softness=((1.0, 0.8 * depth), (0.3, 0.06 * depth)),
        objective="seen" if goal == "seen" else "mean",
        noise=True,
        select="true",
        check_every=50,
    )
    return Experiment(scenario=scenario, policy=AttentionSettings(length_m=depth), training=training)


def _in_space(statistics: MotionStatistics, robot: Robot, goal: Literal["seen", "information"]) -> Experiment:
    """Velocities driven by white noise of the recording's accelerations, and forgotten as its speeds stay bounded.

    A speed of stationary second moment s^2 under noise of density q has a memory of 2 s^2 / q.
    """
    depth, d = robot.depth_m, len(statistics.robust_lower_m)
    square_speed = float(np.trace(statistics.walk_covariance_m2)) / statistics.tau_s**2
    density = statistics.acceleration_intensity
    if density is None:  # too short a recording to tell: a speed that is lost within 2 s
        density = square_speed / d * np.eye(d)
    scenario = Scenario(
        tau_s=statistics.tau_s,
        agent=Quadrotor(
            kind="quadrotor",
            v_max_m_s=robot.v_max,
            climb_max_m_s=0.5 * robot.v_max,
            yaw_rate_max_rad_s=robot.w_max,
        ),
        view=FrustumView(
            shape="frustum",
            near_m=min(0.3, 0.05 * depth),
            depth_m=depth,
            width_deg=robot.angle_deg,
            height_deg=2 / 3 * robot.angle_deg,
        ),
        sensor=SensorSettings(std_m=robot.std_m),
        target=VelocityTarget(
            kind="constant_velocity",
            Q=_rows(density),
            memory_s=max(2 * square_speed / float(np.trace(density)), statistics.tau_s),
            initial_variance_m2=1.0,
            initial_velocity_variance_m2_s2=square_speed / d,
        ),
        # Any number of targets up to the most: what was there at once is a sample.
        scenes=replace(_scenes(statistics, turnover=True), targets_min=1, process_noise=True),
    )
    training = TrainingSettings(
        epochs=600,
        episodes=64,
        learning_rate=5e-4,
        schedule="cosine",
        softness=((1.0, 0.2 * depth), (0.3, 0.075 * depth)),
        objective="seen" if goal == "seen" else "mean",
        noise=True,
        select="true",
        check_every=50,
    )
    return Experiment(scenario=scenario, policy=replace(DEEPER, length_m=depth), training=training)


def _rows(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(x) for x in row) for row in matrix)
