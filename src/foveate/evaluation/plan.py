"""Evaluate planners on the scenes and noise of policies: receding horizon, open loop, refined policy, omniscient."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from foveate.errors import InputError
from foveate.evaluation.detections import protocols_in, require_ids
from foveate.evaluation.evaluate import prepare
from foveate.evaluation.oracle import OnProgress, oracle_rows
from foveate.evaluation.planners import WINDOW, planner, planner_rows
from foveate.evaluation.report import Evaluation, evaluation, rows_by_protocol
from foveate.evaluation.rows import Row
from foveate.evaluation.summary import summarise
from foveate.experiment.experiment import Experiment
from foveate.experiment.resolve import NamedPolicy, experiment_from, subject_of
from foveate.io.validate import check_count
from foveate.models.problem import Problem
from foveate.names import Objective
from foveate.planning.receding import OpenLoop
from foveate.planning.shooting import OMNISCIENT, ONLINE, PUBLISHED, PlanSettings, refining
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene
from foveate.simulation.records import Policy


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """A planner and its budget; None stands for the planner's default.

    `refine`: steps of ascent from a policy's own actions, in place of the planner's starts. `window`: the most steps
    that a receding-horizon plan looks ahead.
    """

    refine: int | None = None
    starts: int | None = None
    iterations: int | None = None
    window: int | None = None
    omniscient: bool = False
    open_loop: bool = False

    def __post_init__(self) -> None:
        for name in ("starts", "iterations", "refine", "window"):
            check_count(getattr(self, name), name)
        if self.window is not None and (self.omniscient or self.open_loop):
            raise InputError(f"window {self.window}: only a receding-horizon plan has one")
        if self.omniscient and (self.open_loop or self.refine is not None):
            raise InputError("omniscient: takes no open loop and no refinement: it knows the future")
        if self.refine is not None and (self.open_loop or self.starts is not None or self.iterations is not None):
            raise InputError(f"refine {self.refine}: starts from the policy's actions: takes no other option of plans")

    @property
    def method(self) -> str:
        """Name in rows: icr as published, icr-16 from 16 starts, icr-open, refine-15."""
        if self.refine is not None:
            return f"refine-{self.refine}"
        starts = "" if self.starts is None else f"-{self.starts}"
        return f"icr{starts}{'-open' * self.open_loop}"

    def settings(self, protocol: str) -> PlanSettings:
        """The planner's settings under a protocol."""
        if self.refine is not None:
            return refining(protocol, self.refine)
        online = PUBLISHED if self.starts is None else ONLINE[protocol]
        settings = OMNISCIENT[protocol] if self.omniscient else online
        if self.open_loop:
            settings = replace(settings, iterations=OMNISCIENT[protocol].iterations)
        given = {"starts": self.starts, "iterations": self.iterations}
        return replace(settings, **{name: value for name, value in given.items() if value is not None})

    def check_team(self, problem: Problem) -> None:
        """Raise InputError for a plan that robots of a team cannot make each on its own."""
        name = "omniscient" if self.omniscient else self.method
        for_one = self.omniscient or self.open_loop or self.refine is not None
        if problem.team is not None and for_one:
            right = f"expected none with scenario.team.agents = {problem.team.agents}"
            raise InputError(f"{name}: {right}: its robots plan in receding horizon, each on its own beliefs")

    def planner(self, problem: Problem, protocol: str, policy: Policy | None, horizon: int) -> Policy:
        """The planner for episodes of `horizon` steps; `policy` is the one to refine."""
        if self.open_loop:
            return OpenLoop(problem, self.settings(protocol), horizon)
        return planner(problem, self.settings(protocol), horizon, self.window or WINDOW, policy)


def online_planner(method: str) -> PlanOptions | None:
    """Planner of the name icr, icr-STARTS or refine-STEPS; None for others. Raises InputError for a number below 1."""
    kind, dash, number = method.partition("-")
    if kind not in ("icr", "refine") or (dash and not number.isdecimal()) or (kind == "refine" and not dash):
        return None
    count = int(number) if dash else None
    return PlanOptions(refine=count) if kind == "refine" else PlanOptions(starts=count)


def planning_subject(
    experiment: Scenario | Experiment | str | Path, run: NamedPolicy | str | Path | None, refine: int | None
) -> tuple[Experiment, Policy | None, str | None, Objective | None]:
    """Resolve the experiment to plan in, the policy to refine, the name of the run, and the objective of training."""
    if refine is not None and run is None:
        raise InputError(f"refine {refine}: expected the policy to refine: give run")
    if run is None:
        settings = experiment_from(experiment)
        return settings, None, None, None if isinstance(experiment, Scenario) else settings.training.objective
    subject = subject_of(run)
    return subject.experiment, None if refine is None else subject.network(), subject.name, subject.objective


def evaluate_plans(
    experiment: Experiment,
    options: PlanOptions,
    scenes: Sequence[Scene],
    chosen: str,
    facts: dict[str, Any],
    *,
    protocols: Sequence[str],
    policy: Policy | None = None,
    episodes: int = 1,
    seed: int = 0,
    objective: Objective | None = None,
    quiet: bool = False,
) -> Evaluation:
    """Plan on every scene under each protocol: rows and summary as those of policies.

    `policy` is the one to refine, `chosen` the name of the scenes; rows are scored by the `objective`, too.
    """
    if options.omniscient or options.refine is not None:
        require_ids(experiment.scenario, "omniscient" if options.omniscient else f"refine {options.refine}")
    problem, scene_settings = experiment.scenario.problem(), experiment.scenario.scenes
    options.check_team(problem)
    protocols = protocols_in(experiment.scenario, protocols)
    suite = prepare(problem, scene_settings, scenes, seed, episodes, objective)

    def rows_of(protocol: str, on_progress: OnProgress) -> list[Row]:
        if options.omniscient:
            return oracle_rows(suite, protocol, on_progress, options.settings(protocol))
        policy_of = partial(options.planner, problem, protocol, policy)
        return planner_rows(suite, scene_settings, options.method, policy_of, protocol, on_progress)

    rows = rows_by_protocol("planning", len(scenes) * episodes, protocols, rows_of, quiet)
    summary = summarise(rows, problem.motion.state_size)
    facts = {"scenes": chosen, **facts, **asdict(options)}
    return evaluation(f"plans on {chosen}", facts, experiment, suite, rows, summary)
