"""One film in viser's 3-D scene: what `drawing` is for the plane and `drawing_spatial` for space, in a browser.

A planar scene lies on the floor. Everything is made once and then moved; as many bodies stand ready as a film has
columns, and those that have nothing to show are hidden.
"""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.colors import to_rgb
from scipy.spatial.transform import Rotation

from foveate.geometry.numpy_poses import rotation
from foveate.plotting.ellipsoids import CHI_SQUARE_95 as SPATIAL_95
from foveate.plotting.ellipsoids import CIRCLE, faces
from foveate.plotting.episode_data import EpisodeData, snapshot
from foveate.plotting.scene import AGENT, BLACK, GREY, SEEN, SKY, UNSEEN
from foveate.plotting.scene import CHI_SQUARE_95 as PLANAR_95
from foveate.plotting.scene_spatial import DART, DART_FACES, scene_axes_of

TRAIL_STEPS = 40


FLAT_M = 0.01
"""Planar things lie this far above the floor, times their rank, so that they do not flicker."""


Mesh = tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]


def color(name: str) -> tuple[int, int, int]:
    """A colour as viser wants it."""
    red, green, blue = (round(255 * part) for part in to_rgb(name))
    return red, green, blue


def lifted(points: Float[np.ndarray, "*m d"], height: float = 0.0) -> Float[np.ndarray, "*m 3"]:
    """Points of the plane in space; those of space as they are."""
    if points.shape[-1] == 3:
        return points
    return np.concatenate([points, np.full((*points.shape[:-1], 1), height)], axis=-1)


