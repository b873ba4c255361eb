"""Scene of an episode in a browser, drawn by viser; a planar episode lies on the floor.

Everything is added once and then moved. Each column of the episode has its bodies, hidden while no target is present.
"""

from typing import Any

import numpy as np
from jaxtyping import UInt8

from foveate.geometry.numpy_poses import rotation
from foveate.io.figures import BLACK, GREY, PURPLE
from foveate.plotting.ellipsoids import CIRCLE, box_lines, lifted
from foveate.plotting.episode_data import SUBSTEPS, TRAIL_STEPS, EpisodeData
from foveate.plotting.live.mates import LiveMates, add_robot
from foveate.plotting.live.primitives import (
    add_line,
    ball,
    color,
    disc,
    quaternion,
    segments,
    set_segments,
    turn_and_scale,
)
from foveate.plotting.scene import AGENT, BORDER, SEEN, UNSEEN
from foveate.plotting.scene_spatial import scene_class
from foveate.plotting.snapshot import snapshot
from foveate.plotting.undetected import DARKEST
from foveate.plotting.walls import WALL, loops

LAYER = 0.01
"""Height of a planar layer over the one below, in sizes of the agent: in one plane they would flicker."""

MAX_NAMES = 20
"""With more targets, none has its number beside it: they would cover the scene."""

PIXELS = 8
"""Pixels along the side of a cell of undetected targets."""


