"""What defines a training, as it stands in `config.toml`: the scenario, the policy and its learner."""

from dataclasses import dataclass, field, fields, replace

from foveate.errors import InputError
from foveate.experiment.learners import ActorCriticSettings, LearningSettings, PPOSettings, TrainingSettings
from foveate.policies.attention import AttentionSettings
from foveate.policies.pointer import PointerSettings
from foveate.scenario.scenario import Scenario


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
        raise InputError(f"training.objective = {now.objective!r}: expected 'terminal', all that PPO is after")
    names = [each.name for each in fields(LearningSettings)]
    shared = {name: getattr(now, name) for name in names if hasattr(now, name) and hasattr(learner, name)}
    if not isinstance(learner, PPOSettings):
        shared["objective"] = now.objective
    policy = experiment.policy
    if isinstance(learner, ActorCriticSettings) != isinstance(policy, PointerSettings):
        pointer = PointerSettings(kind="pointer", length_m=REACH * float(experiment.scenario.view.depth_m))
        policy = pointer if isinstance(learner, ActorCriticSettings) else AttentionSettings()
    return replace(experiment, policy=policy, training=replace(learner, **shared))
