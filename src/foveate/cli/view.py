"""`foveate view`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from foveate.cli.common import check_port
from foveate.cli.options import ReadingCommand, option
from foveate.errors import InputError
from foveate.names import ProtocolName


@dataclass(kw_only=True)
class View(ReadingCommand):
    """Show episodes in the browser, in 3-D: the agent with its field of view, targets, beliefs, and their information.

    Serves a page at 127.0.0.1, for this machine only, until Ctrl-C; or, with --record, writes one episode as a page
    that plays without a server. Noise is as in `foveate evaluate` and `foveate replay`.
    """

    run: Annotated[tyro.conf.Positional[str], option("RUN|PRESET|FILE.onnx")]
    """Run folder, exported file (.onnx), or name of a preset (its trained policy comes with the package)."""
    scenes: Annotated[str | None, option("FILE|table1|own")] = None
    """Scenes file, table1 or own (default: table1 if the scenario's are the paper's, else own)."""
    recording: Annotated[Path | None, option("RECORDING")] = None
    """Recording of real targets, in place of scenes: any file that `foveate replay` reads."""
    start: Annotated[float | None, option("SECONDS")] = None
    """Start of the part of the recording to use [s]."""
    end: Annotated[float | None, option("SECONDS")] = None
    """End of the part of the recording to use [s]."""
    max_gap: Annotated[float | None, option("SECONDS")] = None
    """Longest gap between two fixes over which a target of the recording counts as present [s] (default: 2 s, or three
    fixes of a slow clock)."""
    detection_probability: Annotated[float | None, option("P")] = None
    """Probability that a target of the recording in view is detected, without an id; see `foveate replay`."""
    clutter: Annotated[float | None, option("N")] = None
    """Expected false alarms in each scan of the recording, among detections without ids."""
    port: int = 8080
    """Port of the page."""
    record: Annotated[Path | None, option("FILE.html")] = None
    """Write a page that plays one episode without a server, and exit."""
    scene: Annotated[str | None, option("NAME")] = None
    """Scene to show first, or to record (default: the first)."""
    method: Annotated[str | None, option("NAME")] = None
    """Method to show first, or to record: policy, or the name of a heuristic, as for `foveate evaluate --method`."""
    protocol: ProtocolName = "true"
    """Source of information: the soft view (surrogate) or real measurements (true); on a recording always true."""
    scene_seed: int = 2023
    """Seed of the scenes of table1 or own."""
    seed: int = 0
    """Seed of the noise."""

    def check(self) -> None:
        """Raise InputError where options are out of range, or exclude each other, or inputs do not exist."""
        if self.scenes is not None and self.recording is not None:
            raise InputError("--scenes and --recording: expected one of them")
        if self.recording is None and (given := self._of_recording()):
            raise InputError(f"--{given[0]}: expected a --recording beside it")
        if self.scene is not None and self.recording is not None:
            raise InputError("--scene: a recording is one scene")
        if not 1 <= self.port <= 65535:
            raise InputError(f"--port {self.port}: expected a whole number from 1 to 65535")
        if self.record is not None and self.record.suffix.lower() != ".html":
            raise InputError(f"{self.record}: expected a name that ends in .html")
        super().check()
        if self.record is None:
            check_port(self.port)

    def _of_recording(self) -> list[str]:
        """Options given that are of a recording."""
        given = [name for name, value in (*self.reading().items(), ("map", self.map)) if value]
        alarms = {"detection-probability": self.detection_probability, "clutter": self.clutter}
        return [*given, *(name for name, value in alarms.items() if value is not None)]
