"""A team whose detections have no ids: populations that hear the scans of several robots, one after another.

Scans of a step are independent given the targets, so that the filter takes them in turn: each is the update of a single
robot's filter, from that robot's pose and by its sensor.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Float

from foveate.models.detections import filter as pmb
from foveate.models.detections.records import Population, Scan
from foveate.models.problem import Problem
from foveate.simulation.draft import Draft
from foveate.simulation.records import State
from foveate.simulation.scans import shown
from foveate.types import Count


def in_turn(
    problem: Problem, population: Population, poses: Float[jax.Array, "M ..."], scans: Scan, number: Count
) -> Population:
    """The population after the scans of all robots, of step `number`; `scans` has a leading axis of M."""
    model = problem.detections
    assert model is not None, "for problems with detections"

    def hear(population: Population, entry: tuple) -> tuple[Population, None]:
        robot, pose, scan = entry
        return pmb.update(problem.of_robot(robot).at(number), model, population, pose, scan), None

    return jax.lax.scan(hear, population, (jnp.arange(len(poses)), poses, scans))[0]


def central_after(problem: Problem, predicted: State, drafts: Draft) -> State:
    """The filter that hears every scan, after a step; `predicted` is the same before the scans.

    Its pose is that of the first robot, and it counts what any robot has dropped.
    """
    robots, number = drafts.state, predicted.step
    assert predicted.population is not None, "of detections without ids"
    assert drafts.scan is not None, "of detections without ids"
    assert robots.dropped is not None, "`start` counts them"
    population = in_turn(problem, predicted.population, robots.pose, drafts.scan, number)
    after = replace(predicted, step=number + 1, pose=robots.pose[0], dropped=jnp.sum(robots.dropped))
    return shown(problem, after, population)


def of_first(robots: State) -> State:
    """The state of the first robot."""
    return jax.tree.map(lambda x: x[0], robots)


def with_tracks_of(robots: State, one: State) -> State:
    """The robots (leading axis M), all with the tracks and undetected targets of one state."""
    shared = {name: getattr(one, name) for name in ("mean", "information", "present", "population")}
    return jax.vmap(lambda robot: replace(robot, **shared))(robots)
