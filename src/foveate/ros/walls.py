"""A robot's map in a node: what its policy is told of it, and a filter that keeps every command off its walls."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.io.occupancy import OccupancyGrid
from foveate.models.problem import Problem
from foveate.policies.heuristics import Still
from foveate.policies.keep_off import KeepOff
from foveate.ros.model import Decide, RobotModel
from foveate.scenario.obstacle_grids import map_nodes, occupied_cells
from foveate.scenario.obstacles import BaseObstacles


class Walls(NamedTuple):
    """The decisions of a policy in a map, the filter of its commands, and the cells that both take for walls."""

    decide: Decide
    keep_off: KeepOff
    cells: OccupancyGrid

    def shortened(self, pose: Float[np.ndarray, "3"], command: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """The command [m/s, rad/s] as far as it is safe from a pose."""
        return np.asarray(_shortened(self.keep_off, jnp.asarray(pose, float), jnp.asarray(command, float)), float)


@eqx.filter_jit
def _shortened(keep_off: KeepOff, pose: Float[Array, "3"], command: Float[Array, " m"]) -> Float[Array, " m"]:
    agent = keep_off.problem.agent
    return agent.control(keep_off.shortened(pose, agent.action(command)))


def walls_of(model: RobotModel, grid: OccupancyGrid, radius_m: float, keep_off_m: float) -> Walls:
    """The walls of a map, for a robot of this radius that keeps `keep_off_m` [m] more off them.

    It compiles, which takes seconds for the first map of a size. Raises InputError for a robot that flies, one that
    `KeepOff` cannot serve, and a map without room for it.
    """
    scenario = model.scenario
    if scenario.dimension != 2:
        raise InputError("a robot in space: expected one that drives, for a map of the plane")
    settings = BaseObstacles(robot_radius_m=radius_m, targets="free", keep_off_m=keep_off_m)
    nodes = map_nodes(grid)
    obstacles = settings.among(nodes, float(scenario.view.depth_m))
    problem = replace(scenario.problem(), obstacles=obstacles)
    decide = model.decide if model.in_map is None else model.in_map(obstacles)
    walls = Walls(decide, KeepOff(Still(problem), problem, keep_off_m), occupied_cells(nodes))
    walls.shortened(np.zeros(3), np.zeros(len(model.axes)))
    return walls


def own_cells(problem: Problem) -> OccupancyGrid | None:
    """The cells that are walls in a problem of one map of the plane; None without obstacles, and of random maps."""
    obstacles = problem.obstacles
    if obstacles is None or problem.agent.space.dimension != 2 or obstacles.grid.maps != 1:
        return None
    return occupied_cells(obstacles.grid.nodes())
