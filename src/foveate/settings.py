"""Everything that defines a run, as it stands in `config.toml`: the world, the policy and how it is trained."""

from dataclasses import dataclass, field, fields, replace
from typing import Literal

from foveate.agent_settings import Quadrotor
from foveate.checks import not_negative, positive, require
from foveate.models.sensor import PAPER_SOFTNESS, Softness
from foveate.policies.attention import AttentionSettings
from foveate.policies.pooling import PoolingSettings
from foveate.rollout import Flow, Protocol
from foveate.scenario import Scenario, SceneSettings
from foveate.target_settings import VelocityTarget
from foveate.view_settings import FrustumView


@dataclass(frozen=True, kw_only=True)
class LearningSettings:
    """What every learner is after, and how it is judged.

    `softness` lists the levels (offset, kappa [m]) of the soft field of view, hardest last: what is earned is the mean
    over levels, and the policy sees the last. With `noise`, targets move and are measured as in the real world, means
    are corrected, and the soft view is taken at the truth; without (the paper), the mean is the truth. From time to
    time the policy is judged on `held_out` scenes that never train it, by the score of `select`; the best is kept.
    """

    softness: tuple[tuple[float, float], ...] = ((PAPER_SOFTNESS.offset, PAPER_SOFTNESS.kappa),)
    noise: bool = False
    select: Literal["surrogate", "true"] = "surrogate"
    held_out: int = 240

    def __post_init__(self) -> None:
        require(self.held_out >= 1, "held_out", self.held_out, "expected >= 1")
        if not self.softness or min(kappa for _, kappa in self.softness) <= 0:
            raise ValueError(f"softness = {self.softness}: expected at least one (offset, kappa) with kappa > 0")

    @property
    def protocol(self) -> Protocol:
        """Where information comes from while training."""
        return Protocol(levels=tuple(Softness(*level) for level in self.softness), at_truth=self.noise)


@dataclass(frozen=True, kw_only=True)
class TrainingSettings(LearningSettings):
    """How a policy is trained by the policy gradient.

    One epoch is one step of Adam on the mean of `episodes` fresh episodes, its gradient's norm bounded at
    `gradient_bound`. `objective` is log det at the horizon ("terminal", the paper), its mean over the steps ("mean"),
    or the share of time in view ("seen"). `feedback` and `foresight` damp the gradient as in `rollout.Flow`; 1 and 1
    are exact. Before all that, in the first share of the epochs, `lessons`, the policy learns to act as a `teacher`
    made by hand does. The policy is judged every `check_every` epochs.
    """

    epochs: int = 1000
    episodes: int = 60
    learning_rate: float = 3e-4
    schedule: Literal["constant", "cosine"] = "constant"
    gradient_bound: float = 10.0
    objective: Literal["terminal", "mean", "seen"] = "terminal"
    feedback: float = 1.0
    foresight: float = 1.0
    teacher: Literal["nearest", "uncertain", "lawnmower"] = "uncertain"
    lessons: float = 0.0
    check_every: int = 50

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("epochs", "episodes", "check_every"):
            require(getattr(self, name) >= 1, name, getattr(self, name), "expected >= 1")
        positive(self, "learning_rate", "gradient_bound")
        for name in ("feedback", "foresight", "lessons"):
            require(0 <= getattr(self, name) <= 1, name, getattr(self, name), "expected a share, 0 to 1")

    @property
    def flow(self) -> Flow:
        """How the gradient flows back through an episode."""
        return Flow(self.feedback, self.foresight)

    @property
    def lesson_epochs(self) -> int:
        """The first so many epochs are lessons."""
        return round(self.lessons * self.epochs)


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

    algorithm: Literal["ppo"]
    steps: int = 1_000_000
    environments: int = 64
    rollout_steps: int = 32
    batch: int = 64
    passes: int = 10
    learning_rate: float = 3e-4
    schedule: Literal["constant", "linear"] = "constant"
    discount: float = 0.99
    gae_lambda: float = 0.95
    clip: float = 0.2
    value_weight: float = 0.5
    entropy_weight: float = 0.0
    gradient_bound: float = 0.5
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
class Experiment:
    """One run: scenario, policy, training."""

    scenario: Scenario = field(default_factory=Scenario)
    policy: AttentionSettings | PoolingSettings = field(default_factory=AttentionSettings)
    training: TrainingSettings | PPOSettings = field(default_factory=TrainingSettings)


def with_learner(experiment: Experiment, learner: TrainingSettings | PPOSettings) -> Experiment:
    """The experiment with another learner, under the same softness, noise and judging protocol.

    PPO is always after log det at the horizon: raises ValueError for an experiment with another objective.
    """
    now = experiment.training
    if isinstance(learner, PPOSettings) and isinstance(now, TrainingSettings) and now.objective != "terminal":
        raise ValueError(f"training.objective = {now.objective!r}: expected 'terminal', all that PPO is after")
    shared = {each.name: getattr(experiment.training, each.name) for each in fields(LearningSettings)}
    return replace(experiment, training=replace(learner, **shared))


DEEPER = AttentionSettings(agent_widths=(64,), target_widths=(64, 64, 64), out_widths=(64, 64), information="asinh")
"""The paper's architecture, a layer deeper and twice as wide, with compressed information matrices: what the 27
numbers of a target in space ask for."""

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
        # Nearer to the targets' middle than in the paper, as tests begin.
        scenario=Scenario(scenes=SceneSettings(agent_spread=0.6)),
        policy=PoolingSettings(kind="pooling"),
        training=TrainingSettings(
            epochs=2000,
            episodes=64,
            learning_rate=1e-3,
            schedule="cosine",
            softness=((1.0, 0.8), (PAPER_SOFTNESS.offset, PAPER_SOFTNESS.kappa), (0.3, 0.25), (0.0, 0.12)),
            feedback=0.0,
            foresight=0.4,
            lessons=0.5,
        ),
    ),
    "quadrotor": Experiment(
        scenario=QUADROTOR,
        policy=replace(DEEPER, length_m=QUADROTOR.view.depth_m),
        training=TrainingSettings(
            epochs=1000,
            episodes=64,
            learning_rate=5e-4,
            schedule="cosine",
            softness=((1.0, 1.2), (0.3, 0.45)),
            objective="mean",
            select="true",
        ),
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
