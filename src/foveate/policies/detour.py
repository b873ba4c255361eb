"""Ways around obstacles for policies: where a place would be if the way to it were straight, and steering along it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from foveate.models.bodies import Bodies, aim_past
from foveate.models.problem import Problem
from foveate.policies.steering import steer
from foveate.types import Action, Point, Pose, Scalar

TINY_M = 1e-6
"""Distance [m] below which a place is where the agent is, and in no direction."""


class Unfolded(NamedTuple):
    """Places in the body frame [m] as if the ways to them were straight.

    Each is in the direction in which its way begins, and as far away as that is long. An agent that stops `rest` [m]
    before it stops where the way bends, or at its standoff where the way `is_straight`.
    """

    points_body: Float[Array, "n d"]
    rest: Float[Array, " n"]
    is_straight: Bool[Array, " n"]


def unfolded(problem: Problem, pose: Pose, points_world: Float[Array, "n d"], standoff_m: Scalar | float) -> Unfolded:
    """Unfold the ways to places [m] on the problem's map; without obstacles all are straight."""
    space = problem.agent.space
    points_body = space.to_body(pose, points_world)
    if problem.obstacles is None:
        count = points_world.shape[0]
        return Unfolded(points_body, jnp.full(count, standoff_m, points_body.dtype), jnp.ones(count, bool))
    way = problem.obstacles.ways_to(space.position(pose), points_world, standoff_m)
    return unfold(points_body, space.to_body(pose, way.place_world), way.length, way.is_straight, standoff_m)


def unfold(
    points_body: Float[Array, "n d"],
    place_body: Float[Array, "n d"],
    length: Float[Array, " n"],
    is_straight: Bool[Array, " n"],
    standoff_m: Scalar | float,
) -> Unfolded:
    """Unfold the ways to points that begin towards a place each, and are so long [m]."""
    hop = jnp.sqrt(jnp.sum(place_body**2, axis=-1) + TINY_M**2)
    bent = place_body * (length / hop)[:, None]
    rest = jnp.where(is_straight, standoff_m, length - hop)
    return Unfolded(jnp.where(is_straight[:, None], points_body, bent), rest, is_straight)


def past_bodies(
    problem: Problem, pose: Pose, points_body: Float[Array, "n d"], rest: Float[Array, " n"], bodies: Bodies | None
) -> Float[Array, "n d"]:
    """Where to aim so that straight ways to points [m], up to `rest` [m] before them, lead past bodies."""
    if bodies is None or problem.keep_off_m is None:
        return points_body
    bodies_body, radius_m = (
        problem.agent.space.to_body(pose, bodies.positions_world),
        bodies.radius_m(problem.keep_off_m),
    )

    def past(point_body: Point, rest: Scalar) -> Point:
        return aim_past(point_body, rest, bodies_body, bodies.present, radius_m)

    return jax.vmap(past)(points_body, rest)


def steer_to(
    problem: Problem, pose: Pose, point_world: Point, standoff_m: Scalar | float, bodies: Bodies | None
) -> Action:
    """The action that leads to a place [m] and ends `standoff_m` [m] before it.

    It leads around the obstacles of the map, and past bodies that the agent keeps off.
    """
    way = unfolded(problem, pose, point_world[None], standoff_m)
    aim = past_bodies(problem, pose, way.points_body, way.rest, bodies)
    return steer(problem.agent, problem.tau, aim[0], way.rest[0])


def reachable(problem: Problem, points_world: Float[Array, "n d"]) -> Float[Array, "n d"]:
    """The places nearest to points [m] at which the agent can be; without obstacles the points themselves."""
    if problem.obstacles is None:
        return points_world
    return problem.obstacles.ways.free_places(problem.obstacles.grid, points_world)
