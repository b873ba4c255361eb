"""The live view answers its own page only; what its panel does not offer changes nothing, and ends nobody's session."""

import contextlib
import http.client
import logging
import time

import pytest

pytest.importorskip("viser", reason="needs the extra view")

import msgspec
import viser
from helpers.episode_data import late_sightings
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from foveate.errors import InputError
from foveate.plotting.live import gate, player
from foveate.plotting.live import server as view

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [1.0, 2, 3],
    "look_at": [0, 0, 0],
    "up_direction": [0, 0, 1],
    "fov": 1.0,
    "near": 0.1,
    "far": 10,
    "image_height": 480,
    "image_width": 640,
}


@pytest.fixture
def panel():
    def episode(scene, method):
        if method == "broken":
            raise InputError("no such policy")
        return late_sightings(steps=40, n=2, title=f"{method} on {scene}")

    source = player.EpisodeSource(scenes=("one", "two"), methods=("nearest", "still", "broken"), episode=episode)
    with view._server(0) as server:
        made = player.Player(server, source)
        made.tick(0.0)
        yield made


def opened(panel, origin="http://127.0.0.1:{port}", host=None):
    """A visitor's connection."""
    port = panel._server.get_port()
    protocols = [f"viser-v{viser.__version__}"]
    headers = {} if host is None else {"Host": host}
    return connect(
        f"ws://127.0.0.1:{port}",
        origin=origin and origin.format(port=port),
        subprotocols=protocols,
        additional_headers=headers,
        max_size=None,
    )


def send(connection, **message):
    connection.send(msgspec.msgpack.encode(message))


def change(connection, handle, **updates):
    send(connection, type="GuiUpdateMessage", uuid=handle._impl.uuid, updates=updates)


def happens(what, seconds=10.0):
    """Wait until it happens; False if it does not."""
    end = time.monotonic() + seconds
    while not what() and time.monotonic() < end:
        time.sleep(0.02)
    return bool(what())


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "http://127.0.0.1:1", "https://127.0.0.1:{port}", "http://localhost:{port}"],
)
def test_a_page_of_another_origin_is_refused(panel, origin):
    with pytest.raises(InvalidStatus) as caught, opened(panel, origin):
        pass
    assert caught.value.response.status_code == 403


@pytest.mark.parametrize(
    ("hosts", "status"),
    [
        (["127.0.0.1:{port}"], 200),
        (["localhost:9000"], 200),  # forwarded from another port
        (["evil.example:{port}"], 403),
        (["127.0.0.1.evil.example:{port}"], 403),
        (["localhost:{port}", "evil.example"], 403),
        ([], 403),
    ],
)
def test_a_page_under_another_name_is_refused(panel, hosts, status):
    """A foreign page can let its own name lead to this machine; the browser then believes them of one origin."""
    port = panel._server.get_port()
    asked = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    asked.putrequest("GET", "/", skip_host=True)
    for host in hosts:
        asked.putheader("Host", host.format(port=port))
    asked.endheaders()
    assert asked.getresponse().status == status
    asked.close()


def test_its_own_page_is_served_and_its_choices_are_taken(panel):
    with opened(panel) as visitor:
        send(visitor, **CAMERA)
        assert happens(lambda: len(panel._server.get_clients()) == 1)
        change(visitor, panel._scene, value="two")
        assert happens(lambda: panel._scene.value == "two")
        change(visitor, panel._speed, value="5")
        change(visitor, panel._step, value=3)
        assert happens(lambda: (panel._speed.value, panel._step.value) == ("5", 3))
        panel.tick(0.1)
        assert panel._shown == ("two", "nearest")


def test_what_is_not_offered_changes_nothing_and_ends_nobodys_session(panel, caplog, monkeypatch):
    shared = []
    monkeypatch.setattr(panel._server, "request_share_url", lambda *_: shared.append(1))
    before = {name: getattr(panel, name).value for name in ("_scene", "_method", "_speed", "_button", "_step")}
    with caplog.at_level(logging.WARNING), opened(panel) as bad, opened(panel) as good:
        send(good, **CAMERA)
        for handle in (panel._scene, panel._method, panel._speed, panel._button, panel._step):
            for value in ("nope", "evil", None, -1, 1e9, float("nan"), [], {}, 10**18, ["one"], "x" * 1000):
                change(bad, handle, value=value)
            change(bad, handle, label="evil")
            change(bad, handle, visible=False)
            change(bad, handle, options=["evil"])
            change(bad, handle, value=handle.value, removed=True)
        send(bad, type="ShareUrlRequest")
        send(bad, type="Nothing")
        send(bad, **{**CAMERA, "position": [float("nan"), 0, 0]})
        send(bad, **{**CAMERA, "wxyz": "none"})
        for raw in (b"", b"\xc1", b"\x91" * 60000, "text"):
            bad.send(raw)
        change(bad, panel._method, value="still")
        assert happens(lambda: panel._method.value == "still"), "after all of that its own session goes on too"
        panel.tick(0.1)
        assert {name: getattr(panel, name).value for name in before} == {**before, "_method": "still", "_step": 0}
        assert (panel._scene.label, panel._button.label, panel._playing) == ("scene", "pause", True)
        assert panel._scene.visible
        assert not shared
        good.ping().wait(10)
    assert not caplog.records


def test_a_choice_that_cannot_be_shown_keeps_what_was_shown(panel):
    panel._method.value = "broken"
    panel.tick(0.1)
    assert panel._method.value == "nearest"
    assert panel._shown == ("one", "nearest")
    assert "no such policy" in panel._title.content


def test_the_library_is_as_before_once_the_server_runs(panel):
    import websockets.asyncio.server as library

    assert library.serve.__module__ == library.__name__
    with contextlib.suppress(ValueError), gate.guarded({}):
        raise ValueError
    assert library.serve.__module__ == library.__name__
