"""Everything that defines a run, as it stands in `config.toml`: the world, the policy and how it is trained."""

from dataclasses import dataclass, field
from typing import Literal

from foveate.models.sensor import PAPER_SOFTNESS, Softness
from foveate.policies.attention import AttentionSettings
from foveate.rollout import Protocol
from foveate.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class TrainingSettings:
    """How a policy is trained by the policy gradient.

    One epoch is one step of Adam on the mean of `episodes` fresh episodes, its gradient's norm bounded at
    `gradient_bound`. `softness` lists the levels (offset, kappa [m]) of the soft field of view, hardest last: the
    objective is the mean over levels, and the policy sees the last. `objective` is log det at the horizon ("terminal",
    the paper), its mean over the steps ("mean"), or the share of time in view ("seen"). With `noise`, targets move
    and are measured as in the real world, means are corrected, and the soft view is taken at the truth; without
    (the paper), the mean is the truth. Every `check_every` epochs the policy is judged on `held_out` scenes that never
    train it, by the score of `select`.
    """

    epochs: int = 1000
    episodes: int = 60
    learning_rate: float = 3e-4
    schedule: Literal["constant", "cosine"] = "constant"
    gradient_bound: float = 10.0
    softness: tuple[tuple[float, float], ...] = ((PAPER_SOFTNESS.offset, PAPER_SOFTNESS.kappa),)
    objective: Literal["terminal", "mean", "seen"] = "terminal"
    noise: bool = False
    select: Literal["surrogate", "true"] = "surrogate"
    held_out: int = 240
    check_every: int = 50

    def __post_init__(self) -> None:
        for name in ("epochs", "episodes", "held_out", "check_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} = {getattr(self, name)}: expected >= 1")
        for name in ("learning_rate", "gradient_bound"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} = {getattr(self, name)}: expected > 0")
        if not self.softness or min(kappa for _, kappa in self.softness) <= 0:
            raise ValueError(f"softness = {self.softness}: expected at least one (offset, kappa) with kappa > 0")

    @property
    def protocol(self) -> Protocol:
        """Where information comes from while training."""
        return Protocol(levels=tuple(Softness(*level) for level in self.softness), at_truth=self.noise)


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One run: scenario, policy, training."""

    scenario: Scenario = field(default_factory=Scenario)
    policy: AttentionSettings = field(default_factory=AttentionSettings)
    training: TrainingSettings = field(default_factory=TrainingSettings)


PRESETS = {
    "paper": Experiment(),
    "best": Experiment(
        training=TrainingSettings(epochs=2000, episodes=128, learning_rate=5e-4, schedule="cosine", check_every=50),
    ),
}
