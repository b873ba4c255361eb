"""Preset experiments and learners, and their adaptation."""

import math
from dataclasses import replace

from foveate.errors import InputError
from foveate.experiment.experiment import Experiment, with_learner
from foveate.experiment.learners import ActorCriticSettings, LearningSettings, PPOSettings, TrainingSettings
from foveate.names import Assignment
from foveate.policies.attention import AttentionSettings
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.agent import DifferentialDrive, FreeBody, Quadrotor
from foveate.scenario.field_of_view import ConeView, FrustumView, SectorView
from foveate.scenario.random_obstacles import ForestObstacles, RoomObstacles
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import VelocityTarget

QUADROTOR = Scenario(
    tau_s=0.5,
    agent=Quadrotor(),
    view=FrustumView(),
    target=VelocityTarget(acceleration_m2_s3=0.02, initial_velocity_variance_m2_s2=0.16),
    scenes=SceneSettings(
        centre_m=(0.0, 0.0, 3.0),
        half_side_m=(8.0, 8.0, 1.5),
        half_side_per_target_m=0.0,
        agent_spread=1.0,
        agent_test_half_side_m=1.5,
        drift_m_s=(0.7, 0.7, 0.1),
        shared_drift=False,
        steps=30,
        initial_error="consistent",
    ),
)
"""A flying camera over 3 to 8 targets that cross a hall of 16 x 16 x 3 m in all directions, for 15 s."""

PAN = Scenario(
    tau_s=0.5,
    agent=FreeBody(space="planar", axes=("wz",), lower=(-1.0,), upper=(1.0,)),
    view=SectorView(depth_m=20.0, angle_deg=40.0),
    target=VelocityTarget(
        acceleration_m2_s3=0.02,
        initial_variance_m2=1.0,
        initial_velocity_variance_m2_s2=0.16,
    ),
    scenes=SceneSettings(
        targets_min=4,
        targets_max=10,
        half_side_m=(8.0, 8.0),
        half_side_per_target_m=0.0,
        agent_spread=0.0,
        agent_test_half_side_m=0.0,
        drift_m_s=(0.7, 0.7),
        shared_drift=False,
        steps=40,
        initial_error="consistent",
    ),
)
"""A camera on a post, which turns at up to 57 deg/s among 4 to 10 targets that cross around it, for 20 s."""

PAN_TILT = replace(
    PAN,
    agent=FreeBody(axes=("wy", "wz"), lower=(-1.0, -1.0), upper=(1.0, 1.0)),
    # Turns about two axes of the body also roll it, which changes nothing in a view that is round.
    view=ConeView(depth_m=20.0, angle_deg=40.0),
    scenes=replace(PAN.scenes, centre_m=(0.0, 0.0, 0.0), half_side_m=(8.0, 8.0, 4.0), drift_m_s=(0.7, 0.7, 0.2)),
)
"""The same in space: a camera that turns about its upward and its sideways axis, with targets above and below it."""

ROOMS = Scenario(
    tau_s=0.5,
    agent=DifferentialDrive(v_max_m_s=2.0, w_max_rad_s=1.5),
    view=SectorView(depth_m=5.0, angle_deg=120.0),
    target=VelocityTarget(
        acceleration_m2_s3=0.02,
        initial_variance_m2=1.0,
        initial_velocity_variance_m2_s2=0.16,
    ),
    scenes=SceneSettings(
        targets_min=3,
        targets_max=6,
        half_side_m=(9.0, 9.0),
        half_side_per_target_m=0.0,
        agent_spread=1.0,
        agent_test_half_side_m=9.0,
        drift_m_s=(0.5, 0.5),
        shared_drift=False,
        steps=48,
        initial_error="consistent",
    ),
    obstacles=RoomObstacles(maps=32, keep_off_m=0.0),
)
"""A slow robot among 3 to 6 targets that walk through the rooms of a floor of 18 x 18 m, for 24 s."""

FOREST = replace(
    QUADROTOR,
    target=VelocityTarget(
        acceleration_m2_s3=0.02,
        initial_variance_m2=1.0,
        initial_velocity_variance_m2_s2=0.16,
    ),
    scenes=replace(QUADROTOR.scenes, targets_max=6, half_side_m=(12.0, 12.0, 1.5), steps=40),
    obstacles=ForestObstacles(density_per_m2=0.04, radius_m=(0.2, 0.4), height_m=(6.0, 9.0), keep_off_m=0.0),
)
"""The flying camera of QUADROTOR among the trunks of a wood of 24 x 24 m, taller than it flies, for 20 s."""

POINTER, ACTOR_CRITIC = PointerSettings(), ActorCriticSettings()
ANY = replace(POINTER, clips_features=True)
"""The network for any robot."""


def _watching(scenario: Scenario) -> Experiment:
    """Experiment of a scenario whose targets are to be known at all times, not at the end alone."""
    return Experiment(scenario=scenario, policy=POINTER, training=replace(ACTOR_CRITIC, objective="mean"))


