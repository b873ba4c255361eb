"""The robot as a policy may know it: the problem of one step, and the extent of the view."""

import equinox as eqx

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

    def at(self, step: Count) -> "Robot":
        """The robot at step k: the same where nothing changes."""
        return Robot(self.problem.at(step), self.extent)
