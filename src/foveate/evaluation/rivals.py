"""What a verdict compares besides the planner: the policy and every heuristic, in a team also with assigned targets."""

from collections.abc import Sequence

from foveate.experiment.experiment import Experiment
from foveate.names import ASSIGNMENTS, HEURISTICS, SEARCHERS, Assignment
from foveate.planning.named import assigned_in, heuristic_in
from foveate.policies.assigned_pointer import AssignedPointer
from foveate.simulation.records import Policy

ASSIGNED = ("uncertain", "price", "window")
"""Heuristics that are also assigned targets in a team: in each of the suite's teams one of them is the best."""


def compared(experiment: Experiment, policy: Policy) -> dict[str, Policy]:
    """The policy, as "policy", and all that it is compared with besides a planner, by name."""
    return policies_of(experiment, policy) | heuristics_of(experiment)


def policies_of(experiment: Experiment, policy: Policy) -> dict[str, Policy]:
    """The policy by the name "policy", and in a team as "policy+RULE" for every rule, unless it has one of its own."""
    if isinstance(policy, AssignedPointer):
        return {"policy": policy}
    return {"policy": policy} | _assigned(experiment, {"policy": policy}, ("policy",))


def heuristics_of(experiment: Experiment) -> dict[str, Policy]:
    """Every heuristic by its name, for the robot of an experiment; in a team those of ASSIGNED also as "NAME+RULE"."""
    scenario = experiment.scenario
    names = HEURISTICS if scenario.detections is None else (*HEURISTICS, *SEARCHERS)
    found = {name: heuristic_in(scenario, name) for name in names}
    return found | _assigned(experiment, found, ASSIGNED)


def _assigned(experiment: Experiment, policies: dict[str, Policy], names: Sequence[str]) -> dict[str, Policy]:
    """The policies of these names with assigned targets; none without a team, and where detections have no ids."""
    scenario = experiment.scenario
    if scenario.detections is not None or scenario.problem().team is None:
        return {}
    pairs: list[tuple[str, Assignment]] = [(name, rule) for name in names for rule in ASSIGNMENTS]
    return {f"{name}+{rule}": assigned_in(scenario, policies[name], rule) for name, rule in pairs}