class LiveScene:
    """Episode in a viser scene; `show` moves it to a moment."""

    def __init__(self, scene: Any, data: EpisodeData) -> None:
        self.data, self._arc, self._scene = data, data.arc(), scene
        planar = data.space.dimension == 2
        self.box = lifted(scene_class(data).limits([data]))
        extent = float(np.ptp(self.box[:, :2], axis=0).max())
        self.size = (0.028 if planar else 0.02) * extent
        unit = disc() if planar else ball()
        rings = [lifted(CIRCLE)] if planar else [np.roll(lifted(CIRCLE), turn, axis=1) for turn in range(3)]
        border = np.concatenate([segments(ring) for ring in rings])
        # Shadows show heights.
        scene.configure_default_lights(cast_shadow=not planar)
        self._floor(extent)
        self._map, self._pictures = _map(scene, data, float(self.box[0, 2]) - 0.0005 * extent)
        if data.walls is not None:
            add_line(scene, "/walls", WALL, 2.5, np.concatenate([segments(lifted(loop)) for loop in loops(data.walls)]))
        self._agent = add_robot(scene, "/agent", data, 0, self.size)
        self._mates = None if data.mates is None else LiveMates(scene, data, self.size, LAYER * self.size)
        glass: dict[str, Any] = {"side": "double", "cast_shadow": False}
        self._path, self._trails = add_line(scene, "/path", AGENT, 2.5), add_line(scene, "/trails", GREY, 1.5)
        if data.region is not None:
            add_line(
                scene, "/region", BORDER, 2.0, np.concatenate([segments(lifted(e)) for e in box_lines(data.region)])
            )
        self._beliefs, self._borders, self._means, self._targets, self._names = [], [], [], [], []
        for i in range(data.believed.shape[1]):
            belief = scene.add_mesh_simple(f"/belief/{i}", *unit, opacity=0.35, receive_shadow=False, **glass)
            self._beliefs.append(belief)
            self._borders.append(add_line(scene, f"/border/{i}", SEEN, 2.0, border))
            self._means.append(scene.add_icosphere(f"/estimate/{i}", 0.3 * self.size, color=color(SEEN)))
        for i in range(data.targets):
            box = scene.add_box(f"/target/{i}", color=color(BLACK), dimensions=(0.45 * self.size,) * 3)
            self._targets.append(box)
            if data.targets <= MAX_NAMES:
                self._names.append(scene.add_label(f"/name/{i}", "", anchor="bottom-left"))

    def _floor(self, extent: float) -> None:
        """Add the floor, as large as the scene: a grid of 2 to 20 cells across, whose side is a power of ten [m]."""
        middle = self.box.mean(axis=0)
        floor = (middle[0], middle[1], self.box[0, 2] - 0.001 * extent)
        cell = 10.0 ** np.floor(np.log10(extent / 2))
        width, height = (float(side) for side in np.ceil(5 * np.ptp(self.box[:, :2], axis=0) / cell + 1) * cell / 5)
        style: dict[str, Any] = {"cell_color": (225, 225, 225), "section_color": (190, 190, 190), "plane": "xy"}
        self._scene.add_grid("/floor", width, height, position=floor, cell_size=cell / 5, section_size=cell, **style)

    def camera(self) -> tuple[np.ndarray, np.ndarray]:
        """Position of a camera that sees the whole scene, and the point it looks at [m]."""
        middle = self.box.mean(axis=0)
        steep = 1.1 if self.data.space.dimension == 2 else 0.35
        return middle + np.ptp(self.box, axis=0).max() * np.array([-0.12, -0.7, steep]), middle

    def show(self, moment: int) -> None:
        """Move everything to a moment of the episode."""
        state = snapshot(self.data, self._arc, moment, TRAIL_STEPS)
        layer = LAYER * self.size
        R = rotation(state.pose)
        self._agent.position = lifted(state.path[-1], 3 * layer)
        self._agent.wxyz = quaternion(R)
        set_segments(self._path, [segments(lifted(state.path, 2 * layer))])
        tracks = np.where(state.tracked[..., None], state.tracks, np.nan)
        set_segments(self._trails, [segments(lifted(track, layer)) for track in tracks.swapaxes(0, 1)])
        if self._mates is not None:
            self._mates.show(state.pose, moment)
        if self._map is not None:
            self._map.image = self._pictures[moment // SUBSTEPS]
        mean, truth = lifted(state.estimate, 4 * layer), lifted(state.truth, 5 * layer)
        for i, bodies in enumerate(zip(self._beliefs, self._borders, self._means, strict=True)):
            belief, border, estimate = bodies
            for each in bodies:
                each.visible = i < len(mean)
            if i >= len(mean):
                continue
            tint, (turn, scale) = color(SEEN if state.seen[i] else UNSEEN), turn_and_scale(state.covariance[i])
            for each in (belief, border):
                each.position, each.wxyz, each.scale = mean[i], turn, scale
            belief.color = estimate.color = tint
            belief.opacity = 0.35 * float(state.existence[i])
            border.colors = np.array(tint, np.uint8)
            # For colour-blind readers beliefs differ in thickness, too.
            border.thickness = 4.0 if state.seen[i] else 1.5
            estimate.position = mean[i]
        for i, target in enumerate(self._targets):
            for each in (target, *self._names[i : i + 1]):
                each.visible = i < len(truth)
                if i < len(truth):
                    each.position = truth[i]
            for name in self._names[i : i + 1] if i < len(truth) else ():
                name.text = f"{state.columns[i] + 1}"


def _map(scene: Any, data: EpisodeData, height_m: float) -> tuple[Any, UInt8[np.ndarray, "instants y x 3"]]:
    """Lay the map of undetected targets on the floor, if there is one; return it, and its pictures over time.

    The more targets are expected in a cell, or above it, the darker it is.
    """
    tracks = data.tracks
    if tracks is None or tracks.undetected is None:
        return None, np.zeros((0, 0, 0, 3), np.uint8)
    cells, (low, high) = tracks.undetected, tracks.box
    number = cells if cells.ndim == 3 else cells.sum(axis=-1)
    level = np.swapaxes(number, 1, 2)[..., None] / max(float(number.max()), 1e-12)
    pictures = (255 + DARKEST * level * (np.array(color(PURPLE)) - 255)).astype(np.uint8)
    middle = (*(0.5 * (low + high))[:2], height_m)
    width, depth = (float(side) for side in (high - low)[:2])
    # Cells keep sharp borders: browsers blend the pixels of small pictures.
    pictures = pictures.repeat(PIXELS, axis=1).repeat(PIXELS, axis=2)
    plain = {"format": "png", "cast_shadow": False, "receive_shadow": False}
    return scene.add_image("/undetected", pictures[0], width, depth, position=middle, **plain), pictures


def aim_cameras(server: Any, scene: LiveScene) -> None:
    """Aim the cameras of all clients, present and future, at the whole scene."""
    position, middle = scene.camera()
    for camera in (server.initial_camera, *(client.camera for client in server.get_clients().values())):
        camera.position, camera.look_at = position, middle
