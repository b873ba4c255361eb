"""Settings of random maps for training: circles, rooms, streets, and a forest."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from foveate.geometry.distance_grid import Box, Nodes
from foveate.geometry.shapes import Shape
from foveate.io.settings import tag
from foveate.io.validate import at_least, positive, require
from foveate.scenario import random_maps
from foveate.scenario.obstacle_grids import node_counts, shape_nodes
from foveate.scenario.obstacles import BaseObstacles, OccupancyObstacles, ShapeObstacles

MOST_SHAPES = 10_000
"""Most circles or trunks that a map is expected to have."""


@dataclass(frozen=True, kw_only=True)
class _RandomObstacles(BaseObstacles):
    """Random maps: each training episode has one of `maps`, each test scene one of the `test_maps`, none of training.

    All are drawn from `seed` within the box of all starts, on a grid with cells of `resolution_m`.
    """

    maps: int = 32
    test_maps: int = 16
    seed: int = 0
    resolution_m: float = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(1, self, "maps")
        at_least(0, self, "test_maps", "seed")
        positive(self, "resolution_m")

    @property
    def map_counts(self) -> tuple[int, int]:
        """Number of maps for training, and for test scenes."""
        return self.maps, self.test_maps

    def shapes_in(self, rng: np.random.Generator, low: np.ndarray, high: np.ndarray) -> list[Shape]:
        """The shapes of one map in a box [m]."""
        raise NotImplementedError

    def nodes(self, box: Box) -> Nodes:
        """Signed distances of all maps."""
        return _random_nodes(self, box)


@dataclass(frozen=True, kw_only=True)
class CircleObstacles(_RandomObstacles):
    """Circles in the plane: a Poisson number of them by `density_per_m2`, uniform in place and in `radius_m`."""

    kind: Literal["circles"] = tag("circles")
    density_per_m2: float = 0.02
    radius_m: tuple[float, float] = (0.5, 1.5)

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(0, self, "density_per_m2")
        _require_range("radius_m", self.radius_m, 0.5 * self.resolution_m)

    def shapes_in(self, rng: np.random.Generator, low: np.ndarray, high: np.ndarray) -> list[Shape]:
        """The circles of one map."""
        _require_few(self.density_per_m2, low, high)
        return random_maps.circles(rng, low, high, self.density_per_m2, self.radius_m)


@dataclass(frozen=True, kw_only=True)
class RoomObstacles(_RandomObstacles):
    """Rooms of about `room_m` in rows and columns, with walls of `wall_m`, the outer ones closed.

    Doors of `door_m` connect every room to every other.
    """

    kind: Literal["rooms"] = tag("rooms")
    room_m: float = 6.0
    door_m: float = 1.6
    wall_m: float = 0.3

    def __post_init__(self) -> None:
        super().__post_init__()
        positive(self, "door_m")
        require(self.wall_m >= self.resolution_m, "wall_m", self.wall_m, f"expected >= a cell, {self.resolution_m:g}")
        least = 2.0 * (self.reach_m + 1.25 * self.resolution_m)
        right = f"expected > {least:.3g}: the agent's width and a cell and a quarter on each side"
        require(self.door_m > least, "door_m", self.door_m, right)
        right = f"expected > 1.5 (door_m + wall_m) = {1.5 * (self.door_m + self.wall_m):.3g}"
        require(self.room_m > 1.5 * (self.door_m + self.wall_m), "room_m", self.room_m, right)

    def shapes_in(self, rng: np.random.Generator, low: np.ndarray, high: np.ndarray) -> list[Shape]:
        """The walls of one map."""
        return random_maps.rooms(rng, low, high, self.room_m, self.door_m, self.wall_m)


@dataclass(frozen=True, kw_only=True)
class StreetObstacles(_RandomObstacles):
    """Blocks of about `block_m` between crossing streets of `street_m`; some blocks are open squares."""

    kind: Literal["streets"] = tag("streets")
    block_m: float = 6.0
    street_m: float = 3.0

    def __post_init__(self) -> None:
        super().__post_init__()
        positive(self, "block_m", "street_m")
        least = 2.0 * (self.reach_m + 1.25 * self.resolution_m)
        require(self.street_m > least, "street_m", self.street_m, f"expected > {least:.3g}, the width of the agent")

    def shapes_in(self, rng: np.random.Generator, low: np.ndarray, high: np.ndarray) -> list[Shape]:
        """The blocks of one map."""
        return random_maps.streets(rng, low, high, self.block_m, self.street_m)


@dataclass(frozen=True, kw_only=True)
class ForestObstacles(_RandomObstacles):
    """Upright trunks in space, on the lowest height of the starts.

    Their number is Poisson by `density_per_m2`; they are uniform in place, in `radius_m` and in `height_m`.
    """

    kind: Literal["forest"] = tag("forest")
    density_per_m2: float = 0.03
    radius_m: tuple[float, float] = (0.25, 0.6)
    height_m: tuple[float, float] = (5.0, 10.0)
    resolution_m: float = 0.4
    maps: int = 16
    test_maps: int = 8

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(0, self, "density_per_m2")
        _require_range("radius_m", self.radius_m, 0.5 * self.resolution_m)
        _require_range("height_m", self.height_m, self.resolution_m)

    @property
    def dimension(self) -> int:
        """3."""
        return 3

    def shapes_in(self, rng: np.random.Generator, low: np.ndarray, high: np.ndarray) -> list[Shape]:
        """The trunks of one map."""
        _require_few(self.density_per_m2, low, high)
        return random_maps.forest(rng, low, high, self.density_per_m2, self.radius_m, self.height_m)


ObstacleSettings = (
    ShapeObstacles | OccupancyObstacles | CircleObstacles | RoomObstacles | StreetObstacles | ForestObstacles
)
"""Settings of obstacles, told apart by `kind`."""


def _require_range(name: str, value: tuple[float, float], least: float) -> None:
    """Raise InputError unless least <= low <= high."""
    right = f"expected {least:g} <= low <= high: an obstacle is at least a cell thick"
    require(least * (1 - 1e-9) <= value[0] <= value[1], name, value, right)


def _require_few(density_per_m2: float, low: np.ndarray, high: np.ndarray) -> None:
    """Raise InputError for a density that is expected to give a map more than MOST_SHAPES."""
    area_m2 = float(np.prod((high - low)[:2]))
    if density_per_m2 * area_m2 > MOST_SHAPES:
        right = f"expected at most {MOST_SHAPES / area_m2:.3g}: {MOST_SHAPES} obstacles a map"
        require(False, "density_per_m2", density_per_m2, right)


@lru_cache(maxsize=8)
def _random_nodes(settings: _RandomObstacles, box: Box) -> Nodes:
    """Signed distances of all maps: each is drawn by its own number, so that more maps leave the others as they are."""
    low, high = np.array(box[0]), np.array(box[1])
    node_counts(settings.maps + settings.test_maps, box, settings.resolution_m)  # before any is drawn
    # Test maps are numbered backwards, so that they do not depend on the number of maps for training.
    numbers = [*range(settings.maps), *range(-1, -settings.test_maps - 1, -1)]
    rngs = [np.random.default_rng([settings.seed, number < 0, abs(number)]) for number in numbers]
    return shape_nodes([settings.shapes_in(rng, low, high) for rng in rngs], box, settings.resolution_m)
