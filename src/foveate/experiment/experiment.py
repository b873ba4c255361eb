"""The experiment: scenario, policy and learner of a training, as in `config.toml`."""

from dataclasses import dataclass, field, fields, replace

from foveate.errors import InputError
from foveate.experiment.learners import ActorCriticSettings, LearningSettings, PPOSettings, TrainingSettings
from foveate.io.settings import Settings
from foveate.io.validate import require
from foveate.models.problem import Problem
from foveate.names import OBJECTIVES
from foveate.policies.attention import AttentionSettings
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.scenario import Scenario
from foveate.simulation.records import Policy
from foveate.types import Key


@dataclass(frozen=True, kw_only=True)
class Experiment(Settings):
    """Everything that defines a training run."""

    scenario: Scenario = field(default_factory=Scenario)
    policy: AttentionSettings | PointerSettings = field(default_factory=AttentionSettings)
    training: TrainingSettings | PPOSettings | ActorCriticSettings = field(default_factory=TrainingSettings)

    @property
    def network(self) -> AttentionSettings | PointerSettings:
        """Settings of the policy: a pointer network is told the time left where the objective depends on it."""
        policy, training = self.policy, self.training
        if isinstance(policy, PointerSettings) and policy.tells_time is None:
            ends = not isinstance(training, ActorCriticSettings) or training.discount_of(self.scenario.scenes) == 1.0
            return replace(policy, tells_time=ends)
        return policy

    @property
    def is_for_any_robot(self) -> bool:
        """True if it trains in worlds of random robots."""
        return isinstance(self.training, ActorCriticSettings) and self.training.worlds == "random"

    @property
    def begins_with(self) -> str | None:
        """The preset or run folder whose weights a training begins with; None for random ones."""
        return self.policy.begin_with if isinstance(self.policy, PointerSettings) else None

    def require_learner(self) -> None:
        """Raise InputError unless the learner and its objective are for targets with ids, or without, as here."""
        has_ids, objective = self.scenario.detections is None, self.training.objective
        is_able = has_ids or isinstance(self.training, ActorCriticSettings)
        name = getattr(self.training, "algorithm", "policy-gradient")
        right = "expected 'actor-critic' with scenario.detections: no other learner knows targets without ids"
        require(is_able, "training.algorithm", name, right)
        right = "expected one for targets with ids" if has_ids else "expected 'gospa' with scenario.detections"
        require((objective == "gospa") != has_ids, "training.objective", objective, right)

    def new_policy(self, key: Key, problem: Problem | None = None) -> Policy:
        """The policy with random weights; `problem` is that of the scenario, which cannot be made under a trace."""
        network, problem = self.network, self.scenario.problem() if problem is None else problem
        if isinstance(network, PointerSettings):
            others = OBJECTIVES if self.is_for_any_robot else ()
            return network.policy(problem, key, self.training.objective, others)
        return network.policy(problem, key)


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
        policy = PointerSettings()
    return replace(experiment, policy=policy, training=training)
