"""A third of a minute of the loop that `make soak` runs for an hour, and a live view with twenty visits."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]


@pytest.mark.slow
def test_a_third_of_a_minute_of_the_loop_stays_within_its_bounds():
    """In a process of its own, as `make soak` does it: here every annotation would be checked 2000 times."""
    command = [sys.executable, "-m", "endurance.soak", "--seconds", "20", "--tabs", "0", "--seed", "1"]
    done = subprocess.run(command, cwd=TESTS, capture_output=True, text=True, check=False)
    said = [line for line in done.stdout.splitlines() if "s of a core" not in line]
    assert said[0].startswith("2000 steps, "), done.stderr
    # A machine that runs other tests at the same time has no p99 to speak of.
    assert [line for line in said if "NOT AS IT SHOULD BE" in line and "p99" not in line] == []
    ids, outliers = (int(part.split()[0]) for part in said[0].split(", ")[1:3])
    assert ids > 10, "they come and go"
    assert outliers > 5


@pytest.mark.slow
def test_the_live_view_releases_disconnected_clients(tmp_path):
    """Twenty connections, opened as a page does; `make soak` uses tabs of a real browser."""
    viser = pytest.importorskip("viser", reason="needs the extra view")
    from helpers.browser import wait_for
    from helpers.episode_data import late_sightings
    from websockets.sync.client import connect

    from foveate.plotting.live import server as view

    source = view.EpisodeSource(scenes=("one",), methods=("still",), episode=lambda scene, method: late_sightings())
    with view._server(0) as server:
        player = view.Player(server, source)
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
        # The server's pool may still start a thread late; a leak would show fifteen times in fifteen more visits.
        assert counts[-1][0] <= counts[4][0] + 2, "threads"
        assert counts[-1][1] <= counts[4][1] + 2, "open files"
