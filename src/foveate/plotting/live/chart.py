"""What the numbers of an episode are as it unfolds: beside the scene, and in it, where a page has no panel."""

from typing import Any

import numpy as np
from jaxtyping import Float

from foveate.plotting.episode_data import SUBSTEPS, EpisodeData
from foveate.plotting.live.scene import color, segments
from foveate.plotting.scene import BLACK, GREY

LEGEND = "beliefs (95 %): green, thick: seen now; orange, thin: not seen now; black: where targets really are"


MOST_CURVES = 20
"""Of more targets than that only the mean is drawn."""


TICKS = 4


def curves(film: EpisodeData) -> Float[np.ndarray, "steps curves"]:
    """log det of each target's information after each step [nat], NaN where it is not there; first their mean."""
    known = np.where(film.present[1:], film.log_det, np.nan)
    count = np.isfinite(known).sum(axis=1)
    mean = np.where(count > 0, np.nansum(known, axis=1) / np.maximum(count, 1), np.nan)
    return np.column_stack([mean, known if film.targets <= MOST_CURVES else known[:, :0]])


def span(values: Float[np.ndarray, "*m"]) -> tuple[float, float]:
    """Lowest and highest value, with a margin."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    pad = 0.06 * (high - low) + 0.1
    return low - pad, high + pad


def facts(film: EpisodeData, moment: int) -> dict[str, str]:
    """Time, step, score so far, who is seen now, for how long targets were, and, where all stay, who ever was."""
    k = moment // SUBSTEPS
    time_s = float(np.interp(moment / SUBSTEPS, np.arange(film.steps + 1), film.times_s))
    here = film.present[k]
    now = int((film.seen_at(k) & here).sum())
    seen = film.visible[:k] & film.counted[:k]
    score = curves(film)[k - 1, 0] if k else np.nan
    told = {
        "time": f"{time_s:.1f} of {film.times_s[-1]:.1f} s",
        "step": f"{k} of {film.steps}",
        "score so far": f"{score:.2f} nat per target" if np.isfinite(score) else "-",
        "seen now": f"{now} of {here.sum()}",
        "of the time": f"{seen.sum() / max(1, film.counted[:k].sum()):.0%}",
    }
    # Where targets come and go, a column may serve several.
    return told | {"ever seen": f"{seen.any(axis=0).sum()} of {film.targets}"} if film.present.all() else told


class Board:
    """The curves as a board that stands behind the scene, and time, score and who is seen as a label above it."""

    def __init__(self, scene: Any, film: EpisodeData, box: Float[np.ndarray, "2 3"]) -> None:
        self._film, self._curves = film, curves(film)
        low, high = span(self._curves)
        width = float(np.ptp(box[:, 0]))
        height = 0.35 * width
        # It stands on the floor of a planar scene, and hangs over one of space.
        corner = np.array([box[0, 0], box[1, 1] + 0.25 * np.ptp(box[:, 1]), box[1, 2]])
        steps = film.times_s / (film.times_s[-1] or 1.0)
        self._corner, self._across, self._up = corner, width * steps, height
        self._share = (self._curves - low) / (high - low)
        frame = corner + np.array([[0, 0, height], [0, 0, 0], [width, 0, 0]])
        wide: dict[str, Any] = {"thickness_units": "screen"}
        scene.add_line_segments("/board/frame", segments(frame), color(GREY), thickness=1.5, **wide)
        text: dict[str, Any] = {"font_size_mode": "scene", "font_scene_height": 0.045 * width}
        for i in range(TICKS):
            share = i / (TICKS - 1)
            value, position = low + share * (high - low), corner + np.array([0, 0, share * height])
            scene.add_label(f"/board/{i}", f"{value:.1f}", position=position, anchor="center-right", **text)
        unit = "log det of information of each target, and their mean (black) [nat], over time"
        text["font_scene_height"] = 0.03 * width
        for i, line in enumerate((unit, LEGEND)):
            below = corner + np.array([0, 0, -(0.02 + 0.045 * i) * width])
            scene.add_label(f"/board/text/{i}", line, position=below, **text)
        none = np.zeros((1, 2, 3))
        self._each = scene.add_line_segments("/board/each", none, color(GREY), thickness=1.5, **wide)
        self._mean = scene.add_line_segments("/board/mean", none, color(BLACK), thickness=3.0, **wide)
        top = corner + np.array([0, 0, 1.12 * height])
        self._label = scene.add_label("/board/facts", "", position=top, anchor="bottom-left", **text)

    def show(self, moment: int) -> None:
        """Draw what is known at a moment of the film."""
        k = moment // SUBSTEPS
        points = np.zeros((k, self._share.shape[1], 3)) + self._corner
        points[..., 0] += self._across[1 : k + 1, None]
        points[..., 2] += self._up * self._share[:k]
        lines = [segments(points[:, i]) for i in range(points.shape[1])] if k > 1 else [np.zeros((0, 2, 3))]
        for handle, parts in ((self._mean, lines[:1]), (self._each, lines[1:])):
            drawn = np.concatenate([*parts, np.zeros((0, 2, 3))])
            handle.visible = bool(len(drawn))
            if len(drawn):
                handle.points = drawn
        told = facts(self._film, moment)
        self._label.text = " · ".join(f"{name} {told[name]}" for name in ("time", "score so far", "seen now"))
