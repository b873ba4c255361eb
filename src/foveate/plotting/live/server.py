"""The live view (extra `view`): episodes in a browser, from this machine only, or in one page that needs no server.

A page is served at 127.0.0.1 and nowhere else, and its button to share it with the world is hidden.
"""

import contextlib
import io
import itertools
import logging
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from foveate.errors import InputError
from foveate.io.files import write_atomic
from foveate.plotting.episode_data import SUBSTEPS, EpisodeData
from foveate.plotting.live.chart import LEGEND, MOST_CURVES, Board, curves, facts, span
from foveate.plotting.live.scene import LiveScene
from foveate.plotting.scene import BLACK, CYCLE, describe

HOST = "127.0.0.1"


FRAMES_S = 12.0


MOST_FRAMES = 600
"""Of a page without a server: a longer episode is shown with fewer frames."""


SPEEDS = (0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 25.0, 50.0)


SHORT_S = 60.0
"""An episode that would take longer than this is played faster at first."""


@dataclass(frozen=True, kw_only=True)
class Programme:
    """What there is to see: scenes, methods, and what makes the film of one of each."""

    scenes: tuple[str, ...]
    methods: tuple[str, ...]
    film: Callable[[str, str], EpisodeData]


def plain(text: str) -> str:
    """Markdown that shows the text as it is: names from files must bring no pictures from elsewhere into the page."""
    return "".join(c if c.isalnum() or c in " .,:" else f"&#{ord(c)};" for c in text)


def usual_speed(film: EpisodeData) -> float:
    """Real time, or as fast as brings the episode under a minute."""
    return next((speed for speed in SPEEDS if speed >= 1 and film.times_s[-1] / speed <= SHORT_S), SPEEDS[-1])


def moment_at(film: EpisodeData, time_s: float) -> int:
    """The moment of a film (see `film.snapshot`) at a time [s] after its start."""
    share = np.interp(time_s, film.times_s, np.arange(film.steps + 1))
    return int(SUBSTEPS * share + 1e-9)


@contextlib.contextmanager
def _server(port: int) -> Iterator[Any]:
    """A server at 127.0.0.1, stopped in the end. Raises ValueError for a port that is taken, or without viser."""
    try:
        import viser
    except ImportError as error:
        raise InputError(f"viewing needs viser ({error}): pip install 'foveate[view]'") from error
    taken = InputError(f"--port {port}: is in use, or not for everybody: choose another, say {port + 1}")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except (OSError, OverflowError) as error:
            raise taken from error
    # viser prints a banner of its own, whatever it is told.
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=HOST, port=port, label="foveate", verbose=False)
    try:
        if port and server.get_port() != port:
            raise taken
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def record(film: EpisodeData, path: Path) -> None:
    """Write a page that plays one episode without a server: the scene, a board of its numbers, a bar to play it by.

    Raises ValueError for another ending than .html, and without viser.
    """
    if path.suffix.lower() != ".html":
        raise InputError(f"{path}: expected a name that ends in .html")
    speed = usual_speed(film)
    count = int(min(MOST_FRAMES, max(2, FRAMES_S * film.times_s[-1] / speed + 1)))
    times = np.linspace(0.0, film.times_s[-1], count)
    with _server(0) as server:
        stage = LiveScene(server.scene, film)
        board = Board(server.scene, film, stage.box)
        _aim(server, stage)
        stage.show(0)
        board.show(0)
        serializer = server.get_scene_serializer()
        for past, time_s in itertools.pairwise(times):
            serializer.insert_sleep(float(time_s - past) / speed)
            stage.show(moment_at(film, time_s))
            board.show(moment_at(film, time_s))
        serializer.insert_sleep(1.0)
        page = serializer.as_html()
    write_atomic(path, page.encode())


def _aim(server: Any, stage: LiveScene) -> None:
    position, middle = stage.camera()
    server.initial_camera.position, server.initial_camera.look_at = position, middle
    for client in server.get_clients().values():
        client.camera.position, client.camera.look_at = position, middle


