"""Panel of the live page: its choices, its clock, and the chart beside the scene."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from foveate.errors import InputError
from foveate.io.figures import BLACK, GREY
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData, axis_range
from foveate.plotting.live.chart import CURVES, LEGEND, curves, facts
from foveate.plotting.live.scene import LiveScene, aim_cameras
from foveate.plotting.scene import describe

PLAY, PAUSE = "play", "pause"
"""What the button does, as it says."""
SPEEDS = (0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 25.0, 50.0)
SHORT_S = 60.0
"""A longer episode is played faster at first."""


@dataclass(frozen=True, kw_only=True)
class EpisodeSource:
    """Scenes and methods to choose from; `episode` maps a choice to its episode."""

    scenes: tuple[str, ...]
    methods: tuple[str, ...]
    episode: Callable[[str, str], EpisodeData]


def plain(text: str) -> str:
    """Markdown of a literal text: a name from a file must not load pictures into the page."""
    return "".join(c if c.isalnum() or c in " .,:" else f"&#{ord(c)};" for c in text)


def usual_speed(data: EpisodeData) -> float:
    """Slowest speed, at least real time, that plays an episode in a minute."""
    return next((speed for speed in SPEEDS if speed >= 1 and data.times_s[-1] / speed <= SHORT_S), SPEEDS[-1])


class Player:
    """Panel of the page; `tick`, called repeatedly, advances scene and panel."""

    def __init__(self, server: Any, source: EpisodeSource) -> None:
        self._server, self._source = server, source
        self._episodes: dict[tuple[str, str], EpisodeData] = {}
        self._lock = threading.Lock()
        self._shown: tuple[str, str] | None = None
        self._moment, self._time_s = -1, 0.0
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        gui.main_panel.dock_right()  # beside the scene: a floating panel would cover a part of it
        self._scene = gui.add_dropdown("scene", source.scenes, initial_value=source.scenes[0])
        self._method = gui.add_dropdown("method", source.methods, initial_value=source.methods[0])
        self._speed = gui.add_dropdown("speed", tuple(f"{speed:g}" for speed in SPEEDS), hint="times real time")
        self._playing, self._button = True, gui.add_button(PAUSE)
        self._step = gui.add_slider("step", min=0, max=1, step=1, initial_value=0)
        steps = gui.add_button_group("one step", ("back", "ahead"))
        self._title, self._facts = gui.add_markdown(""), gui.add_markdown("")
        gui.add_markdown(f"*{LEGEND}*")
        self._chart: Any = None
        for handle, choices in (
            (self._scene, source.scenes),
            (self._method, source.methods),
            (self._speed, [f"{speed:g}" for speed in SPEEDS]),
            (steps, ("back", "ahead")),
        ):
            self._offer(handle, lambda value, choices=choices: isinstance(value, str) and value in choices)
        self._offer(self._button, lambda value: value is True)
        self._offer(self._step, lambda value: type(value) in (int, float) and 0 <= value <= self._step.max)

        @self._button.on_click
        def _(event: Any) -> None:
            with self._lock:
                self._play(not self._playing)

        @self._step.on_update
        def _(event: Any) -> None:
            if event.client is not None:  # moved by a user, not by the clock
                self._seek(int(self._step.value))

        @steps.on_click
        def _(event: Any) -> None:
            self._seek(self._moment // SUBSTEPS + (1 if steps.value == "ahead" else -1))

    def _offer(self, handle: Any, is_offered: Callable[[Any], bool]) -> None:
        """Take only these values of a control from visitors."""
        self._server.offers[handle._impl.uuid] = is_offered

    def _play(self, playing: bool) -> None:
        """Play or pause; the button says what it would do."""
        self._playing, self._button.label = playing, PAUSE if playing else PLAY

    def _seek(self, step: int) -> None:
        """Pause at a step."""
        with self._lock:
            self._play(False)
            if self._shown is not None:
                data = self._episodes[self._shown]
                self._time_s = float(data.times_s[min(max(step, 0), data.steps)])

    def tick(self, seconds: float) -> None:
        """Advance the selected episode by this time [s] multiplied by the speed."""
        selected = self._scene.value, self._method.value
        if selected != self._shown:
            try:
                self._load(*selected)
            except InputError as error:
                if self._shown is None:
                    raise
                # What one visitor has chosen cannot be shown: all stay at what was shown before.
                self._title.content, (self._scene.value, self._method.value) = plain(str(error)), self._shown
                selected = self._shown
        data = self._episodes[selected]
        with self._lock:
            end = float(data.times_s[-1])
            if self._playing:
                # Played at its end, the episode restarts.
                self._time_s = self._time_s + seconds * float(self._speed.value) if self._time_s < end else 0.0
                if self._time_s >= end:
                    self._time_s = end
                    self._play(False)
            moment = data.moment_at(self._time_s)
        if moment != self._moment:
            self._show(data, moment)

    def _load(self, scene: str, method: str) -> None:
        if (scene, method) not in self._episodes:
            self._title.content = plain(f"Simulating {method} on {scene} ..")
            self._episodes[scene, method] = self._source.episode(scene, method)
        data = self._episodes[scene, method]
        with self._lock:
            self._shown, self._moment, self._time_s = (scene, method), -1, 0.0
            self._speed.value = f"{usual_speed(data):g}"
            self._step.max = max(1, data.steps)
            self._play(True)
        with self._server.atomic():
            self._server.scene.reset()
            self._live_scene = LiveScene(self._server.scene, data)
            aim_cameras(self._server, self._live_scene)
            self._title.content = f"**{plain(describe(data))}**"
            if self._chart is not None:
                self._chart.remove()
            self._curves = curves(data)
            self._chart = _panel_chart(self._server.gui, data, self._curves)

    def _show(self, data: EpisodeData, moment: int) -> None:
        k = moment // SUBSTEPS
        with self._server.atomic():
            self._live_scene.show(moment)
            if k != self._moment // SUBSTEPS or self._moment < 0:
                self._chart.data = _chart_data(data, self._curves, k)
                self._step.value = k
            rows = "\n".join(f"| {name} | {value} |" for name, value in facts(data, moment).items())
            self._facts.content = f"| | |\n|---|---|\n{rows}"
        self._moment = moment


def _chart_data(data: EpisodeData, values: np.ndarray, k: int) -> tuple[np.ndarray, ...]:
    """Times and curves up to step k; before the first target the mean is below the chart: NaN would be bridged."""
    low, high = axis_range(values)
    return (data.times_s[1 : k + 1], *np.where(np.isfinite(values[:k]), values[:k], 2 * low - high).T)


def _panel_chart(gui: Any, data: EpisodeData, values: np.ndarray) -> Any:
    """Add a chart of log det of every target's information over time; colours have their meaning in the scene."""
    series = [{"label": "time [s]"}, {"label": "mean", "stroke": BLACK, "width": 3}]
    for i in range(values.shape[1] - 1):
        series.append({"label": f"target {i + 1}", "stroke": GREY, "width": 1})
    return gui.add_uplot(
        _chart_data(data, values, 0),
        tuple(series),
        title=CURVES,
        axes=({"label": "time [s]"}, {}),
        scales={"x": {"time": False, "range": (0.0, float(data.times_s[-1]))}, "y": {"range": axis_range(values)}},
        legend={"live": False, "show": False},
        aspect=1.6,
    )
