"""Preset experiments and learners, and how to adapt them."""

import math
from dataclasses import replace

from foveate.errors import InputError
from foveate.experiment.experiment import POINTER_LENGTH_DEPTHS, Experiment, with_learner
from foveate.experiment.learners import ActorCriticSettings, LearningSettings, PPOSettings, TrainingSettings
from foveate.policies.pointer import PointerSettings
from foveate.scenario.agent import Quadrotor
from foveate.scenario.field_of_view import FrustumView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import VelocityTarget

QUADROTOR = Scenario(
    tau_s=0.5,
    agent=Quadrotor(kind="quadrotor"),
    view=FrustumView(shape="frustum"),
    target=VelocityTarget(kind="constant_velocity", acceleration_m2_s3=0.02, initial_velocity_variance_m2_s2=0.16),
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


PRESETS = {
    "paper": Experiment(),
    "best": Experiment(
        policy=PointerSettings(kind="pointer"),
        training=ActorCriticSettings(
            algorithm="actor-critic",
            protocols=("surrogate", "true"),
            select="surrogate",
            epochs=400,
            episodes=384,
            action_std=(0.4, 0.04),
        ),
    ),
    "true-view": Experiment(
        policy=PointerSettings(kind="pointer"),
        training=ActorCriticSettings(algorithm="actor-critic"),
    ),
    # First beliefs err by as much as they claim: a target must be searched around its mean.
    "search": Experiment(
        scenario=Scenario(
            sensor=SensorSettings(missed_detections="used"),
            scenes=SceneSettings(initial_error="consistent"),
        ),
        policy=PointerSettings(kind="pointer"),
        training=ActorCriticSettings(algorithm="actor-critic", epochs=400),
    ),
    "quadrotor": Experiment(
        scenario=QUADROTOR,
        policy=PointerSettings(kind="pointer", length_m=POINTER_LENGTH_DEPTHS * QUADROTOR.view.depth_m),
        training=ActorCriticSettings(algorithm="actor-critic", objective="mean"),
    ),
}
"""The presets by name: whole experiments, each with a trained policy in the package."""


PPO = {
    "ppo": PPOSettings(algorithm="ppo"),
    "ppo-tuned": PPOSettings(
        algorithm="ppo",
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
"""The model-free baseline: with Stable-Baselines3's defaults, and tuned for this task."""


def for_scenario(scenario: Scenario, preset: str = "true-view") -> Experiment:
    """Use a preset's network and learner for another scenario, scaling their lengths with the depth of the view.

    Raises InputError for an unknown preset.
    """
    if preset not in PRESETS:
        raise InputError(f"preset {preset!r}: presets are {', '.join(PRESETS)}")
    base = PRESETS[preset]
    scale = float(scenario.view.depth_m) / float(base.scenario.view.depth_m)
    policy, training = replace(base.policy, length_m=scale * base.policy.length_m), base.training
    if isinstance(training, LearningSettings):
        training = replace(training, softness=tuple((offset, scale * kappa) for offset, kappa in training.softness))
    return Experiment(scenario=scenario, policy=policy, training=training)


LEARNERS = {
    "policy-gradient": TrainingSettings(),
    "actor-critic": ActorCriticSettings(algorithm="actor-critic"),
    **PPO,
}
"""Learners that can replace an experiment's own."""


def adjusted(
    experiment: Experiment,
    algorithm: str | None = None,
    epochs: int | None = None,
    episodes: int | None = None,
    steps: int | None = None,
) -> Experiment:
    """Replace the learner of an experiment by one of LEARNERS, and its budget, where these are given.

    Raises InputError for an unknown learner, and for a budget that the learner does not have.
    """
    if algorithm is not None:
        if algorithm not in LEARNERS:
            raise InputError(f"algorithm {algorithm!r}: expected one of {', '.join(LEARNERS)}")
        learner = LEARNERS[algorithm]
        # Where the experiment has this learner already its own settings stay; "ppo-tuned" is asked for by its settings.
        if algorithm == "ppo-tuned" or type(learner) is not type(experiment.training):
            experiment = with_learner(experiment, learner)
    budgets = ("steps",) if isinstance(experiment.training, PPOSettings) else ("epochs", "episodes")
    given = {"epochs": epochs, "episodes": episodes, "steps": steps}
    changes = {name: value for name, value in given.items() if value is not None}
    for name, value in changes.items():
        if name not in budgets:
            raise InputError(f"{name} {value}: this algorithm does not count them: expected {' or '.join(budgets)}")
    return replace(experiment, training=replace(experiment.training, **changes))


def for_long_horizons(experiment: Experiment, remat: bool = False, window: int | None = None) -> Experiment:
    """The experiment with less memory, or a bounded gradient, for episodes of many steps.

    Args:
        experiment: trained by the policy gradient; raises InputError for another learner.
        remat: remember few states of an episode and run what lies between again (the same gradient).
        window: steps after which the gradient is cut off (another gradient); None keeps it whole.
    """
    if not remat and window is None:
        return experiment
    training, scenes = experiment.training, experiment.scenario.scenes
    if not isinstance(training, TrainingSettings):
        raise InputError("remat, window: expected a training by the policy gradient")
    if window is not None:
        training = replace(training, window=window)
    if remat:
        # As many segments as steps in each: their sum, the states that are remembered, is smallest at the square root.
        training = replace(training, segment=math.isqrt(scenes.horizon(scenes.targets_max) - 1) + 1)
    return replace(experiment, training=training)
