"""Methods of a comparison: small records that turn scenes into rows.

Your own method is one more record. A policy that needs no training: `Fixed(name="mine", make=...)`, where `make` builds
it for an experiment. One that a foveate experiment trains: `Learned(name="mine", training=Training(...))`.
Anything else: a subclass of `Method` with its `rows`. `examples/own_method.py` is a complete one.
"""

import abc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from importlib.util import find_spec
from typing import Any

from foveate.errors import InputError
from foveate.evaluation.evaluate import Row, Suite, evaluate
from foveate.evaluation.oracle import OnProgress, oracle_rows
from foveate.evaluation.planners import planner, planner_rows
from foveate.experiment.experiment import Experiment
from foveate.experiment.presets import PPO, PRESETS, adjusted
from foveate.names import HEURISTICS
from foveate.planning.named import heuristic_in
from foveate.planning.shooting import OMNISCIENT, ONLINE, PUBLISHED, PlanSettings, refining
from foveate.simulation.records import PROTOCOLS, Policy


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """Task of every method: an experiment, scenes of its scenario, and the noise in them."""

    experiment: Experiment
    suite: Suite


@dataclass(frozen=True, kw_only=True)
class Training:
    """Source of a policy: an experiment, trained once for every training seed by its own algorithm."""

    name: str
    experiment: Experiment


@dataclass(frozen=True, kw_only=True)
class Method(abc.ABC):
    """A way to decide. With a `training` there is one policy, and one set of rows, for every training seed.

    `family` groups methods in figures. Raise `revision` when the method's code has changed, so that its rows are
    computed again: only a change of its settings is noticed.
    """

    name: str
    family: str
    training: Training | None = None
    revision: int = 1

    @abc.abstractmethod
    def rows(self, benchmark: Benchmark, protocol: str, policy: Policy | None, on_progress: OnProgress) -> list[Row]:
        """Return one row an episode; `policy` is the trained one if the method has a training."""

    def settings(self, protocol: str) -> dict[str, Any]:
        """Return everything else that the rows depend on, as JSON."""
        return {}


@dataclass(frozen=True, kw_only=True)
class Acting(Method):
    """A policy, run in an evaluation."""

    @abc.abstractmethod
    def policy(self, experiment: Experiment, trained: Policy | None) -> Policy:
        """Return the policy for an experiment; `trained` is the one that the method's training gave, if any."""

    def rows(self, benchmark: Benchmark, protocol: str, policy: Policy | None, on_progress: OnProgress) -> list[Row]:
        """Evaluate the policy."""
        return evaluate(benchmark.suite, self.name, self.policy(benchmark.experiment, policy), (protocol,))


@dataclass(frozen=True, kw_only=True)
class Learned(Acting):
    """A trained policy."""

    family: str = "trained"

    def policy(self, experiment: Experiment, trained: Policy | None) -> Policy:
        """Return the trained policy."""
        if trained is None:
            raise InputError(f"method {self.name}: has no training: expected Learned(training=Training(..))")
        return trained


@dataclass(frozen=True, kw_only=True)
class Fixed(Acting):
    """A policy without training; `make` builds it for an experiment."""

    make: Callable[[Experiment], Policy]
    family: str = "heuristic"

    def policy(self, experiment: Experiment, trained: Policy | None) -> Policy:
        """Build the policy."""
        return self.make(experiment)


@dataclass(frozen=True, kw_only=True)
class Planned(Method):
    """A receding-horizon planner with its settings by protocol; with a training, one that refines the policy's plan."""

    plans: Mapping[str, PlanSettings]
    family: str = "planned"

    def rows(self, benchmark: Benchmark, protocol: str, policy: Policy | None, on_progress: OnProgress) -> list[Row]:
        """Plan every episode in receding horizon."""
        policy_of = partial(planner, benchmark.suite.problem, self.plans[protocol], policy=policy)
        scenes = benchmark.experiment.scenario.scenes
        return planner_rows(benchmark.suite, scenes, self.name, policy_of, protocol, on_progress)

    def settings(self, protocol: str) -> dict[str, Any]:
        """Return the planner's settings."""
        return asdict(self.plans[protocol])


@dataclass(frozen=True, kw_only=True)
class Omniscient(Planned):
    """The planner that knows the future: the oracle of normalised_score."""

    name: str = "omniscient"
    family: str = "omniscient"
    plans: Mapping[str, PlanSettings] = field(default_factory=lambda: OMNISCIENT)

    def rows(self, benchmark: Benchmark, protocol: str, policy: Policy | None, on_progress: OnProgress) -> list[Row]:
        """Plan every episode at full budget, or take the plans from the user's cache folder."""
        return oracle_rows(benchmark.suite, protocol, on_progress)


