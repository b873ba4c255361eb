"""A step of the simulation in progress, and what its stages share."""

from collections.abc import Callable
from typing import NamedTuple

import jax
from jaxtyping import Array, Bool, Float

from foveate.models.belief import Belief
from foveate.models.detections.records import Scan
from foveate.models.problem import Problem
from foveate.simulation.records import Instant, Protocol, State
from foveate.types import Action, Pose


class Sensed(NamedTuple):
    """Measurements z = H y + eta of every target, also of those outside of the view.

    `position_body` is the true position of each target, `in_view` marks those inside of the field of view.
    """

    position_body: Float[Array, "n d"]
    in_view: Bool[Array, " n"]
    measurement: Float[Array, "n n_z"]


class Draft(NamedTuple):
    """A step in progress: the results of its stages.

    `state` begins as the predicted one and ends as that after the update. `covariance` is V as the filter believes it,
    at the predicted means; `measured` marks the targets whose measurement is taken; `weight` is the share of a
    measurement's information that each level of the protocol counts; `restart` marks the beliefs to be replaced, and
    holds new ones; `gain` is the information of a measurement where it is not that of `covariance` alone. `scan` has
    the detections where they are without ids; `measured` then marks the targets of the truth.
    """

    predicted: State
    action: Action
    instant: Instant
    state: State
    covariance: Float[Array, "n n_z n_z"]
    measured: Bool[Array, " n"]
    weight: Float[Array, "levels n"]
    sensed: Sensed | None = None
    restart: tuple[Bool[Array, " n"], Belief] | None = None
    gain: Float[Array, "n n_y n_y"] | None = None
    scan: Scan | None = None


Stage = Callable[[Problem, Protocol, Draft], Draft]
"""Part of a step, given the problem of that step alone (`Problem.at`)."""


def positions_body(problem: Problem, pose: Pose, state: Float[Array, "n n_y"]) -> Float[Array, "n d"]:
    """q = Q T^-1 [zeta(y); 1]."""
    return problem.agent.space.to_body(pose, problem.motion.position(state))


def noise_covariance(problem: Problem, pose: Pose, position_body: Float[Array, "n d"]) -> Float[Array, "n n_z n_z"]:
    """V of every target as seen from a pose, in the world frame."""
    rotation = problem.agent.space.rotation(pose)
    return jax.vmap(problem.sensor.covariance, (None, 0))(rotation, position_body)
