"""Write TensorBoard events, each at once: a full disk raises here, not in a thread of the writer."""

import time
from collections.abc import Mapping
from pathlib import Path

from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import Event, SessionLog  # pyright: ignore[reportAttributeAccessIssue]
from tensorboardX.summary import scalar


class Events:
    """Events of one training; for a resumed one, TensorBoard drops the earlier events from `purge_step` on."""

    def __init__(self, folder: Path, purge_step: int = 0) -> None:
        # The writer names its file by the second, and would empty a file of the same name.
        self._writer = EventsWriter(str(folder / "events"), f".{len(list(folder.glob('events*'))):04d}")
        if purge_step:
            self._write(Event(step=purge_step, file_version="brain.Event:2"))
            self._write(Event(step=purge_step, session_log=SessionLog(status=SessionLog.START)))

    def __enter__(self) -> "Events":
        return self

    def __exit__(self, *exception: object) -> None:
        self._writer.close()

    def add(self, numbers: Mapping[str, float], step: int) -> None:
        """Write the numbers of one step, by name. Raises OSError if the disk is full."""
        for name, value in numbers.items():
            self._write(Event(step=step, summary=scalar(name, value)))
        self._writer.flush()

    def _write(self, event: Event) -> None:
        event.wall_time = time.time()
        self._writer.write_event(event)
