"""What is compared: ways to decide, each a small record that turns scenes into rows.

Your own method is one more record. A policy that needs no training: `Fixed(name="mine", make=...)`, where `make` builds
it for an experiment's world. One that a foveate experiment trains: `Learned(name="mine", training=Training(...))`.
Anything else: a subclass of `Method` with its `rows`. `examples/own_method.py` is one, whole.
"""

import abc
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from typing import Any

from foveate.errors import InputError
from foveate.evaluation.bounds import oracle_rows
from foveate.evaluation.evaluate import Row, Suite, evaluate
from foveate.evaluation.planners import planner, planner_rows
from foveate.experiment.experiment import Experiment, with_learner
from foveate.experiment.learners import ActorCriticSettings
from foveate.experiment.presets import PPO, PRESETS
from foveate.names import HEURISTICS
from foveate.planning.shooting import OMNISCIENT, ONLINE, PUBLISHED, PlanSettings, refining
from foveate.policies.heuristics import heuristic
from foveate.simulation.records import PROTOCOLS, Policy

Report = Callable[[int], None]
"""Called with the number of episodes that are done."""


@dataclass(frozen=True, kw_only=True)
class Bench:
    """What every method meets alike: the world, scenes of it, and the chance in them."""

    world: Experiment
    suite: Suite


@dataclass(frozen=True, kw_only=True)
class Training:
    """Where a policy comes from: an experiment, trained once for every training seed by its own algorithm."""

    name: str
    experiment: Experiment


@dataclass(frozen=True, kw_only=True)
class Method(abc.ABC):
    """One way to decide. With a `training` there is one policy, and one set of rows, for every training seed.

    Raise `revision` when what the method does has changed, so that its rows are made anew: a program sees a change of
    its settings, not one of its code.
    """

    name: str
    family: str
    """How figures group it."""
    training: Training | None = None
    revision: int = 1

    @abc.abstractmethod
    def rows(self, bench: Bench, protocol: str, policy: Policy | None, report: Report) -> list[Row]:
        """One row an episode; `policy` is the trained one, where the method has a training."""

    def settings(self, protocol: str) -> dict[str, Any]:
        """What else the rows depend on, as JSON."""
        return {}


@dataclass(frozen=True, kw_only=True)
class Acting(Method):
    """A policy, run in an evaluation."""

    @abc.abstractmethod
    def policy(self, world: Experiment, trained: Policy | None) -> Policy:
        """The policy, for a world; `trained` is what its training gave, if it has one."""

    def rows(self, bench: Bench, protocol: str, policy: Policy | None, report: Report) -> list[Row]:
        """The rows of an evaluation."""
        return evaluate(bench.suite, self.name, self.policy(bench.world, policy), (protocol,))


@dataclass(frozen=True, kw_only=True)
class Learned(Acting):
    """A trained policy as it is."""

    family: str = "trained"

    def policy(self, world: Experiment, trained: Policy | None) -> Policy:
        """What was trained."""
        if trained is None:
            raise InputError(f"method {self.name}: has no training: expected Learned(training=Training(..))")
        return trained


@dataclass(frozen=True, kw_only=True)
class Fixed(Acting):
    """A policy without training; `make` builds it for a world."""

    make: Callable[[Experiment], Policy]
    family: str = "made by hand"

    def policy(self, world: Experiment, trained: Policy | None) -> Policy:
        """What was made."""
        return self.make(world)


@dataclass(frozen=True, kw_only=True)
class Planned(Method):
    """A new plan at every step; with a training, one that begins at what the trained policy would do."""

    plans: Mapping[str, PlanSettings]
    family: str = "planned"

    def rows(self, bench: Bench, protocol: str, policy: Policy | None, report: Report) -> list[Row]:
        """The rows of plans in receding horizon."""
        suite = bench.suite
        return planner_rows(
            suite.problem,
            bench.world.scenario.scenes,
            suite.scenes,
            self.name,
            lambda horizon: planner(suite.problem, self.plans[protocol], horizon, policy=policy),
            protocol,
            suite.seed,
            suite.episodes_per_scene,
            report,
        )

    def settings(self, protocol: str) -> dict[str, Any]:
        """How the plans are made."""
        return asdict(self.plans[protocol])