def segments(line: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 2 3"]:
    """A line as viser draws it, without those parts that have an end at NaN."""
    pairs = np.stack([line[:-1], line[1:]], axis=1)
    return pairs[np.isfinite(pairs).all(axis=(1, 2))]


def ball() -> Mesh:
    """A unit sphere of 12 x 24 faces."""
    polar, around = np.meshgrid(np.linspace(0, np.pi, 13), np.linspace(0, 2 * np.pi, 25), indexing="ij")
    points = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
    corner = np.arange(12)[:, None] * 25 + np.arange(24)
    quads = np.stack([corner, corner + 25, corner + 26, corner + 1], axis=-1).reshape(-1, 4)
    return points.reshape(-1, 3), np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def disc() -> Mesh:
    """A unit disc on the floor."""
    n = len(CIRCLE)
    rim = np.stack([np.full(n - 1, n), np.arange(n - 1), np.arange(1, n)], axis=-1)
    return np.concatenate([lifted(CIRCLE), np.zeros((1, 3))]), rim


def fan(line: Float[np.ndarray, "n d"]) -> Mesh:
    """The area within a closed line: from the apex, where the line passes through the origin, else from its middle."""
    points = lifted(line)
    apex = np.abs(points).sum(axis=1) < 1e-9
    middle = np.zeros(3) if apex.any() else points[:-1].mean(axis=0)
    n = len(points)
    return np.concatenate([points, [middle]]), np.stack([np.full(n - 1, n), np.arange(n - 1), np.arange(1, n)], -1)


def view_mesh(film: EpisodeData) -> Mesh:
    """The faces of the field of view in the body frame."""
    polygons = faces(film.outline) if film.space.dimension == 3 else film.outline
    closed = [line if np.allclose(line[0], line[-1]) else np.concatenate([line, line[:1]]) for line in polygons]
    meshes = [fan(line) for line in closed]
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    parts = [triangles + start for (_, triangles), start in zip(meshes, starts[:-1], strict=True)]
    empty: list[Any] = [np.zeros((0, 3))]
    return np.concatenate([v for v, _ in meshes] or empty), np.concatenate(parts or empty).astype(int)


def quaternion(R: Float[np.ndarray, "d d"]) -> Float[np.ndarray, "4"]:
    """[w, x, y, z] of a rotation of the plane or of space."""
    full = np.eye(3)
    full[: len(R), : len(R)] = R
    return Rotation.from_matrix(full).as_quat(scalar_first=True)


def axes_of(covariance: Float[np.ndarray, "d d"]) -> tuple[Float[np.ndarray, "4"], tuple[float, float, float]]:
    """How the unit disc or sphere is turned, and how long its semi-axes are [m], to hold 95 % of N(0, covariance)."""
    values, vectors = np.linalg.eigh(covariance)
    vectors[:, 0] *= np.sign(np.linalg.det(vectors))
    limit = SPATIAL_95 if len(values) == 3 else PLANAR_95
    first, second, *third = np.sqrt(limit * np.maximum(values, 1e-12)).tolist()
    return quaternion(vectors), (first, second, third[0] if third else 1.0)


class LiveScene:
    """A film in a viser scene. `show` moves it to a moment (see `film.snapshot`)."""

    def __init__(self, scene: Any, film: EpisodeData) -> None:
        self.film, self._arc, self._scene = film, film.arc(), scene
        planar = film.space.dimension == 2
        self.box = lifted(scene_axes_of(film).limits([film]))
        extent = float(np.ptp(self.box[:, :2], axis=0).max())
        self.size = (0.028 if planar else 0.02) * extent
        unit = disc() if planar else ball()
        rings = [lifted(CIRCLE)] if planar else [np.roll(lifted(CIRCLE), turn, axis=1) for turn in range(3)]
        border = np.concatenate([segments(ring) for ring in rings])
        # Shadows tell how high things are.
        scene.configure_default_lights(cast_shadow=not planar)
        self._floor(extent)
        self._agent = scene.add_frame("/agent", show_axes=False)
        view, dart = view_mesh(film), (self.size * DART, np.array(DART_FACES))
        lines = np.concatenate([segments(lifted(line)) for line in film.outline])
        wide: dict[str, Any] = {"thickness_units": "screen"}
        if len(view[1]):
            style: dict[str, Any] = {"opacity": 0.25 if planar else 0.12, "side": "double", "cast_shadow": False}
            scene.add_mesh_simple("/agent/view", *view, color=color(SKY), **style)
        scene.add_line_segments("/agent/border", lines, color(AGENT), thickness=1.5, **wide)
        scene.add_mesh_simple("/agent/body", *dart, color=color(AGENT), side="double", flat_shading=True)
        none = np.zeros((1, 2, 3))
        self._path = scene.add_line_segments("/path", none, color(AGENT), thickness=2.5, **wide)
        self._trails = scene.add_line_segments("/trails", none, color(GREY), thickness=1.5, **wide)
        glass: dict[str, Any] = {"opacity": 0.35, "side": "double", "cast_shadow": False, "receive_shadow": False}
        self._beliefs, self._borders, self._means, self._targets = [], [], [], []
        for i in range(film.targets):
            self._beliefs.append(scene.add_mesh_simple(f"/belief/{i}", *unit, **glass))
            self._borders.append(scene.add_line_segments(f"/border/{i}", border, color(SEEN), thickness=2.0, **wide))
            self._means.append(scene.add_icosphere(f"/estimate/{i}", 0.3 * self.size, color=color(SEEN)))
            side = (0.45 * self.size,) * 3
            self._targets.append(scene.add_box(f"/target/{i}", color=color(BLACK), dimensions=side))

    def _floor(self, extent: float) -> None:
        middle = self.box.mean(axis=0)
        floor = (middle[0], middle[1], self.box[0, 2] - 0.001 * extent)
        cell = 10.0 ** np.floor(np.log10(extent / 2))
        width, height = (float(side) for side in np.ceil(np.ptp(self.box[:, :2], axis=0) / cell + 1) * cell)
        style: dict[str, Any] = {"cell_color": (225, 225, 225), "section_color": (190, 190, 190)}
        self._scene.add_grid(
            "/floor", width, height, position=floor, cell_size=cell / 5, section_size=cell, plane="xy", **style
        )

    def camera(self) -> tuple[np.ndarray, np.ndarray]:
        """Where to look at the whole from, and at what [m]."""
        middle = self.box.mean(axis=0)
        steep = 1.1 if self.film.space.dimension == 2 else 0.35
        return middle + np.ptp(self.box, axis=0).max() * np.array([-0.12, -0.7, steep]), middle

    def show(self, moment: int) -> None:
        """Move everything to a moment of the film."""
        now = snapshot(self.film, self._arc, moment, TRAIL_STEPS)
        low = FLAT_M * self.size
        R = rotation(now.pose)
        self._agent.position = lifted(now.path[-1], 3 * low)
        self._agent.wxyz = quaternion(R)
        self._set_line(self._path, segments(lifted(now.path, 2 * low)))
        tracks = np.where(now.tracked[..., None], now.tracks, np.nan)
        trails = [segments(lifted(track, low)) for track in tracks.swapaxes(0, 1)]
        self._set_line(self._trails, np.concatenate([*trails, np.zeros((0, 2, 3))]))
        mean, truth = lifted(now.estimate, 4 * low), lifted(now.truth, 5 * low)
        for i in range(self.film.targets):
            here = i < len(truth)
            for each in (self._beliefs[i], self._borders[i], self._means[i], self._targets[i]):
                each.visible = here
            if not here:
                continue
            tint, (turn, lengths) = color(SEEN if now.seen[i] else UNSEEN), axes_of(now.covariance[i])
            for each in (self._beliefs[i], self._borders[i]):
                each.position, each.wxyz, each.scale = mean[i], turn, lengths
            self._beliefs[i].color = self._means[i].color = tint
            self._borders[i].colors = np.array(tint, np.uint8)
            # Colour is not all that tells them apart.
            self._borders[i].thickness = 4.0 if now.seen[i] else 1.5
            self._means[i].position, self._targets[i].position = mean[i], truth[i]

    def _set_line(self, handle: Any, points: np.ndarray) -> None:
        handle.visible = bool(len(points))
        if len(points):
            handle.points = points
