"""Settings of obstacles: what all kinds have in common, shapes, and a robot's occupancy map."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import jax.numpy as jnp
import numpy as np

from foveate.errors import InputError
from foveate.geometry import sight
from foveate.geometry.distance_grid import Box, DistanceGrid, Nodes
from foveate.geometry.shapes import Shape, is_convex, rectangle
from foveate.io.occupancy import read_map
from foveate.io.settings import Settings, tag
from foveate.io.validate import at_least, positive, require
from foveate.models.obstacles import Obstacles
from foveate.scenario.obstacle_grids import extruded, map_nodes, shape_nodes, ways_among

MAX_SAMPLES = 256
"""Most places on a line of sight at which a soft view looks."""

CONVEX = "expected a convex polygon, counterclockwise, >= 3 corners, none twice and no three in a line"


@dataclass(frozen=True, kw_only=True)
class BaseObstacles(Settings):
    """What all kinds of obstacles have in common.

    The agent is a ball of `robot_radius_m`, which stops where it would touch. It is stopped, and lines of sight end, at
    up to a cell before an obstacle, never behind it; so a cell should be well below the width of a door. With
    `keep_off_m` every command is shortened before, by the safety filter of `foveate.KeepOff`: the agent keeps this
    distance more, from its start on, goes around by ways that are so wide, and has no contact.
    """

    robot_radius_m: float = 0.2
    targets: Literal["around", "free"] = "around"
    """Simulated targets slide along obstacles, and their velocity or drift is reflected there ("around"); or pass
    through them ("free")."""
    keep_off_m: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(0, self, "robot_radius_m")
        if self.keep_off_m is not None:
            at_least(0, self, "keep_off_m")

    @property
    def reach_m(self) -> float:
        """What the agent's position keeps from obstacles [m]."""
        return self.robot_radius_m + (self.keep_off_m or 0.0)

    def nodes(self, box: Box) -> Nodes:
        """Signed distances of all maps, on grids that hold the box."""
        raise NotImplementedError

    @property
    def dimension(self) -> int:
        """Dimension of space that the obstacles are for."""
        return 2

    @property
    def map_counts(self) -> tuple[int, int]:
        """Number of maps for training, and for test scenes; 0 where these have those of training."""
        return 1, 0

    def obstacles(self, box: Box, depth_m: float) -> Obstacles:
        """Obstacles as arrays, on a grid that holds the `box` of all starts, for a view of this depth [m].

        Raises InputError for a map that is not readable, does not hold the box, or has no room for the agent.
        """
        return self.among(self.nodes(box), depth_m, box)

    def among(self, nodes: Nodes, depth_m: float, box: Box | None = None) -> Obstacles:
        """Obstacles of other maps than these settings', given as signed distances, for the same agent.

        There must be room for it in the box of all starts, if there is one.
        """
        grid, (freest, room) = DistanceGrid.of(nodes), nodes.freest(box)
        needed = self.reach_m + nodes.slack_m + 0.5 * sight.WAY_CELLS * nodes.cell_m
        self._require_room(float(room.min()), needed)
        samples = math.ceil(depth_m / (sight.STRIDE_CELLS * nodes.cell_m))
        return Obstacles(
            grid=grid,
            radius=jnp.asarray(self.robot_radius_m, float),
            freest=jnp.asarray(freest, float),
            ways=ways_among(nodes, needed),
            training=self.map_counts[0],
            samples=min(max(8, samples), MAX_SAMPLES),
            targets=self.targets,
            keep_off=None if self.keep_off_m is None else jnp.asarray(self.keep_off_m, float),
        )

    def _require_room(self, room: float, needed: float) -> None:
        """Raise InputError unless at the freest place of each map the obstacles are more than `needed` [m] away."""
        if room <= 0:
            raise InputError("kind: a map has no place outside of obstacles in the box of the scene's starts")
        margin = needed - self.reach_m
        name = "keep_off_m" if room > self.robot_radius_m + margin else "robot_radius_m"
        right = f"expected less: at the freest place of a map an obstacle is {room:.3g} m away, and {needed:.3g} m are "
        require(room > needed, name, getattr(self, name), f"{right}needed, of them {margin:.3g} m for the grid's cells")


