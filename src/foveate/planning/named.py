"""Heuristics by their names, those that simulate their commands among them."""

from dataclasses import replace

import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.io.validate import require
from foveate.models.problem import Problem
from foveate.names import HEURISTICS, SEARCHERS, Assignment
from foveate.policies.assigned import Assigned, require_common_tracks
from foveate.policies.assigned_pointer import AssignedPointer
from foveate.policies.by_kind import ByKind, by_kind
from foveate.policies.heuristics import Lawnmower, Nearest, Random, Still, Uncertain
from foveate.policies.lookahead import LookAhead
from foveate.policies.rules import Post, Price
from foveate.policies.search import Alternate, Explore
from foveate.policies.window import DynamicWindow
from foveate.scenario.scenario import Scenario
from foveate.simulation.records import Policy


def heuristic_policy(
    name: str, problem: Problem, depth_m: float, box_world: Float[Array, "2 d"] | None = None
) -> Policy:
    """Make the heuristic of a name in JAX; raises InputError for an unknown one.

    Followers stop at half of `depth_m`, the depth of the view [m]. `box_world` is the low and high corner [m] of the
    box that the lawnmower sweeps, and in which the post is; None takes that of the initial beliefs, or that of the grid
    of undetected targets. In a team of several kinds of robots each has the heuristic of its own limits and view, whose
    depth is that of its kind.
    """
    if problem.team is not None and problem.team.kinds is not None:
        depths_m = problem.team.kinds.depth_m
        own = (heuristic_policy(name, *each, box_world) for each in zip(problem.kinds, depths_m, strict=True))
        return by_kind(tuple(own))
    if problem.detections is not None and box_world is None:
        box_world = jnp.stack([problem.detections.grid.low, problem.detections.grid.high])
    # Half the depth keeps a target in the middle of the view, whichever way it moves.
    policies: dict[str, Policy] = {
        "random": Random(problem),
        "still": Still(problem),
        "nearest": Nearest(problem, 0.5 * depth_m),
        "uncertain": Uncertain(problem, 0.5 * depth_m),
        "lawnmower": Lawnmower(problem, 0.0, box_world),
        "price": Price(problem, 0.5 * depth_m),
        "window": DynamicWindow(problem, 0.5 * depth_m),
        "post": Post(problem, depth_m, box_world),
    }
    if problem.detections is not None:
        searchers = {"explore": Explore(problem, 0.0), "alternate": Alternate(problem, 0.0)}
        policies |= {**searchers, "lookahead": LookAhead(problem)}
    elif name in SEARCHERS:
        raise InputError(f"method {name!r}: expected a scenario with detections without ids: scenario.detections")
    if name not in policies:
        raise InputError(f"method {name!r}: expected one of {', '.join(HEURISTICS)}")
    return policies[name]


def heuristic_in(scenario: Scenario, name: str, box_world: Float[Array, "2 d"] | None = None) -> Policy:
    """Make a heuristic for a scenario, with the box [m] of `lawnmower` and `post`. Raises as `heuristic_policy`."""
    return heuristic_policy(name, scenario.problem(), float(scenario.of_robot(0).view.depth_m), box_world)


def assigned_in(scenario: Scenario, policy: Policy, rule: Assignment) -> Policy:
    """The policy, shown the targets of its robot only, by a rule: in place of its own, if it has one.

    Raises InputError for a single robot, and where detections have no ids for a radio by which not all have the same
    tracks, and for `explore`, which follows none.
    """
    problem = scenario.problem()
    require(problem.team is not None, "method", f"+{rule}", "expected none: the scenario has no team")
    require_common_tracks(problem, "method", f"+{rule}")
    if problem.detections is not None:
        own = policy.rest if isinstance(policy, ByKind) else policy
        follows = isinstance(own, Alternate) or not isinstance(own, Explore)
        require(follows, "method", f"explore+{rule}", "expected none: explore goes to places, not to targets")
    if isinstance(policy, AssignedPointer):  # one rule: another within it would take its targets for all
        return replace(policy, rule=rule)
    return Assigned(policy=policy, problem=problem, rule=rule)
