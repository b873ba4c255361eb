"""A headless Chromium for the tests of written pages and of the live view."""

import base64
import json
import shutil
import subprocess
import time
import urllib.request
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image
from websockets.sync.client import connect

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = ("--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


class Browser:
    """A headless Chromium, spoken to by its debugging protocol."""

    def __init__(self, folder: Path) -> None:
        port_file = folder / "DevToolsActivePort"
        arguments = [
            CHROMIUM,
            *FLAGS,
            f"--user-data-dir={folder}",
            "--remote-debugging-port=0",
            "--window-size=800,500",
        ]
        self._process = subprocess.Popen(
            [*arguments, "about:blank"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        wait_for(lambda: port_file.exists() and "\n" in port_file.read_text(), self._process)
        address = f"http://127.0.0.1:{port_file.read_text().split()[0]}/json"
        pages = []

        def found():
            pages[:] = [page for page in json.load(urllib.request.urlopen(address)) if page["type"] == "page"]
            return pages

        wait_for(found, self._process)
        self._socket, self._count = connect(pages[0]["webSocketDebuggerUrl"], max_size=None), 0

    def ask(self, method, **options):
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": options}))
        while (answer := json.loads(self._socket.recv(timeout=120))).get("id") != self._count:
            pass
        return answer.get("result", {})

    def run(self, script):
        return self.ask("Runtime.evaluate", expression=script, returnByValue=True).get("result", {}).get("value")

    def picture(self) -> np.ndarray:
        found = {}
        # There is none while a page is being loaded.
        wait_for(lambda: found.update(self.ask("Page.captureScreenshot")) or "data" in found)
        data = base64.b64decode(found["data"])
        return np.asarray(Image.open(BytesIO(data)).convert("RGB")).astype(int)

    def close(self) -> None:
        self._socket.close()
        self._process.terminate()
        self._process.wait(30)


def wait_for(happens, process=None, seconds=120.0):
    """Wait until something happens, while a process lives."""
    end = time.monotonic() + seconds
    while not happens():
        assert time.monotonic() < end, "timed out"
        assert process is None or process.poll() is None, "the browser has ended"
        time.sleep(0.4)