@dataclass(frozen=True, kw_only=True)
class Omniscient(Method):
    """The planner that knows the future: what normalised_score is measured by."""

    name: str = "omniscient"
    family: str = "omniscient"

    def rows(self, bench: Bench, protocol: str, policy: Policy | None, report: Report) -> list[Row]:
        """The rows of its plans, made here or kept."""
        return oracle_rows(bench.suite, protocol, report)

    def settings(self, protocol: str) -> dict[str, Any]:
        """How the plans are made."""
        return asdict(OMNISCIENT[protocol])


LEARNERS = ("paper", "best", *PPO)
"""Presets that the paper's suite compares, and the paper's trained by PPO, where that is installed."""


QUICK_LEARNERS = ("paper", "ppo")


QUICK_EPOCHS, QUICK_STEPS, QUICK_TRIES = 300, 40_000, 40
"""Epochs of the policy gradient, steps of PPO, epochs of who learns by trying."""


STARTS, QUICK_STARTS = (1, 4, 16, 64), ()
"""Budgets of the planner that plans anew at every step."""


REFINED_BY = 15


def paper_methods(quick: bool = False) -> tuple[Method, ...]:
    """All that is compared on the paper's table: learners, the reference refined, planners, hands, the yardstick."""
    trainings = [_training(name, quick) for name in (QUICK_LEARNERS if quick else LEARNERS) if can_train(name)]
    refined = next(training for training in trainings if training.name == reference(quick))
    return (
        Omniscient(),
        *(Learned(name=training.name, training=training) for training in trainings),
        _refined(refined),
        Planned(name="icr", plans=dict.fromkeys(PROTOCOLS, PUBLISHED)),
        *(
            Planned(name=f"icr-{starts}", plans={name: replace(plan, starts=starts) for name, plan in ONLINE.items()})
            for starts in (QUICK_STARTS if quick else STARTS)
        ),
        *(_by_hand(name) for name in HEURISTICS),
    )


def _refined(training: Training) -> Planned:
    """A trained policy, improved by a planner at every step."""
    plans = {protocol: refining(protocol, REFINED_BY) for protocol in PROTOCOLS}
    return Planned(name=f"refine-{REFINED_BY}", family="trained, refined", training=training, plans=plans)


TRUE_VIEW = "true-view"
"""The preset for the true field of view: what its suite is about."""


CHANGED_WORLDS = ("omniscient", TRUE_VIEW, "uncertain", "nearest")
"""Methods of the true view's suite that are run in changed worlds, too."""


def true_view_methods(quick: bool = False) -> tuple[Method, ...]:
    """All that is compared where a target counts only when it is really seen."""
    icr, many = PUBLISHED, replace(ONLINE["true"], starts=16)
    paper, ours = (_training(name, quick) for name in ("paper", TRUE_VIEW))
    return (
        Omniscient(),
        *(Learned(name=training.name, training=training) for training in (paper, ours)),
        *(() if quick else (_refined(ours),)),
        *(Planned(name=name, plans={"true": plan}) for name, plan in (("icr", icr), ("icr-16", many)) if not quick),
        *(_by_hand(name) for name in HEURISTICS),
    )


def reference(quick: bool = False) -> str:
    """What every method is compared with, and what is refined: fixed before any result is seen."""
    return "paper" if quick else "best"


def _training(name: str, quick: bool) -> Training:
    """A learner; a quick one is cut short."""
    experiment = with_learner(PRESETS["paper"], PPO[name]) if name in PPO else PRESETS[name]
    if quick:
        training = experiment.training
        epochs = QUICK_TRIES if isinstance(training, ActorCriticSettings) else QUICK_EPOCHS
        short = {"steps": QUICK_STEPS} if name in PPO else {"epochs": epochs}
        experiment = replace(experiment, training=replace(training, **short))
    return Training(name=name, experiment=experiment)


def can_train(name: str) -> bool:
    """Whether what a learner needs is installed."""
    return name not in PPO or find_spec("stable_baselines3") is not None


def _by_hand(name: str) -> Fixed:
    def make(world: Experiment) -> Policy:
        return heuristic(name, world.scenario.problem(), float(world.scenario.view.depth_m))

    return Fixed(name=name, make=make)
