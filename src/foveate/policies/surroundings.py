"""What a policy is told of obstacles: free ranges along rays in the robot's frame, and the ways to the targets."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.geometry.sight import fan
from foveate.models.robot import Robot, Surroundings
from foveate.policies.detour import past_bodies, unfold
from foveate.simulation.bodies import bodies_of
from foveate.simulation.records import Observation
from foveate.types import Scalar

RANGE_DEPTHS = 2.0
"""Longest range, in depths of the view."""

NEAR = 0.05
"""Below this range, in depths of the view, the direction of a target fades to zero: at the agent itself it has none."""


def surroundings(
    observation: Observation, robot: Robot, points_world: Float[Array, "n d"], rays: int, standoff_m: Scalar
) -> Surroundings:
    """What an observation says, or the robot's map at points [m]; all is free where there are no obstacles."""
    if observation.surroundings is not None:
        return observation.surroundings
    problem, count, most = robot.problem, points_world.shape[0], RANGE_DEPTHS * robot.extent.ahead_m
    space, obstacles = problem.agent.space, problem.obstacles
    if obstacles is None:
        away = jnp.linalg.norm(points_world - space.position(observation.pose), axis=-1)
        free = jnp.ones(count, bool)
        return Surroundings(jnp.full(rays, most), points_world, away, free, free)
    directions = jnp.asarray(fan(rays, space.dimension), points_world.dtype)
    ranges = obstacles.ranges(space, observation.pose, directions, most)
    way = obstacles.ways_to(space.position(observation.pose), points_world, standoff_m)
    return Surroundings(ranges, way.place_world, way.length, way.is_straight, way.is_seen)


def ways_of(
    observation: Observation, robot: Robot, position_body: Float[Array, "n d"], rays: int, standoff_m: Scalar
) -> tuple[Float[Array, "n d"], Float[Array, " n"], list[Float[Array, "n features"]]]:
    """Where the steering law aims for targets [m], how far before that it ends [m], and the features of obstacles.

    Among obstacles it aims along the ways, which are unfolded. Without rays it aims at the targets, without features.
    Either way it aims past bodies that the agent keeps off.
    """
    depth, count = robot.extent.ahead_m, position_body.shape[0]  # not len(): an exported file has any number
    problem, bodies = robot.problem, bodies_of(robot.problem, observation)
    if rays == 0:
        rest = jnp.broadcast_to(standoff_m, count)
        return past_bodies(problem, observation.pose, position_body, rest, bodies), rest, []
    space = problem.agent.space
    around = surroundings(observation, robot, space.to_world(observation.pose, position_body), rays, standoff_m)
    place_body = space.to_body(observation.pose, around.place_world)
    way = unfold(position_body, place_body, around.length, around.is_straight, standoff_m)
    # What is near is resolved best.
    ranges = jnp.log(jnp.clip(around.ranges / depth, 0.0, RANGE_DEPTHS) + NEAR)
    seen = around.is_seen.astype(depth.dtype)[:, None]
    features = [place_features(way.points_body / depth), seen, jnp.broadcast_to(ranges, (count, rays))]
    return past_bodies(problem, observation.pose, way.points_body, way.rest, bodies), way.rest, features


def ways_size(dimension: int, rays: int) -> int:
    """Number of features of obstacles that a token has."""
    return 0 if rays == 0 else 2 * dimension + 2 + 1 + rays


def place_features(position: Float[Array, "n d"]) -> Float[Array, "n features"]:
    """Direction, logarithm of the range, and position: near and far targets are resolved alike."""
    distance = jnp.sqrt(jnp.sum(position**2, axis=-1, keepdims=True) + NEAR**2)
    return jnp.concatenate([position / distance, jnp.log(distance), jnp.tanh(distance / 4), jnp.arcsinh(position)], -1)