PRESETS = {
    "paper": Experiment(),
    "best": Experiment(
        policy=POINTER,
        training=replace(
            ACTOR_CRITIC,
            protocols=("surrogate", "true"),
            select="surrogate",
            episodes=384,
            action_std=(0.4, 0.04),
        ),
    ),
    "true-view": Experiment(policy=POINTER, training=ACTOR_CRITIC),
    # Initial means err by as much as the beliefs claim: the agent must search for a target around its mean.
    "search": Experiment(
        scenario=Scenario(
            sensor=SensorSettings(missed_detections="used"), scenes=SceneSettings(initial_error="consistent")
        ),
        policy=POINTER,
        training=ACTOR_CRITIC,
    ),
    "quadrotor": _watching(QUADROTOR),
    # In worlds of random robots. The scenario is that of its verdict and its default.
    "any": Experiment(policy=ANY, training=replace(ACTOR_CRITIC, worlds="random", epochs=700)),
    "pan": _watching(PAN),
    "pan-tilt": _watching(PAN_TILT),
    "rooms": Experiment(
        scenario=ROOMS,
        policy=replace(POINTER, rays=16),
        training=replace(ACTOR_CRITIC, objective="mean", epochs=240),
    ),
    "forest": Experiment(
        scenario=FOREST,
        policy=replace(POINTER, rays=32),
        training=replace(ACTOR_CRITIC, objective="mean"),
    ),
}
"""Experiments by the names of the presets; the package has a trained policy of each."""

FINE_TUNING = replace(ACTOR_CRITIC, epochs=80, learning_rate=3e-4, action_std=(0.15, 0.06))
"""Learner that adapts the policy for any robot to one: about a minute of small steps from what it can do."""

PPO = {
    "ppo": PPOSettings(),
    "ppo-tuned": PPOSettings(
        environments=128,
        rollout_steps=32,
        batch=128,
        learning_rate=7e-4,
        schedule="linear",
        discount=1.0,
        log_std=-0.7,
        reward_scale=0.2,
        critic_sees_time=True,
    ),
}
"""The model-free baseline with Stable-Baselines3's defaults, and tuned for this task."""

LEARNERS = {"policy-gradient": TrainingSettings(), "actor-critic": ACTOR_CRITIC, **PPO}
"""Learners that can replace an experiment's own."""


def rule_for(scenario: Scenario) -> Assignment | None:
    """The rule that assigns targets in a team: by bids where all are heard, else by places; None for one robot."""
    team = scenario.problem().team
    if team is None:
        return None
    return "auction" if team.radio.kind == "perfect" else "greedy"


def for_scenario(scenario: Scenario, preset: str = "true-view") -> Experiment:
    """Return an experiment of a scenario with a preset's network and learner, their lengths scaled with the view.

    With "any" a training begins with the weights of that preset, in a team with assigned targets (`rule_for`).
    """
    if preset not in PRESETS:
        raise InputError(f"preset {preset!r}: presets are {', '.join(PRESETS)}")
    if preset == "any":
        policy = replace(ANY, begin_with="any", assignment=rule_for(scenario))
        return Experiment(scenario=scenario, policy=policy, training=FINE_TUNING)
    base = PRESETS[preset]
    scale = float(scenario.view.depth_m) / float(base.scenario.view.depth_m)
    policy, training = base.policy, base.training
    if isinstance(policy, AttentionSettings):
        policy = replace(policy, length_m=scale * policy.length_m)
    if isinstance(training, LearningSettings):
        training = replace(training, softness=tuple((offset, scale * kappa) for offset, kappa in training.softness))
    return Experiment(scenario=scenario, policy=policy, training=training)


def adjusted(experiment: Experiment, algorithm: str | None = None, **budget: int | None) -> Experiment:
    """Replace the learner of an experiment by one of LEARNERS, and its budget of epochs, episodes or steps, if given.

    Raises InputError for an unknown learner, and for a budget that the learner does not have.
    """
    if algorithm is not None:
        if algorithm not in LEARNERS:
            raise InputError(f"algorithm {algorithm!r}: expected one of {', '.join(LEARNERS)}")
        # The same learner keeps the experiment's settings, except "ppo-tuned", which is defined by its settings.
        if algorithm == "ppo-tuned" or type(LEARNERS[algorithm]) is not type(experiment.training):
            experiment = with_learner(experiment, LEARNERS[algorithm])
    budgets = ("steps",) if isinstance(experiment.training, PPOSettings) else ("epochs", "episodes")
    changes = {name: value for name, value in budget.items() if value is not None}
    for name, value in changes.items():
        if name not in budgets:
            raise InputError(f"{name} {value}: this algorithm does not count them: expected {' or '.join(budgets)}")
    return replace(experiment, training=replace(experiment.training, **changes))


def for_long_horizons(experiment: Experiment, remat: bool = False, window: int | None = None) -> Experiment:
    """Reduce the memory of a policy gradient for long episodes. Raises InputError for another learner.

    `remat` stores few states of an episode and simulates the others again, with the same gradient; `window` truncates
    the gradient after this number of steps.
    """
    if not remat and window is None:
        return experiment
    training, scenes = experiment.training, experiment.scenario.scenes
    if not isinstance(training, TrainingSettings):
        raise InputError("remat, window: expected a training by the policy gradient")
    # Equal numbers of segments and of steps in each, the square root, minimise their sum: the number of stored states.
    segment = math.isqrt(scenes.horizon(scenes.targets_max) - 1) + 1 if remat else training.segment
    training = replace(training, segment=segment, window=training.window if window is None else window)
    return replace(experiment, training=training)
