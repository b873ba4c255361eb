"""Settings of the learners, as in `config.toml`."""

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

from foveate.io.settings import Settings, tag
from foveate.io.validate import MAX_COUNT, at_least, positive, require
from foveate.models.sensor import PAPER_SOFTNESS, Softness
from foveate.names import Objective, ProtocolName
from foveate.scenario.scenes import SceneSettings
from foveate.simulation.records import PROTOCOLS, Backpropagation, Protocol

HELD_OUT_STEPS = 24_000
"""Most steps of a validation, about 5 s on two cores."""


@dataclass(frozen=True, kw_only=True)
class ValidationSettings(Settings):
    """Validation in training on `held_out` scenes that are not trained on; the best policy by `select` is kept."""

    select: ProtocolName = "surrogate"
    held_out: int = 240

    def held_out_scenes(self, scenes: SceneSettings) -> int:
        """`held_out`, or fewer where episodes are long: 32, or as many as have HELD_OUT_STEPS."""
        longest = scenes.horizon(scenes.targets_max)
        return min(self.held_out, max(32, HELD_OUT_STEPS // longest))

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(1, self, "held_out")
        for name in ("held_out", "episodes", "environments", "rollout_steps", "batch", "segment", "window"):
            size = getattr(self, name, None)  # each learner has some of them
            require(size is None or size <= MAX_COUNT, name, size, f"expected <= {MAX_COUNT}")


@dataclass(frozen=True, kw_only=True)
class LearningSettings(ValidationSettings):
    """Settings shared by the learners of the soft view.

    `softness` lists the levels (offset, kappa [m]) of the soft field of view, hardest last: the objective is the mean
    over levels, and the policy observes the last. With `noise`, motion and measurements are noisy, the filter corrects
    its means, and the soft view is that of the true positions; without (the paper), the mean is the truth.
    """

    softness: tuple[tuple[float, float], ...] = ((PAPER_SOFTNESS.offset, PAPER_SOFTNESS.kappa),)
    noise: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        smallest = min((kappa for _, kappa in self.softness), default=0.0)
        require(smallest > 0, "softness", self.softness, "expected at least one (offset, kappa) with kappa > 0")

    @property
    def protocol(self) -> Protocol:
        """Source of information in training."""
        return Protocol(levels=tuple(Softness(*level) for level in self.softness), at_truth=self.noise)


@dataclass(frozen=True, kw_only=True)
class TrainingSettings(LearningSettings):
    """Settings of the policy gradient.

    An iteration (of `epochs` in all) is a step of Adam with `learning_rate` on the mean of `episodes` new episodes, its
    gradient's norm bounded at `gradient_bound`. `objective` is log det at the horizon ("terminal", the paper), its mean
    over the steps ("mean"), or the share of time in view ("seen"). Every `check_every` iterations the policy is
    validated.

    Each number of targets has its share of the episodes of an iteration; those left over are drawn. At most
    `micro_batch` episodes are simulated at once on each device (None: those of 384 targets on a core of a CPU, more
    elsewhere); this bounds memory, and changes rounding only. So does `segment`, rematerialisation for long
    horizons: an episode stores its state only every `segment` steps, and the backward pass simulates each segment
    again. `window` truncates back-propagation through time every `window` steps: an action is credited up to the end
    of its window, which changes the gradient and bounds it for long horizons.
    """

    RENAMED: ClassVar[dict[str, str]] = {"together": "micro_batch"}
    updates: ClassVar[int] = 1
    """Steps of Adam in an iteration."""
    epochs: int = 1000
    episodes: int = 60
    learning_rate: float = 3e-4
    schedule: Literal["constant", "cosine"] = "constant"
    """Learning rate constant, or falling to 0 as a cosine."""
    gradient_bound: float = 10.0
    objective: Objective = "terminal"
    check_every: int = 50
    micro_batch: int | None = None
    segment: int | None = None
    window: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(1, self, "micro_batch", "segment", "window", "epochs", "episodes", "check_every")
        positive(self, "learning_rate", "gradient_bound")

    @property
    def backpropagation(self) -> Backpropagation:
        """Rematerialisation and truncation of back-propagation through an episode."""
        return Backpropagation(segment=self.segment, window=self.window)


@dataclass(frozen=True, kw_only=True)
class PPOSettings(LearningSettings):
    """Settings of model-free proximal policy optimisation (PPO) by Stable-Baselines3.

    The defaults are Stable-Baselines3's, except for the shape of a rollout, of the same size (64 x 32 for 1 x 2048),
    and the network, which is `AttentionPolicy`. Per iteration `environments` take `rollout_steps` steps each, and Adam
    updates on them for `update_epochs` epochs in minibatches of `batch`; there are `steps` environment steps in all.
    Adam has a `learning_rate` and gradient norms up to `gradient_bound`, and the ratio of probabilities is clipped to
    1 +- `clip`. Advantages are estimated with a `discount` per step and `gae_lambda`. The policy is validated every
    `check_every` steps.

    The reward is the growth of the mean log det per target, times `reward_scale`; the terminal state has no value.
    `log_std` is the log of the initial action std. With `critic_sees_time` the value network, which is discarded after
    training, has the steps left as a feature.
    """

    RENAMED: ClassVar[dict[str, str]] = {"passes": "update_epochs"}
    objective: ClassVar[Objective] = "terminal"
    algorithm: Literal["ppo"] = tag("ppo")
    steps: int = 1_000_000
    environments: int = 64
    rollout_steps: int = 32
    batch: int = 64
    update_epochs: int = 10
    learning_rate: float = 3e-4
    schedule: Literal["constant", "linear"] = "constant"
    """Learning rate constant, or falling linearly to 0."""
    discount: float = 0.99
    gae_lambda: float = 0.95
    clip: float = 0.2
    value_weight: float = 0.5
    """Weight of the value network's loss."""
    entropy_weight: float = 0.0
    """Weight of the actions' entropy."""
    gradient_bound: float = 0.5
    log_std: float = 0.0
    reward_scale: float = 1.0
    critic_sees_time: bool = False
    check_every: int = 50_000

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(1, self, "steps", "environments", "rollout_steps", "update_epochs", "check_every")
        collected = self.environments * self.rollout_steps
        right = f"expected a divisor of environments x rollout_steps = {collected}, and >= 2"
        require(self.batch >= 2 and collected % self.batch == 0, "batch", self.batch, right)
        positive(self, "learning_rate", "clip", "gradient_bound", "reward_scale")
        at_least(0, self, "value_weight", "entropy_weight")
        require(0 <= self.discount <= 1, "discount", self.discount, "expected 0 to 1")
        require(0 <= self.gae_lambda <= 1, "gae_lambda", self.gae_lambda, "expected 0 to 1")


DECISIONS, WORLD_DECISIONS = 4096, 1024
"""Default of the decisions in an iteration of the actor-critic, and in each world of random robots."""

LONG_DISCOUNT = 0.98
"""Default discount per step of episodes that are longer than a window."""


@dataclass(frozen=True, kw_only=True)
class ActorCriticSettings(ValidationSettings):
    """Settings of the actor-critic: PPO of a pointer policy on whole noisy episodes.

    An iteration (of `epochs` in all) simulates `episodes` episodes or windows of them (None: as many as have 4,096
    decisions; always an even number for each of the `protocols`), and samples a mode by its weight and a Gaussian about
    its action. The Gaussian's standard deviation, in units of the view (its depth, its half angle), falls linearly from
    the first `action_std` to the last at the end of training. Then Adam updates on all steps for `update_epochs` epochs
    of `minibatches` each. The `learning_rate` of the policy and the `critic_learning_rate` fall to 0 as a cosine,
    gradients have norms up to `gradient_bound`, and the ratio of probabilities is clipped to 1 +- `clip`. The policy is
    validated every `check_every` iterations.

    The return (`objective`) is the growth of log det per target ("terminal"), its mean over the steps ("mean") or the
    share of time in view ("seen"). Episodes of at most `window` steps are played whole, undiscounted, with no value
    after the horizon. Longer ones are played by equal windows, each from where the one before has ended, with a
    `discount` per step (None: 1 for episodes that are played whole, 0.98 for others) and the critic's value of what
    comes after, also after the end. Advantages are estimated with `gae_lambda`.
    With `worlds` = "random" it plays in other worlds than the scenario, each episode with a new robot: preset "any".
    """

    RENAMED: ClassVar[dict[str, str]] = {"spread": "action_std", "passes": "update_epochs"}
    algorithm: Literal["actor-critic"] = tag("actor-critic")
    worlds: Literal["own", "random"] = "own"
    protocols: tuple[ProtocolName, ...] = ("true",)
    select: ProtocolName = "true"
    objective: Objective = "terminal"
    epochs: int = 400
    episodes: int | None = None
    window: int = 64
    discount: float | None = None
    update_epochs: int = 4
    minibatches: int = 8
    learning_rate: float = 1e-3
    critic_learning_rate: float = 1e-3
    gradient_bound: float = 0.5
    action_std: tuple[float, float] = (0.4, 0.06)
    gae_lambda: float = 0.95
    clip: float = 0.2
    entropy_weight: float = 0.003
    """Weight of the modes' entropy."""
    check_every: int = 10

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(1, self, "epochs", "update_epochs", "minibatches", "check_every", "window")
        right = "expected at least one of surrogate, true, each once"
        require(len(set(self.protocols)) == len(self.protocols) > 0, "protocols", self.protocols, right)
        count, least = len(self.protocols), self.minibatches
        right = f"expected a multiple of the number of protocols, {count}, and >= minibatches = {least}"
        fits = self.episodes is None or (self.episodes % count == 0 and self.episodes >= least)
        require(fits, "episodes", self.episodes, right)
        positive(self, "learning_rate", "critic_learning_rate", "gradient_bound", "clip")
        at_least(0, self, "entropy_weight")
        require(min(self.action_std) > 0, "action_std", self.action_std, "expected two standard deviations > 0")
        require(0 <= self.gae_lambda <= 1, "gae_lambda", self.gae_lambda, "expected 0 to 1")
        require(self.discount is None or 0 < self.discount <= 1, "discount", self.discount, "expected > 0, at most 1")

    @property
    def updates(self) -> int:
        """Steps of Adam in an iteration."""
        return self.update_epochs * self.minibatches

    def protocol_of(self, i: int) -> Protocol:
        """The protocol of the i-th share of a batch."""
        return PROTOCOLS[self.protocols[i]]

    def _mean_window(self, scenes: SceneSettings) -> float:
        longest = scenes.horizon(scenes.targets_max)
        parts = math.ceil(longest / self.window)
        return scenes.mean_horizon if parts == 1 else float(math.ceil(longest / parts))

    def trajectories(self, scenes: SceneSettings, agents: int = 1) -> int:
        """Episodes, or windows of them, of an iteration: equally many of each protocol in each of two shards."""
        count = 2 * len(self.protocols)
        if self.episodes is not None:
            return math.ceil(self.episodes / count) * count
        decisions = DECISIONS if self.worlds == "own" else WORLD_DECISIONS
        return max(1, round(decisions / self._mean_window(scenes) / agents / count)) * count

    def decisions(self, scenes: SceneSettings, agents: int = 1) -> int:
        """Expected decisions of an iteration, those of all robots of a team."""
        return math.ceil(self.trajectories(scenes, agents) * self._mean_window(scenes) * agents)

    def discount_of(self, scenes: SceneSettings) -> float:
        """The discount per step: none where episodes are played whole."""
        if self.discount is not None:
            return self.discount
        return 1.0 if scenes.horizon(scenes.targets_max) <= self.window else LONG_DISCOUNT
