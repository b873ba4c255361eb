"""A robot's map under a recording: the scenario in that map, places to start, and fixes that lie in obstacles."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from foveate.errors import InputError
from foveate.geometry import sight
from foveate.io.occupancy import read_map
from foveate.models.obstacles import Obstacles
from foveate.recordings.recording import Recording, Slots
from foveate.scenario.obstacles import BaseObstacles, OccupancyObstacles, ShapeObstacles
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings

RANDOM = "the scenario's obstacles are random maps, which the recording is not in: replayed in the open; give the map"
"""Warning of a replay in the open."""
WALL_M = 2.0
"""Height of the walls below the lowest fix and above the highest, in space [m]: a map of the plane says none."""


def map_of(recording: Recording, file: str | Path, like: BaseObstacles | None = None) -> OccupancyObstacles:
    """Obstacles of a map's YAML file that recorded targets may pass, where the map is wrong.

    The robot has the size, and keeps the distance, that it has among the obstacles `like`. In space the walls stand
    between the heights of those, or WALL_M beyond those of the recording.

    Raises:
        InputError: The map cannot be read, or does not hold all fixes of the recording.
    """
    grid, (lower, upper) = read_map(file), recording.extent
    if (lower[:2] < grid.low).any() or (upper[:2] > grid.high).any():
        moved = "" if recording.origin is None else f", in metres from its origin {recording.origin}"
        raise InputError(
            f"{file}: the map, from {_text(grid.low)} to {_text(grid.high)} m, does not hold {recording.short_name}, "
            f"from {_text(lower[:2])} to {_text(upper[:2])} m{moved}: expected the map of its place and frame"
        )
    heights = None
    if recording.dimension == 3:
        own = like.heights_m if isinstance(like, OccupancyObstacles) else None
        heights = own or (float(lower[2]) - WALL_M, float(upper[2]) + WALL_M)
    radius_m, keep_off_m = BaseObstacles.robot_radius_m, BaseObstacles.keep_off_m
    if like is not None:
        radius_m, keep_off_m = like.robot_radius_m, like.keep_off_m
    return OccupancyObstacles(
        file=str(file), heights_m=heights, targets="free", robot_radius_m=radius_m, keep_off_m=keep_off_m
    )


def under(recording: Recording, scenario: Scenario, file: str | Path | None) -> tuple[Scenario, list[str]]:
    """The scenario of a replay in the map of a file, or else among its own obstacles, and warnings.

    Random obstacles are left out: no recording was made in them. The scenes, which no replay plays, are moved to the
    recording, which the map holds. Raises InputError as `map_of`, and for a recording of another dimension.
    """
    require_dimension(recording, scenario)
    own = scenario.obstacles
    if file is None:
        if own is None or isinstance(own, ShapeObstacles | OccupancyObstacles):
            return scenario, []
        return replace(scenario, obstacles=None), [RANDOM]
    scenes = _scenes_at(recording, scenario.scenes)
    return replace(scenario, scenes=scenes, obstacles=map_of(recording, file, own)), []


def require_dimension(recording: Recording, scenario: Scenario) -> None:
    """Raise InputError for a recording in the plane and a scenario in space, or the other way around."""
    if recording.dimension != scenario.dimension:
        right = f"the run's scenario has {scenario.dimension}"
        raise InputError(f"{recording.name}: positions have {recording.dimension} numbers: {right}")


def _scenes_at(recording: Recording, scenes: SceneSettings) -> SceneSettings:
    lower, upper = recording.extent
    return replace(
        scenes,
        centre_m=tuple((0.5 * (lower + upper)).tolist()),
        half_side_m=tuple(np.maximum(0.5 * (upper - lower), 1e-3).tolist()),
        half_side_per_target_m=0.0,
        agent_centre_m=None,
        agent_half_side_m=None,
        agent_spread=1.0,
        target_ring_m=None,
    )


def inside(obstacles: Obstacles, positions_m: Float[np.ndarray, "*n d"]) -> Bool[np.ndarray, "*n"]:
    """Positions [m] inside of an obstacle, by the grid: to half a cell."""
    return np.asarray(obstacles.grid(jnp.asarray(positions_m, float))) < 0.0


def in_obstacles(obstacles: Obstacles | None, slots: Slots) -> Bool[np.ndarray, "steps columns"] | None:
    """Instants at which a target is present, inside of an obstacle; None without obstacles."""
    return None if obstacles is None else inside(obstacles, slots.positions_m) & slots.present


def warnings_of(inside: Bool[np.ndarray, "steps columns"] | None, slots: Slots) -> list[str]:
    """A warning where targets are in obstacles."""
    if inside is None or not inside.any():
        return []
    tracks, share = len(np.unique(slots.track_index[inside])), inside.sum() / slots.present.sum()
    return [
        f"{tracks} of {len(slots.track_ids)} tracks pass through obstacles, at {inside.sum()} of {slots.present.sum()} "
        f"instants of targets ({share:.1%}), where they cannot be seen: the map is wrong there, or of another frame"
    ]


def free_start(obstacles: Obstacles | None) -> Callable[[Float[np.ndarray, " d"]], Float[np.ndarray, " d"]]:
    """The function that moves a place [m] to the nearest node of the map where the agent may start."""
    if obstacles is None:
        return lambda place: place
    nodes, needed = obstacles.grid.nodes(), _needed(obstacles)
    free = nodes.positions()[nodes.distance[0] > needed]

    def moved(place: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
        return place if is_free(obstacles, place) else free[np.argmin(((free - place) ** 2).sum(axis=1))]

    return moved


def is_free(obstacles: Obstacles, place: Float[np.ndarray, " d"]) -> bool:
    """True where the agent may start."""
    return float(obstacles.grid(jnp.asarray(place, float))) > _needed(obstacles)


def require_free(obstacles: Obstacles | None, place: Float[np.ndarray, " d"], name: str) -> None:
    """Raise InputError for a place [m] of the agent in an obstacle, or too near to one."""
    if obstacles is not None and not is_free(obstacles, place):
        room = float(obstacles.grid(jnp.asarray(place, float)))
        where = "is in an obstacle" if room < 0 else f"is {room:.3g} m from an obstacle"
        raise InputError(
            f"{name}: {where}: expected more than {_needed(obstacles):.3g} m, the robot's radius and a cell"
        )


def _needed(obstacles: Obstacles) -> float:
    return float(sight.margin(obstacles.grid, obstacles.reach))


def _text(corner: Float[np.ndarray, "2"]) -> str:
    return f"({', '.join(f'{x:g}' for x in corner)})"
