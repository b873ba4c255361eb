"""Animation of an episode: the scene beside the information about each target."""

import io
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from foveate.errors import InputError
from foveate.io.figures import BLACK, GREY, drawable, literal, new_figure, over_time
from foveate.io.files import write_atomic
from foveate.plotting.episode_data import SUBSTEPS, TRAIL_STEPS, EpisodeData, axis_range
from foveate.plotting.scene import SEEN, PlanarScene, broken, describe, legend_entries
from foveate.plotting.scene_spatial import scene_class
from foveate.plotting.undetected import draw_counts

DPI = 100
COLORS = 128
HOLD_S = 1.5
"""Duration of the last frame, before the animation repeats."""


def animate(data: EpisodeData, path: Path | str, fps: int = 10, size: tuple[int, int] = (900, 500)) -> None:
    """Write an episode as a `.gif` that loops, as `.mp4` (through ffmpeg), or its last moment as `.png`.

    Left, the scene: agent, path, view, targets with tracks, estimates with 95 % ellipses or ellipsoids; right, log det
    of each target's information after every step, a dot where it was measured, and the mean; of detections without ids
    the numbers of targets, of confirmed tracks, and of targets as the filter expects them. Up to three frames a
    step, at most 150 in all, or 100 in space: a long episode skips instants. `size` is in pixels, even numbers. Raises
    InputError for another ending, a bad size or `fps`, and for `.mp4` where ffmpeg is missing or fails.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in (".gif", ".mp4", ".png"):
        raise InputError(f"{path}: expected a name that ends in .gif, .mp4 or .png")
    if min(size) < 200 or any(side % 2 for side in size):
        raise InputError(f"size = {size}: expected two even numbers of pixels, at least 200")
    _check_rate(fps)
    if kind == ".mp4" and shutil.which("ffmpeg") is None:
        raise InputError(f"{path}: ffmpeg is missing: install it, or write a .gif")
    moments = frame_moments(data.steps, scene_class(data).max_frames)
    if kind == ".png":
        buffer = io.BytesIO()
        Image.fromarray(picture(data, moments[-1], size)).save(buffer, "PNG")
        write_atomic(path, buffer.getvalue())
    else:
        frames = list(_frames(data, moments, size))
        write_atomic(path, _gif(frames, fps) if kind == ".gif" else _mp4(frames, fps))


def gif(data: EpisodeData, fps: int = 10, size: tuple[int, int] = (900, 500)) -> bytes:
    """Animate an episode as the content of a GIF."""
    _check_rate(fps)
    return _gif(list(_frames(data, frame_moments(data.steps, scene_class(data).max_frames), size)), fps)


def _check_rate(fps: int) -> None:
    if not 1 <= fps <= 50:
        raise InputError(f"fps = {fps}: expected from 1 to 50 frames a second")


def picture(data: EpisodeData, moment: int, size: tuple[int, int] = (900, 500)) -> np.ndarray:
    """Draw the frame of a moment of the episode: uint8, (height, width, 3)."""
    return next(_frames(data, [moment], size))


def frame_moments(steps: int, most: int) -> list[int]:
    """Moments of at most `most` frames: evenly spaced, and always the first and the last instant."""
    # Up to three frames a step for smooth motion; where not even one fits, every n-th instant.
    per_step = next((count for count in (3, 2, 1) if steps * count < most), None)
    stride = SUBSTEPS // per_step if per_step else SUBSTEPS * -(-steps // (most - 1))
    return [*range(0, SUBSTEPS * steps, stride), SUBSTEPS * steps]


def _frames(data: EpisodeData, moments: list[int], size: tuple[int, int]) -> Iterator[np.ndarray]:
    """Yield RGB pictures: the background is drawn once, and moving artists on top of a copy of it."""
    figure = new_figure(size[0] / DPI, size[1] / DPI, dpi=DPI, layout=None)
    canvas = FigureCanvasAgg(figure)
    moving, show = _scene(figure, data, size)
    for artist in moving:
        artist.set_animated(True)
    literal(figure)
    canvas.draw()
    still = canvas.copy_from_bbox(figure.bbox)
    for moment in moments:
        canvas.restore_region(still)
        show(moment)
        for artist in moving:
            figure.draw_artist(artist)
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _scene(figure: Figure, data: EpisodeData, size: tuple[int, int]) -> tuple[list[Artist], Callable[[int], None]]:
    """Draw everything on the figure; return the moving artists, and the function that moves them to a moment."""
    width, height = size
    kind, unit, bottom, top = scene_class(data), np.array([width, height, width, height]), 82.0, 60.0
    place = kind.place(width, height, bottom, top)
    ground: Any = figure.add_axes(tuple(place / unit), axes_class=kind.axes_class)
    high = min(place[3], height - bottom - top)
    curves = figure.add_axes(tuple((place[0] + place[2] + 62, bottom, 200, high) / unit))
    scene = kind(ground, data, kind.limits([data]), trail=TRAIL_STEPS, scale=1.15)
    scene.label(9.0)
    title = figure.text(14 / width, 1 - 12 / height, drawable(describe(data)), fontsize=11, fontweight="bold", va="top")
    title.set_parse_math(False)
    title.set_fontsize(11 * min(1.0, (width - 28) / title.get_window_extent().width))
    behind = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}  # low: the frame below stays whole
    clock = figure.text(56 / width, (bottom + high + 7) / height, "", fontsize=10, bbox=behind)
    lines, show_curves = _curves(curves, data) if data.tracks is None else draw_counts(curves, data)
    start = _make_room(figure, ground if kind is PlanarScene else None, curves, place)
    curves.set_position(tuple((start, bottom, width - start - 14, high) / unit))
    style = {"frameon": False, "handletextpad": 0.5, "columnspacing": 1.2, "borderpad": 0}
    entries = legend_entries([data])
    below = {"loc": "lower center", "bbox_to_anchor": (0.5, 8 / height), "ncols": len(entries)}
    figure.legend(handles=entries, fontsize=min(9.0, width / 100), **below, **style)

    def show(moment: int) -> None:
        scene.show(moment)
        show_curves(moment)
        k = moment // SUBSTEPS
        # Poses move between two measurements; which targets are seen stands until the next one.
        last = f"measured at {data.times_s[k]:.1f} s: {data.seen_at(k).sum()} of {data.present[k].sum()} detected"
        clock.set_text(f"t = {data.time_at(moment):.1f} s   ({last})")

    return [*scene.artists, *lines, clock], show


def _make_room(figure: Figure, ground: Axes | None, curves: Axes, place: tuple[float, ...]) -> float:
    """Move the ground, if given, to the right until its labels fit; return the left side of the curves [pixels]."""
    left, right = place[0], place[0] + place[2]
    if ground is not None:
        shift = max(0.0, 8.0 - _left_of(ground))
        width, height = figure.bbox.size
        ground.set_position(((left + shift) / width, place[1] / height, place[2] / width, place[3] / height))
        right += shift
    labels = curves.get_window_extent().x0 - _left_of(curves)
    return right + max(62.0, labels + 16.0)


def _left_of(axes: Axes) -> float:
    """Left side of axes with all their labels [pixels]."""
    box = axes.get_tightbbox()
    assert box is not None, "axes that are drawn"
    return box.x0


def _curves(axes: Axes, data: EpisodeData) -> tuple[list[Artist], Callable[[int], None]]:
    """Draw log det of every target after every step up to a moment; return as `_scene`."""
    times, mean, present = data.times_s[1:], data.mean_log_det, data.present[1:]
    points = np.stack(np.broadcast_arrays(times[:, None], data.log_det), axis=-1)
    axes.set_ylim(*axis_range(data.log_det_present))
    over_time(axes, data.times_s[-1], "log det of information [nat]")
    short = data.steps <= 60
    each = axes.add_line(Line2D([], [], color=GREY, lw=1.0 if short else 0.5))
    dots = axes.add_line(Line2D([], [], color=SEEN, ls="none", marker="o", ms=4 if short else 2))
    average = axes.add_line(Line2D([], [], color=BLACK, lw=2.0 if short else 1.0))
    handles = [
        Line2D([], [], color=GREY, lw=1.0, label="one target"),
        Line2D([], [], color=SEEN, ls="none", marker="o", ms=4, label="detected"),
        Line2D([], [], color=BLACK, lw=2.0, label="mean"),
    ]
    style = {"fontsize": 9, "frameon": False, "handlelength": 1.4, "borderpad": 0, "columnspacing": 1.2}
    axes.legend(handles=handles, loc="lower right", bbox_to_anchor=(1.0, 1.01), ncols=3, **style)

    def show(moment: int) -> None:
        k = moment // SUBSTEPS
        each.set_data(*broken(points[:k], present[:k]).T)
        dots.set_data(*points[:k][data.visible[:k] & present[:k]].T)
        average.set_data(times[:k], mean[:k])

    return [each, dots, average], show


def _gif(frames: list[np.ndarray], fps: int) -> bytes:
    """Encode frames as a GIF with one palette: the most frequent colours of a few frames.

    They include each colour with a meaning, as it fills a patch of the legend; Pillow's own choice, an average, may
    merge pale tints.
    """
    sample = np.concatenate([frames[i] for i in np.linspace(0, len(frames) - 1, 5).astype(int)]).astype(np.uint32)
    colors, counts = np.unique(sample @ np.array([65536, 256, 1], np.uint32), return_counts=True)
    colors = colors[np.argsort(-counts, kind="stable")]
    # One of each cube of 8 x 8 x 8: Pillow distinguishes no more, and white must not become nearly white.
    _, first = np.unique(colors & 0xF8F8F8, return_index=True)
    most = colors[np.sort(first)[:COLORS]]
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.stack([most >> 16, most >> 8 & 255, most & 255], axis=1).astype(np.uint8).tobytes())
    images = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    hold = [round(1000 / fps)] * (len(images) - 1) + [round(1000 * HOLD_S)]
    buffer = io.BytesIO()
    images[0].save(buffer, "GIF", save_all=True, append_images=images[1:], duration=hold, loop=0, optimize=False)
    return buffer.getvalue()


def _mp4(frames: list[np.ndarray], fps: int) -> bytes:
    """Encode frames as H.264 for browsers, the last one held; ffmpeg needs a file in which it can seek."""
    height, width = frames[0].shape[:2]
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(fps), "-i", "-"]
    target = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", "-movflags", "+faststart"]
    held = frames + frames[-1:] * round(HOLD_S * fps)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "episode.mp4"
        command = ["ffmpeg", "-loglevel", "error", "-y", *source, *target, str(file)]
        done = subprocess.run(command, input=b"".join(map(np.ndarray.tobytes, held)), capture_output=True)
        if done.returncode or not file.exists():
            reason = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["no reason given"]
            raise InputError(f"ffmpeg failed: {reason[0]}")
        return file.read_bytes()
