"""Random maps: circles, rooms with doors, a grid of streets, and a forest, as convex shapes in a box."""

from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from foveate.geometry.shapes import Shape, rectangle

Corner = Float[np.ndarray, " d"]
EXTRA_DOOR = 0.4
"""Probability of a door in a wall that the rooms do not need to be connected."""
OPEN_BLOCK = 0.15
"""Probability that a block of a grid of streets is an open square."""
JITTER = 0.15
"""Largest shift of a line between rooms or streets, as a share of their width."""


def circles(
    rng: np.random.Generator, low: Corner, high: Corner, density_per_m2: float, radius_m: tuple[float, float]
) -> list[Shape]:
    """Circles in the plane, a Poisson number of them, uniform in place and in radius."""
    count = rng.poisson(density_per_m2 * float(np.prod((high - low)[:2])))
    centres, radii = rng.uniform(low[:2], high[:2], (count, 2)), rng.uniform(*radius_m, count)
    return [Shape(centre[None], float(radius)) for centre, radius in zip(centres, radii, strict=True)]


def forest(
    rng: np.random.Generator,
    low: Corner,
    high: Corner,
    density_per_m2: float,
    radius_m: tuple[float, float],
    height_m: tuple[float, float],
) -> list[Shape]:
    """Upright trunks on the ground of the box, uniform in place, radius and height."""
    trunks = circles(rng, low, high, density_per_m2, radius_m)
    tops = low[2] + rng.uniform(*height_m, len(trunks))
    return [trunk._replace(low=float(low[2]), high=float(top)) for trunk, top in zip(trunks, tops, strict=True)]


def streets(rng: np.random.Generator, low: Corner, high: Corner, block_m: float, street_m: float) -> list[Shape]:
    """Rectangular blocks between crossing streets; some blocks are open squares."""
    x, y = (_lines(rng, a, b, block_m + street_m) for a, b in zip(low[:2], high[:2], strict=True))
    half, blocks = 0.5 * street_m, []
    for x0, x1 in pairwise(x):
        for y0, y1 in pairwise(y):
            is_open = rng.random() < OPEN_BLOCK
            if not is_open and min(x1 - x0, y1 - y0) > 1.2 * street_m:
                blocks.append(rectangle((x0 + half, y0 + half), (x1 - half, y1 - half)))
    return blocks


def rooms(
    rng: np.random.Generator, low: Corner, high: Corner, room_m: float, door_m: float, wall_m: float
) -> list[Shape]:
    """Rooms in rows and columns, with walls around all, and doors that connect every room to every other."""
    x, y = (_lines(rng, a, b, room_m) for a, b in zip(low[:2], high[:2], strict=True))
    columns, rows = len(x) - 1, len(y) - 1
    right, up = _doors(rng, columns, rows)
    walls = []
    for i, x_wall in enumerate(x):
        for j in range(rows):
            has_door = 0 < i < columns and right[i - 1, j]
            walls += _wall(rng, x_wall, (y[j], y[j + 1]), door_m if has_door else 0.0, wall_m, upright=True)
    for j, y_wall in enumerate(y):
        for i in range(columns):
            has_door = 0 < j < rows and up[i, j - 1]
            walls += _wall(rng, y_wall, (x[i], x[i + 1]), door_m if has_door else 0.0, wall_m, upright=False)
    return walls


def _lines(rng: np.random.Generator, low: float, high: float, width: float) -> Float[np.ndarray, " lines"]:
    """Lines about `width` apart from low to high, those between them shifted a little."""
    count = max(1, round((high - low) / width))
    lines = np.linspace(low, high, count + 1)
    lines[1:-1] += JITTER * (high - low) / count * rng.uniform(-1.0, 1.0, count - 1)
    return lines


def _doors(
    rng: np.random.Generator, columns: int, rows: int
) -> tuple[Bool[np.ndarray, "i j"], Bool[np.ndarray, "k l"]]:
    """Doors to the right of and above each room: a random spanning tree of the rooms, and some more."""
    right, up = np.zeros((max(0, columns - 1), rows), bool), np.zeros((columns, max(0, rows - 1)), bool)
    edges = [((i, j), (i + 1, j)) for i in range(columns - 1) for j in range(rows)]
    edges += [((i, j), (i, j + 1)) for i in range(columns) for j in range(rows - 1)]
    group = {(i, j): (i, j) for i in range(columns) for j in range(rows)}
    for index in rng.permutation(len(edges)):
        here, there = edges[index]
        is_needed = group[here] != group[there]
        if is_needed:
            old, new = group[there], group[here]
            group = {room: new if name == old else name for room, name in group.items()}
        if is_needed or rng.random() < EXTRA_DOOR:
            (up if here[0] == there[0] else right)[here] = True
    return right, up


def _wall(
    rng: np.random.Generator, at: float, ends: tuple[float, float], door_m: float, wall_m: float, upright: bool
) -> list[Shape]:
    """A wall between two places along a line, as one piece or as those beside a door."""
    half, (start, end) = 0.5 * wall_m, ends
    pieces = [(start - half, end + half)]
    if door_m > 0.0:
        begin = rng.uniform(start + half, max(start + half, end - half - door_m))
        pieces = [(start - half, begin), (begin + door_m, end + half)]
    # A piece shorter than it is thick is a part of the wall that crosses there.
    long = [(a, b) for a, b in pieces if b - a >= wall_m]
    across = (at - half, at + half)
    return [
        rectangle(*zip(across, piece, strict=True)) if upright else rectangle(*zip(piece, across, strict=True))
        for piece in long
    ]
