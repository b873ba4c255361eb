"""SE(2) embedded in SE(3): a planar problem, episode and policy on the floor z = 0 of space.

They make statements about SE(3), such as Proposition 1, apply to planar robots.
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.geometry.fov_spatial import prism
from foveate.geometry.space import SPACES
from foveate.models.problem import Problem
from foveate.models.region import Region
from foveate.models.target import LinearGaussian
from foveate.simulation.records import Episode, Observation, Policy
from foveate.types import Action, Key

_AXES = (0, 1, 5)
"""Indices of v_x, v_y and w_z in a spatial twist."""


def embedded_problem(problem: Problem) -> Problem:
    """The planar problem in space: the view is unbounded along z, targets keep their states and are at z = 0.

    Raises InputError for a problem in space, and for a planar sensor with coordinates or noise of its own frame.
    """
    if problem.agent.space.dimension != 2:
        raise InputError("the problem is in space already: expected a planar one")
    if problem.sensor.frame == "body":
        raise InputError("sensor.frame = 'body': a planar V does not turn in space; expected 'world'")
    if problem.sensor.polar is not None:
        raise InputError("sensor.measures: a planar bearing is none in space; expected 'position'")
    agent, sensor, schedule = problem.agent, problem.sensor, problem.schedule
    if schedule is not None:
        schedule = replace(schedule, motion=_embedded_motion(schedule.motion))
    return replace(
        problem,
        agent=replace(agent, space=SPACES["spatial"], axes=tuple(_AXES[axis] for axis in agent.axes)),
        sensor=replace(sensor, view=prism(sensor.view)),
        motion=_embedded_motion(problem.motion),
        schedule=schedule,
        region=problem.region and _embedded_region(problem.region),
    )


def _embedded_region(region: Region) -> Region:
    return replace(region, low=jnp.append(region.low, -1.0), high=jnp.append(region.high, 1.0))


def _embedded_motion(motion: LinearGaussian) -> LinearGaussian:
    floor = jnp.zeros_like(motion.Z[..., :1, :])
    # Not by `replace`, whose check of shapes knows no schedule: there every matrix has a leading axis.
    return eqx.tree_at(lambda m: m.Z, motion, jnp.concatenate([motion.Z, floor], axis=-2))


def embedded_pose(pose: Float[Array, "3"]) -> Float[Array, "4 4"]:
    """The level pose at planar [x, y, yaw] and z = 0."""
    return SPACES["spatial"].upright(jnp.append(pose[:2], 0.0), pose[2])


def embedded_episode(episode: Episode) -> Episode:
    """A planar episode with its pose in space, otherwise unchanged."""
    return replace(episode, pose=embedded_pose(episode.pose))


class EmbeddedPolicy(Policy):
    """A planar policy that decides for a level body on the floor of space."""

    planar: Policy

    def _observation(self, observation: Observation) -> Observation:
        T = observation.pose
        return replace(observation, pose=jnp.stack([T[0, 3], T[1, 3], jnp.arctan2(T[1, 0], T[0, 0])]))

    def start(self, observation: Observation) -> Any:
        """The planar policy's memory."""
        return self.planar.start(self._observation(observation))

    def claims(self, observation: Observation, memory: Any) -> Float[Array, " n"]:
        """What the planar policy tells its team."""
        return self.planar.claims(self._observation(observation), memory)

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """The planar policy's action at [x, y, yaw]."""
        return self.planar(self._observation(observation), memory, key)
