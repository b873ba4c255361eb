"""Everything that defines a run, as it stands in `config.toml`: the world, the policy and how it is trained."""

from dataclasses import dataclass, field, fields, replace

from foveate.agent_settings import Quadrotor
from foveate.learner_settings import ActorCriticSettings, LearningSettings, PPOSettings, TrainingSettings
from foveate.policies.attention import AttentionSettings
from foveate.policies.pointer import PointerSettings
from foveate.scenario import Scenario, SceneSettings, SensorSettings
from foveate.target_settings import VelocityTarget
from foveate.view_settings import FrustumView


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One run: scenario, policy, training."""

    scenario: Scenario = field(default_factory=Scenario)
    policy: AttentionSettings | PointerSettings = field(default_factory=AttentionSettings)
    training: TrainingSettings | PPOSettings | ActorCriticSettings = field(default_factory=TrainingSettings)


REACH = 2.5
"""Unit of length of a pointer network, in depths of the view."""


def with_learner(experiment: Experiment, learner: TrainingSettings | PPOSettings | ActorCriticSettings) -> Experiment:
    """The experiment with another learner, judged alike, and under the same softness and noise if it has them.

    A learner that cannot train the experiment's network comes with one that it can. PPO is always after log det at the
    horizon: raises ValueError for an experiment with another objective.
    """
    now = experiment.training
    if isinstance(learner, PPOSettings) and now.objective != "terminal":
        raise ValueError(f"training.objective = {now.objective!r}: expected 'terminal', all that PPO is after")
    names = [each.name for each in fields(LearningSettings)]
    shared = {name: getattr(now, name) for name in names if hasattr(now, name) and hasattr(learner, name)}
    if not isinstance(learner, PPOSettings):
        shared["objective"] = now.objective
    policy = experiment.policy
    if isinstance(learner, ActorCriticSettings) != isinstance(policy, PointerSettings):
        pointer = PointerSettings(kind="pointer", length_m=REACH * float(experiment.scenario.view.depth_m))
        policy = pointer if isinstance(learner, ActorCriticSettings) else AttentionSettings()
    return replace(experiment, policy=policy, training=replace(learner, **shared))


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
            spread=(0.4, 0.04),
        ),
    ),
    "true-view": Experiment(
        policy=PointerSettings(kind="pointer"),
        training=ActorCriticSettings(algorithm="actor-critic"),
    ),
    # Where first beliefs err by as much as they claim, going to where a target is believed to be does not find it.
    "search": Experiment(
        scenario=Scenario(
            sensor=SensorSettings(absence="used"),
            scenes=SceneSettings(initial_error="consistent"),
        ),
        policy=PointerSettings(kind="pointer"),
        training=ActorCriticSettings(algorithm="actor-critic", epochs=400),
    ),
    "quadrotor": Experiment(
        scenario=QUADROTOR,
        policy=PointerSettings(kind="pointer", length_m=REACH * QUADROTOR.view.depth_m),
        training=ActorCriticSettings(algorithm="actor-critic", objective="mean"),
    ),
}

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
"""The model-free rival: as Stable-Baselines3 comes, and tuned for this task."""


def for_scenario(scenario: Scenario, preset: str = "true-view") -> Experiment:
    """A preset's network and learner for another world: all their lengths grow with the depth of the view.

    Raises ValueError for a preset that is not there.
    """
    if preset not in PRESETS:
        raise ValueError(f"preset {preset!r}: presets are {', '.join(PRESETS)}")
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
"""What an experiment can be trained by in the place of its own learner."""


def adjusted(
    experiment: Experiment,
    algorithm: str | None = None,
    epochs: int | None = None,
    episodes: int | None = None,
    steps: int | None = None,
) -> Experiment:
    """The experiment with another learner of LEARNERS, or budget, where these are given.

    Raises ValueError for a learner that is not there, and a budget that its learner does not count.
    """
    if algorithm is not None:
        if algorithm not in LEARNERS:
            raise ValueError(f"algorithm {algorithm!r}: expected one of {', '.join(LEARNERS)}")
        learner = LEARNERS[algorithm]
        # An experiment's own settings of the learner that is asked for stay, but for the tuned ones.
        if algorithm == "ppo-tuned" or type(learner) is not type(experiment.training):
            experiment = with_learner(experiment, learner)
    training = experiment.training
    counted = ("steps",) if isinstance(training, PPOSettings) else ("epochs", "episodes")
    for name, value in (("epochs", epochs), ("episodes", episodes), ("steps", steps)):
        if value is None:
            continue
        if name not in counted:
            right = " or ".join(counted)
            raise ValueError(f"{name} {value}: this algorithm does not count them: expected {right}")
        training = replace(training, **{name: value})
    return replace(experiment, training=training)
