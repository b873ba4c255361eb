"""A safety filter: any policy, slowed down so that the robot keeps its distance from obstacles."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.io.validate import require
from foveate.models.problem import Problem
from foveate.simulation.records import Observation, Policy
from foveate.types import Action, Key


def _network(policy: Any) -> Policy:
    """The policy in JAX, of a robot's policy or as it is."""
    found = getattr(policy, "network", policy)
    if not isinstance(found, Policy):
        raise InputError(f"policy = {str(policy)[:80]!r}: expected one of foveate.load or foveate.heuristic_policy")
    return found


class KeepOff(Policy):
    """Takes the actions of a `policy`, and shortens those whose arc would come too near to an obstacle.

    Guarantee: a robot that begins at least `keep_off_m` and its radius from all obstacles, and the margin of the grid
    (`geometry.sight.margin`, about a cell), never comes nearer than `keep_off_m` [m] and its radius, at any speed, as
    long as it executes its commands and the map is right; and so it never touches. The shortened action is a part of
    the same arc, since all axes are slowed down by one factor; where hardly a step is left the robot only turns.

    A policy of `foveate.load` is taken as its network, also one of an ONNX file. Raises InputError for what is no
    policy, a robot that cannot stand still, or has a set of commands, and for a problem without obstacles.
    """

    policy: Policy = eqx.field(converter=_network)
    problem: Problem
    keep_off_m: float = eqx.field(static=True)

    def __check_init__(self) -> None:
        self.problem.require_shortening()
        if not self.keep_off_m >= 0:
            raise InputError(f"keep_off_m = {self.keep_off_m}: expected >= 0")

    def start(self, observation: Observation) -> Any:
        """The memory of the policy."""
        return self.policy.start(observation)

    def claims(self, observation: Observation, memory: Any) -> Float[Array, " n"]:
        """What the policy tells its team."""
        return self.policy.claims(observation, memory)

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """The policy's action, shortened if need be."""
        action, memory = self.policy(observation, memory, key)
        return self.shortened(observation.pose, action, observation.step, observation.map_number), memory

    def shortened(self, pose: Any, action: Any, step: Any = 0, map_number: Any = None) -> Action:
        """The action as far as it is safe, also of a policy outside of foveate, as of an ONNX file.

        Args:
            pose: Pose of the robot, as in `Observation`.
            action: Normalised action, a number for each commanded axis.
            step: Number of the step, which matters with a schedule.
            map_number: Number of the robot's map; None: the first.

        Raises InputError for a pose or an action of another shape, and a map that there is not.
        """
        pose, action = jnp.asarray(pose, float), jnp.asarray(action, float)
        agent, obstacles = self.problem.agent, self.problem.obstacles
        shape = (3,) if agent.space.dimension == 2 else (4, 4)
        require(pose.shape == shape, "pose", pose, f"expected the shape {shape}")
        require(action.shape == agent.lower.shape, "action", action, f"expected {len(agent.lower)} numbers")
        if isinstance(map_number, int) and obstacles is not None:
            maps = obstacles.grid.maps
            require(0 <= map_number < maps, "map_number", map_number, f"expected 0 to {maps - 1}")
        number = None if map_number is None else jnp.asarray(map_number)
        problem = self.problem.at(jnp.asarray(step)).of_map(number)
        return problem.shortened(pose, action, self.keep_off_m)
