"""Where the robots of a team start beside the first, and their share of an episode's random numbers."""

import zlib
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from foveate.io.validate import require
from foveate.models.problem import Problem
from foveate.models.team import Team
from foveate.scenario.scenes import Scene
from foveate.simulation.starts import TRIES
from foveate.simulation.team.mate_scans import mate_scan_shapes
from foveate.types import Count, Key

STREAM = 13
"""Folded into the key of an episode's noise: that of the first robot and of the targets is as without a team."""


class MateNumbers(NamedTuple):
    """Numbers uniform in [-1, 1) of a random scene: places and yaws of the other robots, and a robot for each target.

    `tries` are further places among obstacles.
    """

    places: Float[Array, "mates d"]
    yaw: Float[Array, " mates"]
    about: Float[Array, " n"]
    tries: Float[Array, "mates tries d"] | None = None


def mate_shapes(team: Team, targets: int, d: int, has_obstacles: bool) -> tuple[tuple[int, ...], ...]:
    """Shapes of `MateNumbers`."""
    mates = team.agents - 1
    shapes = (mates, d), (mates,), (targets,)
    return (*shapes, (mates, TRIES, d)) if has_obstacles else shapes


def mate_places(
    problem: Problem,
    numbers: MateNumbers,
    map_number: Count | None,
    first_at: Callable[[Array], Array],
    centre: Float[Array, " d"],
) -> Float[Array, "mates d"]:
    """Positions of the other robots [m]; `first_at` is where numbers place the first one."""
    assert problem.team is not None, "of a team's problems"
    side = problem.team.half_side

    def place(uniform: Float[Array, " d"]) -> Float[Array, " d"]:
        return first_at(uniform) if side is None else problem.inside(centre + side * uniform, problem.bounds_agent)

    if problem.obstacles is None or map_number is None:
        return jax.vmap(place)(numbers.places)
    assert numbers.tries is not None, "drawn where there are obstacles"
    obstacles = problem.obstacles.of_map(map_number)
    places = jax.vmap(jax.vmap(place))(jnp.concatenate([numbers.places[:, None], numbers.tries], axis=1))
    return jax.vmap(obstacles.free_place, (0, None))(places, obstacles.reach)


def middles(numbers: MateNumbers, first: Float[Array, " d"], mates: Float[Array, "mates d"]) -> Float[Array, "n d"]:
    """The position of a random robot for each target, about which a ring of targets is."""
    robots = jnp.concatenate([first[None], mates])
    index = jnp.floor((numbers.about + 1.0) / 2.0 * len(robots)).astype(int)
    return robots[jnp.clip(index, 0, len(robots) - 1)]


def mate_noise(
    problem: Problem, key: Key, steps: int, targets: int
) -> tuple[Float[Array, "K mates n n_z"], Float[Array, "K M M"]]:
    """Standard normals for the other robots' measurements, and numbers for the radio."""
    assert problem.team is not None, "of a team's problems"
    agents = problem.team.agents
    normal_key, radio_key = jax.random.split(jax.random.fold_in(key, STREAM))
    normal = jax.random.normal(normal_key, (steps, agents - 1, targets, problem.sensor.size))
    return normal, jax.random.uniform(radio_key, (steps, agents, agents))


def scene_mate_noise(problem: Problem, scene: Scene, seed: int, episode: int) -> dict[str, np.ndarray]:
    """Random numbers of the other robots' measurements and of the radio, apart from those of `scene_noise`."""
    assert problem.team is not None, "of a team's problems"
    agents, rng = problem.team.agents, np.random.default_rng([seed, zlib.crc32(scene.id.encode()), episode, 1])
    drawn = {
        "radio": rng.uniform(0.0, 1.0, (scene.horizon, agents, agents)),
        "mates": rng.standard_normal((scene.horizon, agents - 1, len(scene.targets), problem.sensor.size)),
    }
    shapes = mate_scan_shapes(problem, scene.horizon, len(scene.targets))
    return drawn | {name: rng.uniform(size=shape) for name, shape in shapes.items()}


def other_poses(problem: Problem, scenes: Sequence[Scene]) -> Float[np.ndarray, "scenes mates ..."]:
    """Poses of the other robots. Raises InputError unless each scene has them for the whole team."""
    mates = 0 if problem.team is None else problem.team.agents - 1
    for scene in scenes:
        right = f"expected {mates} poses, one for each robot of the team after the first"
        require(len(scene.others) == mates, f"scene {scene.id!r}: others", len(scene.others), right)
    return np.stack([[problem.agent.space.numpy_pose(pose) for pose in scene.others] for scene in scenes])
