"""How policies are trained: what each learner can be told, as it stands in `config.toml`."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from foveate.errors import InputError
from foveate.io.validate import MOST_THINGS, not_negative, positive, require
from foveate.models.sensor import PAPER_SOFTNESS, Softness
from foveate.names import Objective, ProtocolName
from foveate.simulation.records import Backpropagation, Protocol


@dataclass(frozen=True, kw_only=True)
class ValidationSettings:
    """How a policy is judged while it learns, on `held_out` scenes that never train it, by the score of `select`; the
    best is kept.
    """

    select: ProtocolName = "surrogate"
    held_out: int = 240

    def __post_init__(self) -> None:
        require(self.held_out >= 1, "held_out", self.held_out, "expected >= 1")
        for name in ("held_out", "episodes", "environments", "rollout_steps", "batch", "segment", "window"):
            size = getattr(self, name, None)  # each learner has some of them
            require(size is None or size <= MOST_THINGS, name, size, f"expected <= {MOST_THINGS}")


@dataclass(frozen=True, kw_only=True)
class LearningSettings(ValidationSettings):
    """What the learners of the soft view are after.

    `softness` lists the levels (offset, kappa [m]) of the soft field of view, hardest last: what is earned is the mean
    over levels, and the policy sees the last. With `noise`, targets move and are measured as in the real world, means
    are corrected, and the soft view is taken at the truth; without (the paper), the mean is the truth.
    """

    softness: tuple[tuple[float, float], ...] = ((PAPER_SOFTNESS.offset, PAPER_SOFTNESS.kappa),)
    noise: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.softness or min(kappa for _, kappa in self.softness) <= 0:
            raise InputError(f"softness = {self.softness}: expected at least one (offset, kappa) with kappa > 0")

    @property
    def protocol(self) -> Protocol:
        """Where information comes from while training."""
        return Protocol(levels=tuple(Softness(*level) for level in self.softness), at_truth=self.noise)


@dataclass(frozen=True, kw_only=True)
class TrainingSettings(LearningSettings):
    """How a policy is trained by the policy gradient.

    One epoch is one step of Adam on the mean of `episodes` fresh episodes, its gradient's norm bounded at
    `gradient_bound`. `objective` is log det at the horizon ("terminal", the paper), its mean over the steps ("mean"),
    or the share of time in view ("seen"). The policy is judged every `check_every` epochs.

    At most `micro_batch` episodes are simulated at once on each device (None: as have 256 targets on a CPU's core, more
    elsewhere); this bounds memory, and changes rounding only. So does `segment`, for long horizons: of an episode only
    the states at the beginnings of so many steps at a time are remembered, and each segment is run again on the
    gradient's way back. With `window` the gradient is another one, bounded where horizons are long: it ends at every
    `window` steps, so that what a decision does is followed no further than to the end of its window.
    """

    RENAMED: ClassVar[dict[str, str]] = {"together": "micro_batch"}
    updates: ClassVar[int] = 1
    """Steps of Adam in an epoch."""
    epochs: int = 1000
    """Steps of Adam."""
    episodes: int = 60
    learning_rate: float = 3e-4
    """Of Adam."""
    schedule: Literal["constant", "cosine"] = "constant"
    """Constant, or falling to 0 as a cosine."""
    gradient_bound: float = 10.0
    objective: Objective = "terminal"
    check_every: int = 50
    micro_batch: int | None = None
    segment: int | None = None
    window: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("micro_batch", "segment", "window"):
            value = getattr(self, name)
            require(value is None or value >= 1, name, value, "expected >= 1")
        for name in ("epochs", "episodes", "check_every"):
            require(getattr(self, name) >= 1, name, getattr(self, name), "expected >= 1")
        positive(self, "learning_rate", "gradient_bound")

    @property
    def back(self) -> Backpropagation:
        """How the gradient goes back through an episode."""
        return Backpropagation(segment=self.segment, window=self.window)


@dataclass(frozen=True, kw_only=True)
class PPOSettings(LearningSettings):
    """How a policy is trained by proximal policy optimisation, model-free; the defaults are Stable-Baselines3's,
    but for the shape of a rollout, as large (64 x 32 for 1 x 2048), and the network, which is `AttentionPolicy`.

    `environments` side by side take `rollout_steps` steps each; then Adam goes over these `passes` times in
    minibatches of `batch`; and so on for `steps` steps of environments in all. The reward is the growth of the mean
    log det per target, times `reward_scale`; an episode's end is an end, of no value. `log_std` is the logarithm of
    the first standard deviation of the actions' noise. With `critic_sees_time` the value network, which is thrown
    away after training, is told the steps that are left. The learning rate is constant or falls linearly to 0. The
    policy is judged every `check_every` steps.
    """

    objective: ClassVar[Objective] = "terminal"
    algorithm: Literal["ppo"]
    steps: int = 1_000_000
    environments: int = 64
    rollout_steps: int = 32
    batch: int = 64
    passes: int = 10
    learning_rate: float = 3e-4
    """Of Adam."""
    schedule: Literal["constant", "linear"] = "constant"
    """Constant, or falling to 0."""
    discount: float = 0.99
    """Of rewards, a step."""
    gae_lambda: float = 0.95
    """Of generalised advantage estimation."""
    clip: float = 0.2
    """How far the ratio of probabilities may be from 1."""
    value_weight: float = 0.5
    """Of the value network's loss."""
    entropy_weight: float = 0.0
    """Of the actions' entropy."""
    gradient_bound: float = 0.5
    """Of a gradient's norm."""
    log_std: float = 0.0
    reward_scale: float = 1.0
    critic_sees_time: bool = False
    check_every: int = 50_000

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("steps", "environments", "rollout_steps", "passes", "check_every"):
            require(getattr(self, name) >= 1, name, getattr(self, name), "expected >= 1")
        collected = self.environments * self.rollout_steps
        right = f"expected a divisor of environments x rollout_steps = {collected}, and >= 2"
        require(self.batch >= 2 and collected % self.batch == 0, "batch", self.batch, right)
        positive(self, "learning_rate", "clip", "gradient_bound", "reward_scale")
        not_negative(self, "value_weight", "entropy_weight")
        for name in ("discount", "gae_lambda"):
            require(0 <= getattr(self, name) <= 1, name, getattr(self, name), "expected 0 to 1")


