"""The other robots of a team in a browser's scene, and who has heard whom."""

from typing import Any

import numpy as np
from jaxtyping import Float

from foveate.geometry.numpy_poses import arc, positions, rotation
from foveate.io.figures import BLUE, GREY, SKY
from foveate.plotting.ellipsoids import lifted
from foveate.plotting.episode_data import SUBSTEPS, TRAIL_STEPS, EpisodeData
from foveate.plotting.live.primitives import add_line, color, quaternion, segments, set_segments, view_mesh
from foveate.plotting.mates import links
from foveate.plotting.mates_spatial import DART, DART_FACES

DASHES = 12
"""Dashes of a line between two robots of which only one has heard the other."""


def add_robot(scene: Any, name: str, data: EpisodeData, number: int, size: float) -> Any:
    """Add a robot with its body of a size [m] and its view; return its frame, which moves both."""
    frame = scene.add_frame(name, show_axes=False)
    planar, outline = data.space.dimension == 2, data.outlines[number]
    view = view_mesh(outline)
    if len(view[1]):
        glass: dict[str, Any] = {"side": "double", "cast_shadow": False, "opacity": 0.25 if planar else 0.12}
        scene.add_mesh_simple(f"{name}/view", *view, color=color(SKY), **glass)
    lines = np.concatenate([segments(lifted(line)) for line in outline])
    add_line(scene, f"{name}/border", BLUE, 1.5, lines)
    body = size * DART, np.array(DART_FACES)
    scene.add_mesh_simple(f"{name}/body", *body, color=color(BLUE), side="double", flat_shading=True)
    return frame


class LiveMates:
    """Robots beside the first, with their paths, and lines between two of which one has heard the other.

    A line is whole where both have heard each other in the last step, and dashed where one has. `layer` is the height
    of a planar layer [m].
    """

    def __init__(self, scene: Any, data: EpisodeData, size: float, layer: float) -> None:
        assert data.mates is not None, "of a team's episodes"
        self._data, self._layer = data, layer
        self._arcs = [arc(poses, SUBSTEPS) for poses in np.moveaxis(data.mates, 1, 0)]
        self._robots = [add_robot(scene, f"/mate/{i}", data, 1 + i, size) for i in range(len(self._arcs))]
        self._paths = add_line(scene, "/mates/paths", BLUE, 1.5)
        self._links = add_line(scene, "/mates/heard", GREY, 2.0)

    def show(self, first: Float[np.ndarray, "..."], moment: int) -> None:
        """Move to a moment, at which the first robot has a pose."""
        begin, poses = max(0, moment // SUBSTEPS - TRAIL_STEPS) * SUBSTEPS, [course[moment] for course in self._arcs]
        for robot, pose in zip(self._robots, poses, strict=True):
            robot.position, robot.wxyz = lifted(positions(pose), 3 * self._layer), quaternion(rotation(pose))
        paths = [segments(lifted(positions(course[begin : moment + 1]), 2 * self._layer)) for course in self._arcs]
        set_segments(self._paths, paths)
        both, one = (lifted(each, 2 * self._layer) for each in links(self._data, np.stack([first, *poses]), moment))
        set_segments(self._links, [segments(both), dashed(segments(one))])


def dashed(lines: Float[np.ndarray, "m 2 3"]) -> Float[np.ndarray, "dashes 2 3"]:
    """Cut each line into dashes as long as the gaps between them."""
    ends = (np.arange(2 * DASHES) / (2 * DASHES - 1)).reshape(DASHES, 2, 1)
    return (lines[:, None, :1] + ends * (lines[:, None, 1:] - lines[:, None, :1])).reshape(-1, 2, 3)
