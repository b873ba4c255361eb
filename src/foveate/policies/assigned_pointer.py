"""The pointer network of a single robot in a team: each robot is shown its own targets only, by a rule."""

from typing import Any

import equinox as eqx
from jaxtyping import Array, Float, Int

from foveate.errors import InputError
from foveate.models.problem import Problem
from foveate.names import Assignment
from foveate.policies.assigned import first_share, own_share, told_of
from foveate.policies.pointer import PointerPolicy
from foveate.simulation.records import Observation


class AssignedPointer(PointerPolicy):
    """A pointer network that is shown the targets of its robot only; alone, as on a robot of its own, all of them.

    `rule` is as in `Assigned`.
    """

    rule: Assignment = eqx.field(static=True, default="auction")

    def start(self, observation: Observation) -> Any:
        """Assign before the first decision."""
        if observation.team is None:
            return ()
        return first_share(_problem(observation), self.rule, observation)[1]

    def shown(self, observation: Observation, memory: Any) -> tuple[Observation, Any]:
        """The observation of the robot's own targets, and the memory of which these are."""
        if observation.team is None:
            return observation, memory
        return own_share(_problem(observation), self.rule, observation, memory)

    def claims(self, observation: Observation, memory: Any) -> Float[Array, " n"]:
        """What the robots tell each other so that all assign alike."""
        if observation.team is None:
            return super().claims(observation, memory)
        return told_of(self.rule, memory)

    def claimed(self, observation: Observation, memory: Any, mode: Int[Array, ""]) -> Any:
        """The memory of what was `shown`: no decision changes whose a target is."""
        return memory


def _problem(observation: Observation) -> Problem:
    if observation.robot is None:
        raise InputError("observation.robot = None: expected the robot, which this policy asks for")
    return observation.robot.problem
