"""The robot as a policy may know it: the problem of one step, the extent of the view, and what is around it."""

import equinox as eqx
from jaxtyping import Array, Bool, Float

from foveate.geometry.fov import Extent
from foveate.models.problem import Problem
from foveate.types import Count


class Robot(eqx.Module):
    """Limits, control period, sensor and the targets' motion at one step, and how far the view reaches.

    A policy that reads them, and not constants of its training, serves other robots too.
    """

    problem: Problem
    extent: Extent

    @classmethod
    def of(cls, problem: Problem) -> "Robot":
        """The robot of a problem."""
        return cls(problem, problem.sensor.view.extent)

    @property
    def map_number(self) -> Count | None:
        """Number of the robot's map; None without obstacles."""
        return None if self.problem.obstacles is None else self.problem.obstacles.grid.index

    def at(self, step: Count) -> "Robot":
        """The robot at step k: the same where nothing changes."""
        return Robot(self.problem.at(step), self.extent)


class Surroundings(eqx.Module):
    """What a robot may be told of obstacles: `ranges` along its rays [m], and what is between it and each target.

    `place_world` [m] is where to drive next, in a straight line, on the way to where a target is believed to be, and
    `length` [m] that of the whole way; it `is_straight` where the place is the target's. `is_seen` where no obstacle is
    on the line to it. See `geometry.ways`.
    """

    ranges: Float[Array, " rays"]
    place_world: Float[Array, "n d"]
    length: Float[Array, " n"]
    is_straight: Bool[Array, " n"]
    is_seen: Bool[Array, " n"]
