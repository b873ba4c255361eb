"""Fit an experiment to a recording: a scenario with its targets, for the user's robot, and a policy to train."""

from dataclasses import dataclass

import numpy as np

from foveate.experiment.experiment import POINTER_LENGTH_DEPTHS, Experiment
from foveate.experiment.learners import ActorCriticSettings
from foveate.names import Goal
from foveate.policies.pointer import PointerSettings
from foveate.recordings.motion import MotionStatistics
from foveate.scenario.agent import DifferentialDrive, Quadrotor
from foveate.scenario.field_of_view import FrustumView, SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import VelocityTarget


@dataclass(frozen=True, kw_only=True)
class Robot:
    """User's agent and sensor: top speed [m/s], turn rate [rad/s], depth [m] and angle [deg] of view, noise [m].

    In space a quadrotor that climbs at half its speed, with a camera two thirds as high as wide.
    """

    v_max: float
    w_max: float
    depth_m: float
    angle_deg: float
    std_m: float


def fit_experiment(statistics: MotionStatistics, robot: Robot, goal: Goal = "seen") -> Experiment:
    """Make an experiment whose targets appear and move as in a recording, with a policy to train by actor-critic.

    `goal`: keep targets in view for as long as possible ("seen"), or estimate all of them well ("information": the
    policy then looks around rather than stays).
    """
    agent, view = _quadrotor(robot) if len(statistics.robust_lower_m) == 3 else _drive(robot)
    scenario = Scenario(
        tau_s=statistics.tau_s,
        agent=agent,
        view=view,
        sensor=SensorSettings(std_m=robot.std_m),
        target=_target(statistics),
        scenes=_scenes(statistics),
    )
    training = ActorCriticSettings(
        algorithm="actor-critic",
        epochs=150,
        episodes=192,
        objective="seen" if goal == "seen" else "mean",
    )
    return Experiment(
        scenario=scenario,
        policy=PointerSettings(kind="pointer", length_m=POINTER_LENGTH_DEPTHS * robot.depth_m),
        training=training,
    )


def _drive(robot: Robot) -> tuple[DifferentialDrive, SectorView]:
    agent = DifferentialDrive(v_max_m_s=robot.v_max, w_max_rad_s=robot.w_max)
    return agent, SectorView(depth_m=robot.depth_m, angle_deg=robot.angle_deg)


def _quadrotor(robot: Robot) -> tuple[Quadrotor, FrustumView]:
    agent = Quadrotor(
        kind="quadrotor",
        v_max_m_s=robot.v_max,
        climb_max_m_s=0.5 * robot.v_max,
        yaw_rate_max_rad_s=robot.w_max,
    )
    view = FrustumView(
        shape="frustum",
        near_m=min(0.3, 0.05 * robot.depth_m),
        depth_m=robot.depth_m,
        width_deg=robot.angle_deg,
        height_deg=2 / 3 * robot.angle_deg,
    )
    return agent, view


def _target(statistics: MotionStatistics) -> VelocityTarget:
    """Target with velocities driven by white noise of the recording's accelerations, damped as its speeds are bounded.

    A speed of stationary second moment s^2 under noise of density q has a memory of 2 s^2 / q.
    """
    square_speed = float(np.trace(statistics.walk_covariance_m2)) / statistics.tau_s**2
    density, d = statistics.acceleration_intensity, len(statistics.robust_lower_m)
    if density is None:  # too short a recording to tell: a speed that is lost within 2 s
        density = square_speed / d * np.eye(d)
    return VelocityTarget(
        kind="constant_velocity",
        acceleration_m2_s3=float(np.trace(density)) / d,
        Q=tuple(tuple(float(x) for x in row) for row in density),
        memory_s=max(2 * square_speed / float(np.trace(density)), statistics.tau_s),
        initial_variance_m2=1.0,
        initial_velocity_variance_m2_s2=square_speed / d,
    )


def _scenes(statistics: MotionStatistics) -> SceneSettings:
    """Scenes of 20 s with as many targets as the recording has, as fast, uniform in the box of 98 % of its fixes."""
    lower, upper = statistics.robust_lower_m, statistics.robust_upper_m
    sides = tuple(float(x) for x in np.maximum((upper - lower) / 2, 1.0))
    return SceneSettings(
        targets_min=1,  # the number present at once varies: train for few, too
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
        birth_and_death=True,
        jitter_m_s=0.0,
        steps=max(10, round(20.0 / statistics.tau_s)),
        initial_error="consistent",
    )
