"""A minute of what `make soak` does for an hour; and a live view that twenty come to and leave."""

import os
import threading

import pytest
from soak import faults, soak


def test_a_minute_of_the_loop():
    found = soak(60.0, seed=1)
    assert found.steps == 6000
    assert found.ids > 20, "ids come and go"
    assert found.outliers > 20
    wrong = [line for line in faults(found) if "p99" not in line]  # a machine that runs other tests has no p99
    assert wrong == []


def test_the_live_view_forgets_who_has_left(tmp_path):
    """Twenty connections as a page opens them; tabs of a real browser: `make soak`."""
    viser = pytest.importorskip("viser", reason="needs the extra view")
    from test_view import made_up, wait_for
    from websockets.sync.client import connect

    from foveate import view

    programme = view.Programme(scenes=("one",), methods=("still",), film=lambda scene, method: made_up())
    with view._server(0) as server:
        player = view.Player(server, programme)
        player.tick(0.0)
        counts = []
        for _ in range(20):
            with connect(
                f"ws://127.0.0.1:{server.get_port()}", subprotocols=[f"viser-v{viser.__version__}"], max_size=None
            ) as page:
                assert page.recv(timeout=60)
                player.tick(0.1)
            wait_for(lambda: not server.get_clients())
            counts.append((threading.active_count(), len(os.listdir("/proc/self/fd"))))
        assert counts[-1][0] <= counts[4][0], "threads"
        assert counts[-1][1] <= counts[4][1] + 2, "open files"
