"""The problem: agent, sensor and motion of the targets, and its schedule over the steps."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from foveate.errors import InputError
from foveate.geometry import sight
from foveate.geometry.space import Space
from foveate.models.agent import Agent
from foveate.models.bodies import Bodies, share_clear
from foveate.models.detections.records import DetectionModel
from foveate.models.obstacles import Obstacles
from foveate.models.region import Region
from foveate.models.sensor import Sensor
from foveate.models.target import LinearGaussian
from foveate.models.team import Team
from foveate.types import Action, Count, Flag, Information, Point, Pose, Scalar, Twist

TURN_BELOW = 0.05
"""A robot that may do less than this share of its step turns on the spot as it was told to, and does not move."""


class Schedule(eqx.Module):
    """Values that change from step to step: tau_k [s], the targets' motion and the sensor's V.

    Each has a leading axis, of which step k takes entry k modulo its length.
    """

    tau: Float[Array, " period"]
    motion: LinearGaussian
    V: Float[Array, "period n_z n_z"]


class Problem(eqx.Module):
    """Agent, sensor, motion of the targets, control period tau [s] and first information matrix.

    A `schedule` overrides them from step to step. The `region` has the borders of the world, and `keep_off_m` is the
    distance that the agent keeps from targets [m], if any; `obstacles` has the maps, one of them chosen. With
    `detections` measurements do not say of which target they are.
    A `team` has more robots like the agent, and their radio.
    """

    agent: Agent
    sensor: Sensor
    motion: LinearGaussian
    tau: Scalar
    prior_information: Information
    schedule: Schedule | None = None
    region: Region | None = None
    keep_off_m: Scalar | None = None
    obstacles: Obstacles | None = None
    detections: DetectionModel | None = None
    team: Team | None = None

    def move(self, pose: Pose, action: Action, bodies: Bodies | None) -> Pose:
        """The pose after one action, which borders and obstacles may end, and bodies that the agent keeps off."""
        action = self.kept_off(pose, action)
        after = self.agent.move(pose, action, self.tau)
        if self.bounds_agent:
            after = self.within_region(pose, after)
        if bodies is not None:
            after = self.clear_of(pose, after, bodies)
        if self.obstacles is not None:
            after, _ = self.among_obstacles(pose, action, after)
        return after

    def of_map(self, number: Count | None) -> "Problem":
        """The problem among the obstacles of one map; itself where there are none."""
        if self.obstacles is None or number is None:
            return self
        return replace(self, obstacles=self.obstacles.of_map(number))

    def of_robot(self, number: Count | int) -> "Problem":
        """The problem of one robot of a team, with its own agent and sensor; itself where all are alike.

        Before `at`, which chooses a step of the schedule.
        """
        if self.team is None or self.team.kinds is None:
            return self
        agent, sensor, V = self.team.kinds.of_robot(number)
        schedule = self.schedule if V is None or self.schedule is None else replace(self.schedule, V=V)
        return replace(self, agent=agent, sensor=sensor, schedule=schedule)

    @property
    def kinds(self) -> tuple["Problem", ...]:
        """The problem of each kind of robot, all of its team like it; itself where all are alike."""
        if self.team is None or self.team.kinds is None:
            return (self,)
        alike = replace(self.team, kinds=None)
        return tuple(replace(self.of_robot(i), team=alike) for i in range(len(self.team.kinds.depth_m)))

    def of_one_kind(self) -> "Problem":
        """Itself, for what decides for one robot. Raises InputError for a team of different robots."""
        if len(self.kinds) > 1:
            how = "Scenario.of_robot(number), RobotPolicy.for_robot(number), or export --robot NUMBER"
            raise InputError(f"scenario.team.robots: expected the scenario of one robot: {how}")
        return self

    def sees(
        self, pose: Pose, positions_world: Float[Array, "n d"], asked: Bool[Array, " n"] | None = None
    ) -> Bool[Array, " n"]:
        """Positions [m] in view that no obstacle hides, among those asked for."""
        space = self.agent.space
        in_view = self.sensor.view.contains(space.to_body(pose, positions_world))
        in_view = in_view if asked is None else in_view & asked
        if self.obstacles is None:
            return in_view
        return self.obstacles.sees(space.position(pose), positions_world, in_view)

    @property
    def bounds_agent(self) -> bool:
        """True if the agent keeps borders."""
        return self.region is not None and self.region.agent != "free"

    @property
    def bounds_targets(self) -> bool:
        """True if the targets keep borders."""
        return self.region is not None and self.region.targets != "free"

    @property
    def turns_targets(self) -> bool:
        """True if the targets keep out of obstacles."""
        return self.obstacles is not None and self.obstacles.targets == "around"

    def inside(self, positions_world: Float[Array, "*n d"], bounded: bool) -> Float[Array, "*n d"]:
        """Positions, those beyond a border moved onto it if they are `bounded`."""
        if self.region is None or not bounded:
            return positions_world
        return jnp.clip(positions_world, self.region.low, self.region.high)

    def within_region(self, before: Pose, after: Pose) -> Pose:
        """The pose after a step that ends at a border, if it crosses one."""
        assert self.region is not None, "for problems with a region"
        start, end = self._ends(before, after)
        return self._stopped(before, after, self.region.share_inside(start, end))

    def clear_of(self, before: Pose, after: Pose, bodies: Bodies) -> Pose:
        """The pose after a step that ends `keep_off_m` before the first body in its way."""
        assert self.keep_off_m is not None, "for problems with a distance to keep"
        start, end = self._ends(before, after)
        return self._stopped(
            before, after, share_clear(start, end, bodies.positions_world, bodies.present, self.keep_off_m)
        )

    def among_obstacles(self, before: Pose, action: Action, after: Pose) -> tuple[Pose, Flag]:
        """The pose after an action that led from `before` to `after`, ended at the first contact, and true for one.

        The way is the action's arc; or the straight line to `after`, where borders or targets may have ended it.
        """
        assert self.obstacles is not None, "for problems with obstacles"
        space, ends = self.agent.space, self._ends(before, after)
        if self.bounds_agent or self.keep_off_m is not None:
            length = jnp.linalg.norm(ends[1] - ends[0])
            place, touches = self.obstacles.first_contact(_straight, ends, length)
        else:
            arc = before, self.tau * self.agent.twist(action)
            way = partial(along_arc, space)
            place, touches = self.obstacles.first_contact(way, arc, _length(space, arc[1]))
        return space.placed(after, jnp.where(touches, place, ends[1])), touches

    def kept_off(self, pose: Pose, action: Action) -> Action:
        """The action, shortened so that the agent keeps its distance from obstacles, if it has one to keep."""
        if self.obstacles is None or self.obstacles.keep_off is None:
            return action
        return self.shortened(pose, action, self.obstacles.keep_off)

    def shortened(self, pose: Pose, action: Action, keep_off_m: Scalar | float) -> Action:
        """The action as far as the agent stays `keep_off_m` [m] and its radius from obstacles: all axes slowed alike.

        That is a part of the same arc; where hardly a step is left the agent only turns.
        """
        assert self.obstacles is not None, "for problems with obstacles"
        agent, space = self.agent, self.agent.space
        control, displacement = agent.control(action), self.tau * agent.twist(action)
        length, radius = _length(space, displacement), self.obstacles.radius + keep_off_m
        way = partial(along_arc, space)
        share, touches = sight.share_free(self.obstacles.grid, way, (pose, displacement), length, radius)
        turns = jnp.array([axis >= space.dimension for axis in agent.axes])
        allowed = jnp.where(share > TURN_BELOW, share * control, jnp.where(turns, control, 0.0))
        return jnp.where(touches, agent.action(allowed), jnp.clip(action, -1.0, 1.0))

    def require_shortening(self) -> None:
        """Raise InputError unless `shortened` can keep a distance: ways are arcs, and the agent can stand still."""
        agent = self.agent
        if self.obstacles is None:
            raise InputError("problem.obstacles = None: expected a scenario with obstacles")
        if agent.commands is not None:
            raise InputError("agent.commands: expected none, as a command may have no slower one")
        if self.bounds_agent or self.keep_off_m is not None:
            raise InputError("region.agent: expected 'free', and no scenario.keep_off_m: the way must be the arc")
        if not ((np.asarray(agent.lower) <= 0) & (np.asarray(agent.upper) >= 0)).all():
            raise InputError("agent: expected limits that allow to stand still, 0 on every axis")

    def _ends(self, before: Pose, after: Pose) -> tuple[Point, Point]:
        return self.agent.space.position(before), self.agent.space.position(after)

    def _stopped(self, before: Pose, after: Pose, share: Scalar) -> Pose:
        start, end = self._ends(before, after)
        # Not start + share (end - start) where nothing stops the agent, which would round.
        return self.agent.space.placed(after, jnp.where(share < 1.0, start + share * (end - start), end))

    def at(self, step: Count) -> "Problem":
        """The problem of step k alone, with tau_k, A, B, W_k and V_k, and without a schedule."""
        if self.schedule is None:
            return self
        entry = jax.tree.map(lambda part: part[step % len(part)], self.schedule)
        sensor = replace(self.sensor, V=entry.V)
        return replace(self, tau=entry.tau, motion=entry.motion, sensor=sensor, schedule=None)

    @property
    def period(self) -> Schedule:
        """The schedule, of one entry where nothing changes."""
        if self.schedule is not None:
            return self.schedule
        motion = jax.tree.map(lambda part: part[None], self.motion)
        return Schedule(self.tau[None], motion, self.sensor.V[None])

    def step_lengths_s(self, steps: int) -> Float[np.ndarray, " K"]:
        """tau_0 .. tau_{K-1} [s]."""
        tau = np.asarray(self.period.tau, float)
        return tau[np.arange(steps) % len(tau)]


def _straight(ends: tuple[Point, Point], share: Scalar) -> Point:
    return ends[0] + share * (ends[1] - ends[0])


def _length(space: Space, displacement: Twist) -> Scalar:
    """Length of an arc [m], with a derivative also where it is 0."""
    return jnp.sqrt(jnp.maximum(jnp.sum(displacement[: space.dimension] ** 2), 1e-18))


def along_arc(space: Space, arc: tuple[Pose, Twist], share: Scalar) -> Point:
    """Position at a share of the arc of a pose and its displacement in the body frame."""
    return space.position(space.move(arc[0], share * arc[1]))


def first_information(problem: Problem, targets: int) -> Float[Array, "n n_y n_y"]:
    """Y_0 of every target."""
    size = problem.motion.state_size
    return jnp.broadcast_to(problem.prior_information, (targets, size, size))