@dataclass(frozen=True, kw_only=True)
class ActorCriticSettings(ValidationSettings):
    """How a policy of modes is trained by trying: proximal policy optimisation on whole noisy episodes.

    An epoch plays `episodes` fresh episodes, shared out evenly among the `protocols`, with a mode drawn by its weight
    and a Gaussian about its action, whose standard deviation falls linearly, epoch by epoch, from the first of `action_std`
    towards the last, which it would reach after them;
    then Adam goes over all steps `passes` times in `minibatches` each. What is earned is the growth of log det per
    target ("terminal"), its mean over the steps ("mean") or the share of time in view ("seen"), undiscounted: nothing
    is worth anything after the horizon. Both learning rates fall to 0 as a cosine.
    """

    RENAMED: ClassVar[dict[str, str]] = {"spread": "action_std"}
    algorithm: Literal["actor-critic"]
    protocols: tuple[ProtocolName, ...] = ("true",)
    select: ProtocolName = "true"
    objective: Objective = "terminal"
    """What is earned."""
    epochs: int = 500
    """Rounds of playing and learning."""
    episodes: int = 256
    passes: int = 4
    minibatches: int = 8
    learning_rate: float = 1e-3
    """Of Adam, the policy's, at first."""
    critic_learning_rate: float = 1e-3
    """Of Adam, the critic's, at first."""
    gradient_bound: float = 0.5
    """Of a gradient's norm."""
    action_std: tuple[float, float] = (0.4, 0.06)
    gae_lambda: float = 0.95
    """Of generalised advantage estimation."""
    clip: float = 0.2
    """How far the ratio of probabilities may be from 1."""
    entropy_weight: float = 0.003
    """Of the modes' entropy."""
    check_every: int = 10
    """Epochs from one judging on held-out scenes to the next."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("epochs", "passes", "minibatches", "check_every"):
            require(getattr(self, name) >= 1, name, getattr(self, name), "expected >= 1")
        right = "expected at least one of surrogate, true, each once"
        require(len(set(self.protocols)) == len(self.protocols) > 0, "protocols", self.protocols, right)
        least = f">= minibatches = {self.minibatches}"
        right = f"expected a multiple of the number of protocols, {len(self.protocols)}, and {least}"
        shared = self.episodes % len(self.protocols) == 0 and self.episodes >= self.minibatches
        require(shared, "episodes", self.episodes, right)
        positive(self, "learning_rate", "critic_learning_rate", "gradient_bound", "clip")
        not_negative(self, "entropy_weight")
        require(min(self.action_std) > 0, "action_std", self.action_std, "expected two standard deviations > 0")
        require(0 <= self.gae_lambda <= 1, "gae_lambda", self.gae_lambda, "expected 0 to 1")

    @property
    def updates(self) -> int:
        """Steps of Adam in an epoch."""
        return self.passes * self.minibatches