TRUE_VIEW = "true-view"
"""The preset for the true field of view, the reference of its suite."""

REFINING_ITERATIONS = 15


@dataclass(frozen=True, kw_only=True)
class Budget:
    """Size of a comparison; `scenes`: the first N of every cell; `targets`: cells with these numbers (None: all).

    The paper's methods are compared with `reference`, which is also refined: fixed before any result is seen.
    `cuts` shorten trainings. The methods `robust` are run under `factors` of robustness (None: all).
    """

    quick: bool = False
    learners: tuple[str, ...] = ("paper", "best", *PPO)
    reference: str = "best"
    cuts: Mapping[str, dict[str, int]]
    starts: tuple[int, ...] = (1, 4, 16, 64)
    seeds: tuple[int, ...] = (0, 10, 100)
    scenes: int = 30
    targets: tuple[int, ...] | None = None
    factors: tuple[str, ...] | None = None
    robust: tuple[str, ...] = ("omniscient", TRUE_VIEW, "uncertain", "nearest")


FULL = Budget(cuts={})
# Compilation takes most of the time: two sizes of scenes, as two cores compile side by side, and factors that keep the
# compiled programs.
QUICK = Budget(
    quick=True, seeds=(0,), scenes=3, targets=(3, 5), learners=("paper", "ppo"), reference="paper", starts=(),
    cuts={"paper": {"epochs": 300}, "ppo": {"steps": 40_000}, TRUE_VIEW: {"epochs": 40}},
    factors=("V", "depth"), robust=(TRUE_VIEW, "uncertain", "nearest"),
)  # fmt: skip


def paper_methods(budget: Budget) -> tuple[Method, ...]:
    """Methods of the paper's table: oracle, learners, the reference refined, planners, heuristics."""
    trainings = {name: _training(name, budget) for name in budget.learners if can_train(name)}
    return (
        Omniscient(),
        *(Learned(name=name, training=training) for name, training in trainings.items()),
        _refined(trainings[budget.reference]),
        Planned(name="icr", plans=dict.fromkeys(PROTOCOLS, PUBLISHED)),
        *map(_online, budget.starts),
        *map(_heuristic, HEURISTICS),
    )


def true_view_methods(budget: Budget) -> tuple[Method, ...]:
    """Methods of the suite in which only real detections of a target count."""
    paper, ours = _training("paper", budget), _training(TRUE_VIEW, budget)
    learned = (Learned(name="paper", training=paper), Learned(name=TRUE_VIEW, training=ours))
    slow = (_refined(ours), Planned(name="icr", plans={"true": PUBLISHED}), _online(16))
    return (Omniscient(), *learned, *(() if budget.quick else slow), *map(_heuristic, HEURISTICS))


def check_rows(rows: Sequence[Row], suite: Suite, method: str, protocol: str) -> None:
    """Raise InputError unless there is one row an episode of the suite, of this method and protocol."""
    expected = [(scene.id, episode) for scene in suite.scenes for episode in range(suite.episodes_per_scene)]
    if sorted((row.scene, row.episode) for row in rows) != sorted(expected):
        raise InputError(f"method {method}: gave {len(rows)} rows: expected one an episode of the suite")
    if {(row.method, row.protocol) for row in rows} - {(method, protocol)}:
        raise InputError(f"method {method}: its rows name another method or protocol than {protocol}")


def can_train(name: str) -> bool:
    """Test that the packages of a learner are installed."""
    return name not in PPO or find_spec("stable_baselines3") is not None


def _training(name: str, budget: Budget) -> Training:
    learner, preset = (name, "paper") if name in PPO else (None, name)
    return Training(name=name, experiment=adjusted(PRESETS[preset], learner, **budget.cuts.get(name, {})))


def _refined(training: Training) -> Planned:
    """A trained policy, improved by a planner at every step."""
    plans = {protocol: refining(protocol, REFINING_ITERATIONS) for protocol in PROTOCOLS}
    return Planned(name=f"refine-{REFINING_ITERATIONS}", family="trained, refined", training=training, plans=plans)


def _online(starts: int) -> Planned:
    plans = {protocol: replace(settings, starts=starts) for protocol, settings in ONLINE.items()}
    return Planned(name=f"icr-{starts}", plans=plans)


def _heuristic(name: str) -> Fixed:
    return Fixed(name=name, make=lambda experiment: heuristic_in(experiment.scenario, name))
