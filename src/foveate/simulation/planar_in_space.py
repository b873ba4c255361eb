"""The plane as a part of space: a planar problem, episode and policy as the same ones on the floor of space.

What is proved or written down for SE(3), such as Proposition 1, holds for a planar robot through these.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.errors import InputError
from foveate.geometry.fov_spatial import prism
from foveate.geometry.space import SPACES
from foveate.models.agent import Agent
from foveate.models.problem import Problem, Schedule
from foveate.models.sensor import Sensor
from foveate.models.target import LinearGaussian
from foveate.simulation.records import Episode, Observation, Policy
from foveate.types import Action, Key

_AXES = (0, 1, 5)
"""Where v_x, v_y and w_z of a planar twist stand in a spatial one."""


def embedded_problem(problem: Problem) -> Problem:
    """The planar problem in space: the view without end along z, targets with the states they have, at z = 0.

    Raises ValueError for a problem in space, and for sensor noise given in the body frame: it is planar.
    """
    if problem.agent.space.dimension != 2:
        raise InputError("the problem is in space already: expected a planar one")
    if problem.sensor.frame == "body":
        raise InputError("sensor.frame = 'body': a planar V does not turn in space; expected 'world'")
    agent, sensor, schedule = problem.agent, problem.sensor, problem.schedule
    if schedule is not None:
        schedule = Schedule(schedule.tau, _embedded_motion(schedule.motion), schedule.V)
    return Problem(
        agent=Agent(SPACES["spatial"], tuple(_AXES[axis] for axis in agent.axes), agent.lower, agent.upper),
        sensor=Sensor(sensor.H, sensor.V, prism(sensor.view), sensor.range_growth, sensor.frame),
        motion=_embedded_motion(problem.motion),
        tau=problem.tau,
        prior_information=problem.prior_information,
        schedule=schedule,
    )


def _embedded_motion(motion: LinearGaussian) -> LinearGaussian:
    floor = jnp.zeros_like(motion.Z[..., :1, :])
    return eqx.tree_at(lambda m: m.Z, motion, jnp.concatenate([motion.Z, floor], axis=-2))


def embedded_pose(pose: Float[Array, "3"]) -> Float[Array, "4 4"]:
    """The level pose on the floor, z = 0, at planar [x, y, yaw]."""
    return SPACES["spatial"].upright(jnp.append(pose[:2], 0.0), pose[2])


def embedded_episode(episode: Episode) -> Episode:
    """A planar episode with its pose in space; all else is as it was."""
    return eqx.tree_at(lambda e: e.pose, episode, embedded_pose(episode.pose))


class EmbeddedPolicy(Policy):
    """A planar policy that decides for a level body on the floor of space."""

    planar: Policy

    def _observation(self, observation: Observation) -> Observation:
        T = observation.pose
        pose = jnp.stack([T[0, 3], T[1, 3], jnp.arctan2(T[1, 0], T[0, 0])])
        return eqx.tree_at(lambda o: o.pose, observation, pose)

    def start(self, observation: Observation) -> Any:
        """The planar policy's memory."""
        return self.planar.start(self._observation(observation))

    def __call__(self, observation: Observation, memory: Any, key: Key) -> tuple[Action, Any]:
        """What the planar policy commands at [x, y, yaw]."""
        return self.planar(self._observation(observation), memory, key)
