"""The robots of a spatial scene: their body, and those of a team beside the first, with who has heard whom."""

from typing import Any

import numpy as np
from jaxtyping import Float
from mpl_toolkits.mplot3d.art3d import Line3D, Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from foveate.geometry.numpy_poses import arc, placed, positions
from foveate.io.figures import BLUE, GREY
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData
from foveate.plotting.mates import links

DART = np.array([[1.1, 0, 0], [-0.8, 0.65, 0], [-0.8, -0.65, 0], [-0.8, 0, 0.5]])
DART_FACES, DART_COLORS = ((0, 1, 3), (0, 2, 3), (0, 1, 2), (1, 2, 3)), (BLUE, "#00568A", "#003A5E", "#003A5E")
"""A robot, its nose along +x and its fin up, lit from its left."""


class SpatialMates:
    """Robots beside the first: their paths, the edges of their views, bodies, and lines as in `mates.Mates`."""

    def __init__(self, axes: Axes3D, data: EpisodeData, trail: int | None, size: float, scale: float) -> None:
        assert data.mates is not None, "of a team's episodes"
        self.data, self.trail, self.size = data, trail, size
        self.arcs = [arc(poses, SUBSTEPS) for poses in np.moveaxis(data.mates, 1, 0)]

        def line(color: str, **style: Any) -> Any:
            return axes.add_line(Line3D([], [], [], color=color, **style))

        self.paths = [line(BLUE, lw=0.9 * scale, zorder=4) for _ in self.arcs]
        self.edges: list[Any] = []
        self.bodies: list[Any] = []
        for _ in self.arcs:
            edges = Line3DCollection([], colors=BLUE, linewidths=0.6 * scale, zorder=5.1)
            body = Poly3DCollection([], facecolors=DART_COLORS, edgecolors="white", linewidths=0.4 * scale, zorder=8.0)
            self.edges.append(axes.add_collection3d(edges, autolim=False))
            self.bodies.append(axes.add_collection3d(body, autolim=False))
        self.both = line(GREY, lw=0.9 * scale, zorder=4.5)
        self.one = line(GREY, lw=0.9 * scale, ls=(0, (1, 2)), zorder=4.5)

    def show(self, first: Float[np.ndarray, "4 4"], moment: int) -> None:
        """Move to a moment, at which the first robot has a pose."""
        begin = 0 if self.trail is None else max(0, moment // SUBSTEPS - self.trail) * SUBSTEPS
        for course, outline, edges, body, path in zip(
            self.arcs, self.data.outlines[1:], self.edges, self.bodies, self.paths, strict=True
        ):
            pose = course[moment]
            path.set_data_3d(*positions(course[begin : moment + 1]).T)
            edges.set_segments([placed(pose, border) for border in outline])
            body.set_verts([placed(pose, self.size * DART[list(face)]) for face in DART_FACES])
        both, one = links(self.data, np.stack([first, *(course[moment] for course in self.arcs)]), moment)
        self.both.set_data_3d(*both.T)
        self.one.set_data_3d(*one.T)