@dataclass(frozen=True, kw_only=True)
class ShapeObstacles(BaseObstacles):
    """Convex polygons, circles and boxes, on a grid with cells of `resolution_m`.

    Each of the `polygons` is a list of corners [m], counterclockwise; each of the `circles` is x, y and radius [m];
    each of the `boxes` is its low and its high corner in one list, x0, y0, x1, y1, or in space x0, y0, z0, x1, y1, z1.
    With `heights_m`, in space, each polygon and then each circle is extruded between two heights.
    """

    kind: Literal["shapes"] = tag("shapes")
    polygons: tuple[tuple[tuple[float, float], ...], ...] = ()
    circles: tuple[tuple[float, float, float], ...] = ()
    boxes: tuple[tuple[float, ...], ...] = ()
    heights_m: tuple[tuple[float, float], ...] = ()
    resolution_m: float = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        positive(self, "resolution_m")
        number = len(self.polygons) + len(self.circles)
        require(number + len(self.boxes) > 0, "polygons", self.polygons, "expected at least one obstacle")
        right = f"expected none, or {number} pairs: one of each polygon, then one of each circle"
        require(len(self.heights_m) in (0, number), "heights_m", self.heights_m, right)
        for low, high in self.heights_m:
            require(low < high, "heights_m", (low, high), "expected low < high")
        for polygon in self.polygons:
            require(is_convex(polygon), "polygons", polygon, CONVEX)
        for circle in self.circles:
            require(circle[2] > 0, "circles", circle, "expected x, y, radius > 0")
        size = self.dimension
        for box in self.boxes:
            fits = len(box) == 2 * size and all(a < b for a, b in zip(box[:size], box[size:], strict=True))
            require(fits, "boxes", box, f"expected {2 * size} numbers, the low corner and then the high one")
        flat = bool(self.polygons or self.circles) and not self.heights_m
        require(size == 2 or not flat, "heights_m", self.heights_m, "expected heights of polygons and circles in space")
        for shape in self.shapes:
            require_thick(shape, self.resolution_m)

    @property
    def dimension(self) -> int:
        """3 with heights, or boxes of six numbers."""
        return 3 if self.heights_m or any(len(box) == 6 for box in self.boxes) else 2

    @property
    def shapes(self) -> list[Shape]:
        """The obstacles."""
        outlines = [(np.array(polygon, float), 0.0) for polygon in self.polygons]
        outlines += [(np.array([[x, y]]), radius) for x, y, radius in self.circles]
        heights = self.heights_m or [(None, None)] * len(outlines)
        shapes = [Shape(*outline, *pair) for outline, pair in zip(outlines, heights, strict=True)]
        return shapes + [rectangle(box[: len(box) // 2], box[len(box) // 2 :]) for box in self.boxes]

    def nodes(self, box: Box) -> Nodes:
        """Signed distances of the one map."""
        return shape_nodes_of(self, box)


@dataclass(frozen=True, kw_only=True)
class OccupancyObstacles(BaseObstacles):
    """The map of a robot: the YAML file of ROS's map_server, with the image beside it.

    A relative `file` is looked for in the working directory. What is unknown, and all beyond the map, is an obstacle.
    In space the map stands between two `heights_m`.
    """

    kind: Literal["map"] = tag("map")
    file: str
    heights_m: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.file != "", "file", self.file, "expected the name of a YAML file")
        low, high = self.heights_m or (0.0, 1.0)
        require(low < high, "heights_m", self.heights_m, "expected low < high")

    @property
    def dimension(self) -> int:
        """3 with heights."""
        return 2 if self.heights_m is None else 3

    def nodes(self, box: Box) -> Nodes:
        """Signed distances of the one map, read and checked."""
        try:
            grid = read_map(self.file)
        except InputError as error:
            raise InputError(f"file: {error}") from error
        high = grid.high
        (low_x, low_y), (high_x, high_y) = box[0][:2], box[1][:2]
        holds = grid.low[0] <= low_x and grid.low[1] <= low_y and high_x <= high[0] and high_y <= high[1]
        if not holds:
            raise InputError(
                f"file = {self.file!r}: the map, from {_text(grid.low)} to {_text(high)} m, does not hold the scene, "
                f"from {_text(box[0][:2])} to {_text(box[1][:2])} m: expected scenes.centre_m and half sides within it"
            )
        nodes = map_nodes(grid)
        return nodes if self.heights_m is None else extruded(nodes, self.heights_m, box)


def _text(corner: Sequence[float] | np.ndarray) -> str:
    return f"({', '.join(f'{x:g}' for x in corner)})"


def require_thick(shape: Shape, cell_m: float) -> None:
    """Raise InputError for a shape thinner than a cell, which a line of sight could miss."""
    thickness, place = shape.thickness, _text(shape.corners[0])
    right = f"expected at most {thickness:.3g}, the thickness of the obstacle at {place}"
    require(thickness >= cell_m * (1 - 1e-9), "resolution_m", cell_m, right)


@lru_cache(maxsize=8)
def shape_nodes_of(settings: "ShapeObstacles", box: Box) -> Nodes:
    """Signed distances of the shapes of settings, on a grid that holds them and the box."""
    lows, highs = zip(box, *(shape.bounds for shape in settings.shapes), strict=True)
    low, high = np.min(np.array(lows), axis=0), np.max(np.array(highs), axis=0)
    return shape_nodes([settings.shapes], (tuple(low.tolist()), tuple(high.tolist())), settings.resolution_m)