class Player:
    """The page's panel, and the clock that moves scene and panel on: `tick` it."""

    def __init__(self, server: Any, programme: Programme) -> None:
        self._server, self._programme, self._films = server, programme, {}
        self._lock = threading.Lock()
        self._shown: tuple[str, str] | None = None
        self._moment, self._time_s = -1, 0.0
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        self._scene = gui.add_dropdown("scene", programme.scenes, initial_value=programme.scenes[0])
        self._method = gui.add_dropdown("method", programme.methods, initial_value=programme.methods[0])
        self._speed = gui.add_dropdown("speed", tuple(f"{speed:g}" for speed in SPEEDS), hint="times real time")
        self._play = gui.add_checkbox("play", True)
        self._step = gui.add_slider("step", min=0, max=1, step=1, initial_value=0)
        steps = gui.add_button_group("one step", ("back", "ahead"))
        self._title, self._facts = gui.add_markdown(""), gui.add_markdown("")
        gui.add_markdown(f"*{LEGEND}*")
        self._chart: Any = None

        @self._step.on_update
        def _(event: Any) -> None:
            if event.client is not None:  # a user's hand, not the clock's
                self._seek(int(self._step.value))

        @steps.on_click
        def _(event: Any) -> None:
            self._seek(self._moment // SUBSTEPS + (1 if steps.value == "ahead" else -1))

    def _seek(self, step: int) -> None:
        """Pause at a step."""
        with self._lock:
            self._play.value = False
            if self._shown is not None:
                film = self._films[self._shown]
                self._time_s = float(film.times_s[min(max(step, 0), film.steps)])

    def tick(self, seconds: float) -> None:
        """Show what is chosen, as much later as the speed makes of these seconds."""
        chosen = self._scene.value, self._method.value
        if chosen != self._shown:
            self._load(*chosen)
        film = self._films[chosen]
        with self._lock:
            end = float(film.times_s[-1])
            if self._play.value:
                # Played again from the end, it begins anew.
                self._time_s = self._time_s + seconds * float(self._speed.value) if self._time_s < end else 0.0
                if self._time_s >= end:
                    self._time_s, self._play.value = end, False
            moment = moment_at(film, self._time_s)
        if moment != self._moment:
            self._show(film, moment)

    def _load(self, scene: str, method: str) -> None:
        if (scene, method) not in self._films:
            self._title.content = plain(f"Simulating {method} on {scene} ..")
            self._films[scene, method] = self._programme.film(scene, method)
        film = self._films[scene, method]
        with self._lock:
            self._shown, self._moment, self._time_s = (scene, method), -1, 0.0
            self._speed.value = f"{usual_speed(film):g}"
            self._step.max, self._play.value = max(1, film.steps), True
        with self._server.atomic():
            self._server.scene.reset()
            self._stage = LiveScene(self._server.scene, film)
            _aim(self._server, self._stage)
            self._title.content = f"**{plain(describe(film))}**"
            if self._chart is not None:
                self._chart.remove()
            self._curves = curves(film)
            self._chart = _chart(self._server.gui, film, self._curves)

    def _show(self, film: EpisodeData, moment: int) -> None:
        k = moment // SUBSTEPS
        with self._server.atomic():
            self._stage.show(moment)
            if k != self._moment // SUBSTEPS or self._moment < 0:
                self._chart.data = _data(film, self._curves, k)
                self._step.value = k
            rows = "\n".join(f"| {name} | {value} |" for name, value in facts(film, moment).items())
            self._facts.content = f"| | |\n|---|---|\n{rows}"
        self._moment = moment


def _data(film: EpisodeData, values: np.ndarray, k: int) -> tuple[np.ndarray, ...]:
    """Times and curves up to step k; where a target is not there its curve is below the chart.

    Across NaN the page would draw a straight line, as if it were known what was there.
    """
    low, high = span(values)
    return (film.times_s[1 : k + 1], *np.where(np.isfinite(values[:k]), values[:k], 2 * low - high).T)


def _chart(gui: Any, film: EpisodeData, values: np.ndarray) -> Any:
    """log det of every target's information over time; the mean is black."""
    colors = [BLACK, *(CYCLE[i % (len(CYCLE) - 1)] for i in range(MOST_CURVES))]
    names = ["mean", *(f"target {i + 1}" for i in range(values.shape[1] - 1))]
    series = [{"label": "time [s]"}]
    series += [
        {"label": name, "stroke": stroke, "width": 1 if name != "mean" else 3}
        for name, stroke in zip(names, colors, strict=False)
    ]
    return gui.add_uplot(
        _data(film, values, 0),
        tuple(series),
        title="log det of information [nat]",
        scales={"x": {"time": False, "range": (0.0, float(film.times_s[-1]))}, "y": {"range": span(values)}},
        legend={"live": False, "show": bool(film.present.all())},
        aspect=1.3,
    )


def serve(programme: Programme, port: int, say: Callable[[str], None] = print) -> None:
    """Serve the page at 127.0.0.1 until interrupted. Raises ValueError for a port that is taken, or without viser."""
    # A browser that opens a connection and thinks better of it is not worth a traceback.
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
    with _server(port) as server:
        player = Player(server, programme)
        player.tick(0.0)
        say(f"http://{HOST}:{server.get_port()}: ctrl-C ends it")
        past = time.monotonic()
        while True:
            time.sleep(1 / FRAMES_S)
            now = time.monotonic()
            player.tick(now - past)
            past = now
