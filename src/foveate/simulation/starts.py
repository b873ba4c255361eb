"""Where agent and targets start: in a box or on a ring, and outside of obstacles."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from foveate.errors import InputError
from foveate.geometry import sight
from foveate.io.validate import require
from foveate.models.obstacles import Obstacles
from foveate.models.problem import Problem
from foveate.scenario.scenes import Scene, SceneSettings
from foveate.types import Count

TRIES = 24
"""Further places that are tried for agent and targets among obstacles."""

ROUNDING_M = 2e-6
"""What the rounding of a scene's numbers may cost."""


def starts(
    problem: Problem,
    agent_at: Callable[[Array], Array],
    targets_at: Callable[[Array, Array], Array],
    first: tuple[Float[Array, " d"], Float[Array, "n d"]],
    tries: Sequence[Array],
    test: bool,
) -> tuple[Count | None, Float[Array, " d"], Float[Array, "n d"]]:
    """Number of the map, if there are obstacles, and positions of agent and targets, from numbers uniform in [-1, 1).

    Among obstacles each is at the `first` of its places that is free, or else of its `tries`.
    """
    agent, targets = first
    if problem.obstacles is None:
        start = agent_at(agent)
        return None, start, targets_at(start, targets)
    _, agent_tries, target_tries = tries
    number = map_of(problem, tries, test)
    assert number is not None, "there are obstacles"
    obstacles = problem.obstacles.of_map(number)
    start = obstacles.free_place(jax.vmap(agent_at)(jnp.concatenate([agent[None], agent_tries])), obstacles.reach)
    numbers = jnp.concatenate([targets[:, None], target_tries], axis=1)
    places = jax.vmap(targets_at, (None, 1), 1)(start, numbers)
    return number, start, jax.vmap(obstacles.free_place, (0, None))(places, jnp.zeros_like(obstacles.radius))


def map_of(problem: Problem, tries: Sequence[Array], test: bool) -> Count | None:
    """Number of the map that the first of the `tries` chooses; None without obstacles."""
    return None if problem.obstacles is None else problem.obstacles.map_number((tries[0] + 1.0) / 2.0, test)


def agent_start(
    settings: SceneSettings, centre: Float[Array, " d"], half_side: Float[Array, " d"], uniform: Array, test: bool
) -> Float[Array, " d"]:
    """The agent's position, from numbers uniform in [-1, 1)."""
    own, side = settings.agent_half_side_m, settings.agent_spread * half_side
    if test and not settings.has_own_starts:
        side = settings.agent_test_half_side_m
    centre = centre if settings.agent_centre_m is None else jnp.array(settings.agent_centre_m)
    return centre + (side if own is None else jnp.array(own)) * uniform


def target_starts(
    settings: SceneSettings, agent: Float[Array, "*n d"], in_box: Float[Array, "n d"], uniform: Float[Array, "n d"]
) -> Float[Array, "n d"]:
    """Positions in the box, or on the ring about the agent (each target's own), from numbers uniform in [-1, 1)."""
    if settings.target_ring_m is None:
        return in_box
    inner, outer = settings.target_ring_m
    radius, angle = inner + (outer - inner) * (uniform[:, :1] + 1.0) / 2.0, jnp.pi * uniform[:, 1:2]
    offset = radius * jnp.concatenate([jnp.cos(angle), jnp.sin(angle)], axis=1)
    return in_box.at[:, :2].set(agent[..., :2] + offset)


def check_free(problem: Problem, scenes: Sequence[Scene]) -> None:
    """Raise InputError unless agent and targets of all scenes begin outside of the obstacles of their maps.

    The agent needs the distance at which it would be stopped, or slowed down; targets that go around obstacles need
    that of a point.
    """
    obstacles = problem.obstacles
    if obstacles is None:
        if chosen := [scene for scene in scenes if scene.map]:
            raise InputError(f"scene {chosen[0].id!r}: map = {chosen[0].map}: expected none: there are no obstacles")
        return
    d, maps, most = problem.agent.space.dimension, obstacles.grid.maps, max(len(scene.targets) for scene in scenes)
    for scene in scenes:
        require(scene.map < maps, f"scene {scene.id!r}: map", scene.map, f"expected < {maps}, the number of maps")
    # Scenes of fewer targets are filled up with copies of the agent's place, which needs more room than theirs.
    rows = [[scene.agent[:d], *scene.targets, *[scene.agent[:d]] * (most - len(scene.targets))] for scene in scenes]
    places, numbers = jnp.asarray(np.array(rows), float), jnp.array([scene.map for scene in scenes])
    room = np.asarray(_room(obstacles, numbers, places), float)
    body, point = (float(sight.margin(obstacles.grid, jnp.asarray(r, float))) for r in (obstacles.reach, 0.0))
    needed = np.array([body, *[point if problem.turns_targets else -np.inf] * most])
    short = room < needed - ROUNDING_M
    if short.any():
        i, j = np.argwhere(short)[0]
        name = f"scene {scenes[i].id!r}: {'target' if j else 'agent'}"
        right = f"expected at least {needed[j]:.3g} m from obstacles, by the grid; here it is {room[i, j]:.3g} m"
        require(False, name, [float(x) for x in rows[i][j]], right)


@jax.jit
def _room(
    obstacles: Obstacles, numbers: Int[Array, " scenes"], places: Float[Array, "scenes n d"]
) -> Float[Array, "scenes n"]:
    """Signed distances [m] at places, those of each scene on its own map."""
    return jax.vmap(lambda number, points: obstacles.of_map(number).grid(points))(numbers, places)
