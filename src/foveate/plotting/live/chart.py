"""Numbers and curves of an episode up to a moment, and their chart in the scene of a page without a panel."""

from typing import Any

import numpy as np
from jaxtyping import Float

from foveate.io.figures import BLACK, GREY
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData, axis_range
from foveate.plotting.live.primitives import add_line, segments, set_segments

LEGEND = (
    "beliefs (95 %): green, thick: detected, or a confirmed track; orange, thin: not; black: true targets; purple: "
    "targets expected but never detected"
)
CURVES = "log det [nat]: targets (grey), mean (black)"
MAX_CURVES = 20
"""With more targets, only the mean is drawn."""

TICKS = 4


def curves(data: EpisodeData) -> Float[np.ndarray, "steps curves"]:
    """Mean log det after each step [nat], then that of each target; the last mean where none is present.

    Where targets come and go there is the mean alone: an end of a curve would look like a loss of all information.
    """
    mean = data.mean_log_det
    present = np.maximum.accumulate(np.where(np.isfinite(mean), np.arange(data.steps), -1))
    held = np.where(present >= 0, mean[present], np.nan)
    is_alike = data.tracks is None and data.targets <= MAX_CURVES and data.present.all()
    each = data.log_det_present if is_alike else np.zeros((data.steps, 0))
    return np.column_stack([held, each])


def facts(data: EpisodeData, moment: int) -> dict[str, str]:
    """Time, step, score so far, targets detected, share of time in view, and, where all stay, targets ever detected.

    Of a team also the messages that have arrived in the last step.
    """
    k = moment // SUBSTEPS
    score = data.mean_log_det[k - 1] if k else np.nan
    tracks = data.tracks
    values = {
        "time": f"{data.time_at(moment):.1f} of {data.times_s[-1]:.1f} s",
        "step": f"{k} of {data.steps}",
        "score so far": f"{score:.2f} nat per target" if np.isfinite(score) else "-",
        "detected now": f"{data.seen_at(k).sum()} of {data.present[k].sum()}",
        "in view": f"{data.seen_share_until(k):.0%}",
    }
    if tracks is not None:
        values["score so far"] = "-"
        values["confirmed tracks"] = f"{tracks.confirmed[k].sum()}"
        values["expected targets"] = f"{tracks.expected[k]:.1f}"
    # Where targets come and go, several may share a column: their number would not be that of targets.
    elif data.present.all():
        values["ever detected"] = f"{data.visible[:k].any(axis=0).sum()} of {data.targets}"
    if data.heard is not None:
        robots, heard = data.heard.shape[1], data.heard[k - 1].sum() if k else 0
        values["messages heard"] = f"{heard} of {robots * (robots - 1)} (grey lines; dashed: one way)"
    return values


class SceneChart:
    """Chart of the curves behind the scene, labelled with time, score and targets detected."""

    def __init__(self, scene: Any, data: EpisodeData, box: Float[np.ndarray, "2 3"]) -> None:
        self._data, values, width = data, curves(data), float(np.ptp(box[:, 0]))
        (low, high), height = axis_range(values), 0.35 * width
        # Behind the far side of the box, on the floor of a planar scene or above a spatial one, nothing hides it.
        self._corner = corner = np.array([box[0, 0], box[1, 1] + 0.25 * np.ptp(box[:, 1]), box[1, 2]])
        self._across = width * (data.times_s / (data.times_s[-1] or 1.0))
        self._up = height * ((values - low) / (high - low))
        frame = corner + np.array([[0, 0, height], [0, 0, 0], [width, 0, 0]])
        add_line(scene, "/chart/frame", GREY, 1.5, segments(frame))
        text: dict[str, Any] = {"font_size_mode": "scene", "font_scene_height": 0.045 * width}
        for i in range(TICKS):
            share = i / (TICKS - 1)
            value, position = low + share * (high - low), corner + np.array([0, 0, share * height])
            scene.add_label(f"/chart/{i}", f"{value:.1f}", position=position, anchor="center-right", **text)
        text["font_scene_height"] = 0.03 * width
        scene.add_label("/chart/text", CURVES, position=corner + np.array([0, 0, -0.02 * width]), **text)
        self._each, self._mean = add_line(scene, "/chart/each", GREY, 1.5), add_line(scene, "/chart/mean", BLACK, 3.0)
        text |= {"position": corner + np.array([0, 0, 1.12 * height]), "anchor": "bottom-left"}
        self._label = scene.add_label("/chart/facts", "", **text)

    def show(self, moment: int) -> None:
        """Draw the curves up to a moment of the episode."""
        k = moment // SUBSTEPS
        points = np.zeros((k, self._up.shape[1], 3)) + self._corner
        points[..., 0] += self._across[1 : k + 1, None]
        points[..., 2] += self._up[:k]
        lines = [segments(points[:, i]) for i in range(points.shape[1])] if k > 1 else [np.zeros((0, 2, 3))]
        set_segments(self._mean, lines[:1])
        set_segments(self._each, lines[1:])
        values = facts(self._data, moment)
        names = ("time", "score so far", "detected now", "messages heard")
        self._label.text = " · ".join(f"{name} {values[name]}" for name in names if name in values)
