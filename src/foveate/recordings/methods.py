"""Methods of a replay by their names: the policy, heuristics, and planners in receding horizon."""

from collections.abc import Sequence
from typing import cast

from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.evaluation.plan import online_planner
from foveate.experiment.resolve import Subject
from foveate.names import ASSIGNMENTS, METHODS, SEARCHERS, Assignment
from foveate.planning.named import assigned_in
from foveate.simulation.records import Policy

PROTOCOL = "true"
"""Measurements of a recording are real ones: planners plan for these."""


def replay_methods(method: str | Sequence[str], has_ids: bool = True) -> tuple[str, ...]:
    """Methods' names, each once; "all" are the policy and all heuristics. Raises InputError for an unknown name.

    Those that search are of detections without ids, and NAME+RULE assigns targets to the robots of a team.
    """
    known = METHODS if has_ids else (*METHODS, *SEARCHERS)
    names: list[str] = []
    for name in [method] if isinstance(method, str) else method:
        one, plus, rule = name.partition("+")
        if name == "all":
            names += known
        elif (one in known or online_planner(one) is not None) and (not plus or rule in ASSIGNMENTS):
            names.append(name)
        else:
            team = f"in a team also NAME+RULE with {', '.join(ASSIGNMENTS)}"
            right = f"{', '.join(known)}, all, {team}, or a planner: icr, icr-STARTS, refine-STEPS"
            raise InputError(f"method {name!r}: expected one of {right}")
    return tuple(dict.fromkeys(names))


def method_in(subject: Subject, name: str, box_world: Float[Array, "2 d"], steps: int) -> Policy:
    """The policy, heuristic or planner of a name, for a replay of this number of steps in a box [m].

    Raises InputError for an assignment without a team, and for the refinement of a policy in one.
    """
    one, _, rule = name.partition("+")
    options = online_planner(one)
    if options is None:
        return subject.policy(name, box_world)
    scenario = subject.experiment.scenario
    problem = scenario.problem()
    options.check_team(problem)
    refined = None if options.refine is None else subject.network()
    planner = options.planner(problem, PROTOCOL, refined, steps)
    return assigned_in(scenario, planner, cast(Assignment, rule)) if rule else planner
