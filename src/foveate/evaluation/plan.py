"""Evaluate planners on the scenes and noise of policies: receding horizon, open loop, refined policy, omniscient."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

from foveate.errors import InputError
from foveate.evaluation.evaluate import Row, prepare
from foveate.evaluation.oracle import OnProgress, oracle_rows
from foveate.evaluation.planners import WINDOW, planner, planner_rows
from foveate.evaluation.report import Evaluation, evaluation, rows_by_protocol
from foveate.evaluation.summary import summarise
from foveate.experiment.experiment import Experiment
from foveate.io.validate import check_count
from foveate.models.problem import Problem
from foveate.planning.receding import OpenLoop
from foveate.planning.shooting import OMNISCIENT, ONLINE, PUBLISHED, PlanSettings, refining
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

    def planner(self, problem: Problem, protocol: str, policy: Policy | None, horizon: int) -> Policy:
        """The planner for episodes of `horizon` steps; `policy` is the one to refine."""
        if self.open_loop:
            return OpenLoop(problem, self.settings(protocol), horizon)
        return planner(problem, self.settings(protocol), horizon, self.window or WINDOW, policy)


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
    quiet: bool = False,
) -> Evaluation:
    """Plan on every scene under each protocol: rows and summary as those of policies.

    `policy` is the one to refine, `chosen` the name of the scenes.
    """
    problem, scene_settings = experiment.scenario.problem(), experiment.scenario.scenes
    suite = prepare(problem, scene_settings, scenes, seed, episodes)

    def rows_of(protocol: str, on_progress: OnProgress) -> list[Row]:
        if options.omniscient:
            return oracle_rows(suite, protocol, on_progress, options.settings(protocol))
        policy_of = partial(options.planner, problem, protocol, policy)
        return planner_rows(suite, scene_settings, options.method, policy_of, protocol, on_progress)

    rows = rows_by_protocol("planning", len(scenes) * episodes, protocols, rows_of, quiet)
    summary = summarise(rows, problem.motion.state_size)
    facts = {"scenes": chosen, **facts, **asdict(options)}
    return evaluation(f"plans on {chosen}", facts, experiment, suite, rows, summary)
