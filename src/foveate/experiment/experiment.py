"""The experiment: scenario, policy and learner of a training, as in `config.toml`."""

from dataclasses import dataclass, field, fields, replace

from foveate.errors import InputError
from foveate.experiment.learners import ActorCriticSettings, LearningSettings, PPOSettings, TrainingSettings
from foveate.policies.attention import AttentionSettings
from foveate.policies.pointer import PointerSettings
from foveate.scenario.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """Everything that defines a training run."""

    scenario: Scenario = field(default_factory=Scenario)
    policy: AttentionSettings | PointerSettings = field(default_factory=AttentionSettings)
    training: TrainingSettings | PPOSettings | ActorCriticSettings = field(default_factory=TrainingSettings)


POINTER_LENGTH_DEPTHS = 2.5
"""Unit of length of a pointer network in depths of the view, as in the presets: 5 m for a view of 2 m."""


def with_learner(experiment: Experiment, learner: TrainingSettings | PPOSettings | ActorCriticSettings) -> Experiment:
    """Replace the learner of an experiment, keeping its objective, validation, softness and noise.

    If the learner cannot train the experiment's network, the network is replaced too. Raises InputError if PPO, which
    maximises log det at the horizon, would replace a learner with another objective.
    """
    old = experiment.training
    if isinstance(learner, PPOSettings) and old.objective != "terminal":
        raise InputError(f"training.objective = {old.objective!r}: expected 'terminal', the only objective of PPO")
    kept = {"objective", *(each.name for each in fields(LearningSettings))} & {each.name for each in fields(learner)}
    training = replace(learner, **{name: getattr(old, name) for name in kept if hasattr(old, name)})
    if isinstance(learner, ActorCriticSettings) == isinstance(experiment.policy, PointerSettings):
        return replace(experiment, training=training)
    policy = AttentionSettings()
    if isinstance(learner, ActorCriticSettings):
        length_m = POINTER_LENGTH_DEPTHS * float(experiment.scenario.view.depth_m)
        policy = PointerSettings(kind="pointer", length_m=length_m)
    return replace(experiment, policy=policy, training=training)
