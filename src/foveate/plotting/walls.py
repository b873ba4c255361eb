"""Obstacles in pictures: their outlines on the map of an episode, and the part of a view that they leave."""

from typing import Any

import numpy as np
from contourpy import contour_generator
from jaxtyping import Float
from matplotlib.axes import Axes
from scipy.ndimage import map_coordinates

from foveate.geometry.distance_grid import Nodes
from foveate.geometry.numpy_poses import placed, positions
from foveate.models.problem import Problem

WALL = "#5A5A5A"
"""Colour of obstacles."""
HEIGHTS = 9
"""Heights at which obstacles in space are outlined."""
EDGE_POINTS = 120
"""Points on the border of a view to which lines of sight are drawn."""


def walls_of(problem: Problem) -> Nodes | None:
    """Signed distances of the chosen map; None without obstacles."""
    return None if problem.obstacles is None else problem.obstacles.grid.nodes()


def loops(walls: Nodes) -> list[Float[np.ndarray, "v d"]]:
    """Outlines of obstacles as closed lines [m]; in space, those of level cuts at several heights."""
    if len(walls.low) == 2:
        return _outlines(walls, walls.distance[0])
    found = []
    for i in np.linspace(0, walls.distance.shape[3] - 1, HEIGHTS + 2)[1:-1].round().astype(int):
        height = walls.low[2] + i * walls.cell_m
        found += [
            np.pad(loop, ((0, 0), (0, 1)), constant_values=height)
            for loop in _outlines(walls, walls.distance[0, ..., i])
        ]
    return found


def draw(axes: Axes, walls: Nodes) -> Any:
    """Fill the obstacles of the plane; return the artist."""
    x, y = (np.arange(n) * walls.cell_m + low for n, low in zip(walls.distance.shape[1:], walls.low, strict=True))
    lowest = min(-1.0, float(walls.distance.min()) - 1.0)
    autoscale = axes.get_autoscale_on()
    filled = axes.contourf(x, y, walls.distance[0].T, levels=[lowest, 0.0], colors=[WALL], zorder=1.5)
    axes.set_autoscale_on(autoscale)
    return filled


def lit(walls: Nodes, pose: Float[np.ndarray, "3"], border_body: Float[np.ndarray, "v 2"]) -> Float[np.ndarray, "m 2"]:
    """The part of a planar view that obstacles leave, in the world: its border, cut on every line of sight [m].

    A view that does not hold the agent, which looks on from outside, is left whole.
    """
    border = placed(pose, _dense(border_body))
    eye = positions(pose)
    if not _holds_origin(border_body):
        return border
    steps = max(2, int(np.ceil(2.0 * np.linalg.norm(border - eye, axis=1).max() / walls.cell_m)))
    share = np.linspace(0.0, 1.0, steps)
    places = eye + share[:, None, None] * (border - eye)
    cells = (places - walls.low) / walls.cell_m
    free = map_coordinates(walls.distance[0], np.moveaxis(cells, -1, 0), order=1, mode="nearest") > 0.0
    last = share[np.maximum(np.cumprod(free, axis=0).sum(axis=0) - 1, 0)]
    return eye + last[:, None] * (border - eye)


def _outlines(walls: Nodes, distance: Float[np.ndarray, "x y"]) -> list[Float[np.ndarray, "v 2"]]:
    lines = contour_generator(z=np.pad(distance, 1, constant_values=1.0).T).lines(0.0)
    return [walls.low[:2] + (np.asarray(line) - 1.0) * walls.cell_m for line in lines]


def _dense(border: Float[np.ndarray, "v 2"]) -> Float[np.ndarray, "m 2"]:
    """Points all along a closed border, its corners among them."""
    after = np.roll(border, -1, axis=0)
    length = np.linalg.norm(after - border, axis=1)
    counts = np.ceil(EDGE_POINTS * length / max(length.sum(), 1e-9)).astype(int)
    pieces = [a + (b - a) * np.arange(n)[:, None] / n for a, b, n in zip(border, after, counts, strict=True) if n]
    return np.concatenate(pieces)


def _holds_origin(border: Float[np.ndarray, "v 2"]) -> bool:
    """True if the agent is within a border, or on it."""
    after = np.roll(border, -1, axis=0)
    along = after - border
    square = np.maximum((along**2).sum(axis=1), 1e-18)
    nearest = border + np.clip(-(border * along).sum(axis=1) / square, 0.0, 1.0)[:, None] * along
    if np.linalg.norm(nearest, axis=1).min() < 1e-9:
        return True
    angle = np.arctan2(border[:, 0] * after[:, 1] - border[:, 1] * after[:, 0], (border * after).sum(axis=1))
    return bool(abs(angle.sum()) > np.pi)
