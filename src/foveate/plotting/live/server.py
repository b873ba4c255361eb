"""Live view (extra `view`): episodes in a browser, or in a page that needs no server.

A page is served at 127.0.0.1 only, its button to share it publicly is hidden, and `gate` checks what comes in.
"""

import contextlib
import io
import itertools
import logging
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from foveate.errors import InputError
from foveate.io.files import write_atomic
from foveate.plotting.episode_data import EpisodeData
from foveate.plotting.live.chart import LEGEND, SceneChart
from foveate.plotting.live.gate import guarded
from foveate.plotting.live.player import EpisodeSource, Player, plain, usual_speed
from foveate.plotting.live.scene import LiveScene, aim_cameras
from foveate.plotting.scene import describe

HOST = "127.0.0.1"
FRAME_RATE_HZ = 12.0
MAX_FRAMES = 600
"""Most frames of a recorded page; a longer episode has a lower frame rate."""


@contextlib.contextmanager
def _server(port: int) -> Iterator[Any]:
    """Run a server at 127.0.0.1, whose `offers` are the values that it takes (`gate`).

    Raises InputError for a port that is taken, or without viser.
    """
    try:
        import viser
    except ImportError as error:
        raise InputError(f"viewing needs viser ({error}): pip install 'foveate[view]'") from error
    taken = InputError(f"port {port}: is in use, or needs privileges: choose another, say {port + 1}")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except (OSError, OverflowError) as error:
            raise taken from error
    offers: dict[str, Callable[[Any], bool]] = {}
    # viser prints a banner even if not verbose.
    with contextlib.redirect_stdout(io.StringIO()), guarded(offers):
        server: Any = viser.ViserServer(host=HOST, port=port, label="foveate", verbose=False)
    server.offers = offers
    try:
        if port and server.get_port() != port:
            raise taken
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def record(data: EpisodeData, path: Path) -> None:
    """Write a page that plays one episode without a server: the scene, a chart in it, and a playback bar.

    Raises InputError for another ending than .html, or without viser.
    """
    if path.suffix.lower() != ".html":
        raise InputError(f"{path}: expected a name that ends in .html")
    speed = usual_speed(data)
    count = int(min(MAX_FRAMES, max(2, FRAME_RATE_HZ * data.times_s[-1] / speed + 1)))
    times = np.linspace(0.0, data.times_s[-1], count)
    with _server(0) as server:
        scene = LiveScene(server.scene, data)
        chart = SceneChart(server.scene, data, scene.box)
        aim_cameras(server, scene)
        scene.show(0)
        chart.show(0)
        serializer = server.get_scene_serializer()
        for past, time_s in itertools.pairwise(times):
            serializer.insert_sleep(float(time_s - past) / speed)
            scene.show(data.moment_at(time_s))
            chart.show(data.moment_at(time_s))
        serializer.insert_sleep(1.0)
        page = _captioned(serializer.as_html(), describe(data))
    write_atomic(path, page.encode())


def _captioned(page: str, title: str) -> str:
    """Page with a caption in HTML, which is there, and legible, before the scene is."""
    style = "position:fixed;z-index:10;left:12px;bottom:52px;right:12px;font:14px sans-serif;pointer-events:none"
    caption = f"<div style='{style}'><b>{plain(title)}</b><br>{plain(LEGEND)}</div>"
    before, body, after = page.partition("<body>")
    assert body, "a page of viser has a body"
    return f"{before}{body}{caption}{after}"


def serve(source: EpisodeSource, port: int, say: Callable[[str], None] = print) -> None:
    """Serve the page at 127.0.0.1 until interrupted. Raises InputError for a port that is taken, or without viser."""
    # A browser that drops its connection at once needs no traceback.
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
    with _server(port) as server:
        player = Player(server, source)
        player.tick(0.0)
        say(f"http://{HOST}:{server.get_port()}: press Ctrl+C to stop")
        time_s = time.monotonic()
        while True:
            time.sleep(1 / FRAME_RATE_HZ)
            past, time_s = time_s, time.monotonic()
            player.tick(time_s - past)
