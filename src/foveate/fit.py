"""From a recording to a scenario: who moves there and how, as an experiment that trains a policy for it."""

from typing import Literal

import numpy as np

from foveate.agent_settings import DifferentialDrive
from foveate.motion_fit import MotionStatistics
from foveate.policies.attention import AttentionSettings
from foveate.scenario import Scenario, SceneSettings, SensorSettings
from foveate.settings import Experiment, TrainingSettings
from foveate.target_settings import DriftTarget
from foveate.view_settings import SectorView


def fit_experiment(
    statistics: MotionStatistics,
    *,
    v_max: float,
    w_max: float,
    depth_m: float,
    angle_deg: float,
    std_m: float,
    goal: Literal["seen", "information"] = "seen",
) -> Experiment:
    """A scenario whose targets appear where the recording has them and walk straight at its speed.

    The agent is not told how targets move: its filter supposes a random walk with the covariance of the recording's
    displacements. Agent and sensor are the user's. `goal`: to have the targets in view for as long as possible
    ("seen"), or to know all of them well ("information": the policy then looks around rather than stays).
    """
    lower, upper = statistics.robust_lower_m, statistics.robust_upper_m
    sides = tuple(float(x) for x in np.maximum((upper - lower) / 2, 1.0))
    W = tuple(tuple(float(x) for x in row) for row in statistics.walk_covariance_m2)
    scenario = Scenario(
        tau_s=statistics.tau_s,
        agent=DifferentialDrive(v_max_m_s=v_max, w_max_rad_s=w_max),
        view=SectorView(depth_m=depth_m, angle_deg=angle_deg),
        sensor=SensorSettings(std_m=std_m),
        target=DriftTarget(W=W, initial_variance_m2=1.0),
        scenes=SceneSettings(
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
            # Measured: a stationary crowd keeps a watcher from spinning; pursuit is learned where targets disperse.
            turnover=goal == "seen",
            jitter_m_s=0.0,
            steps=max(10, round(20.0 / statistics.tau_s)),
            initial_error="consistent",
        ),
    )
    # One soft level reaches across the arena and one keeps near the real view; both scale with what the sensor sees.
    training = TrainingSettings(
        epochs=600,
        episodes=128,
        learning_rate=1e-3,
        schedule="cosine",
        softness=((1.0, 0.8 * depth_m), (0.3, 0.06 * depth_m)),
        objective="seen" if goal == "seen" else "mean",
        noise=True,
        select="true",
        check_every=50,
    )
    return Experiment(scenario=scenario, policy=AttentionSettings(length_m=depth_m), training=training)
