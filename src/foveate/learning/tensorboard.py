"""TensorBoard's events, written as they come: a disk that is full is an error here, not of a thread of its own."""

import time
from collections.abc import Mapping
from pathlib import Path

from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import Event, SessionLog  # pyright: ignore[reportAttributeAccessIssue]
from tensorboardX.summary import scalar


class Events:
    """The events of one training, or of one that goes on: what was told of steps from `purge_step` on is void then."""

    def __init__(self, folder: Path, purge_step: int = 0) -> None:
        # The writer names its file by the second, and would empty one of that name.
        self._writer = EventsWriter(str(folder / "events"), f".{len(list(folder.glob('events*'))):04d}")
        if purge_step:
            self._write(Event(step=purge_step, file_version="brain.Event:2"))
            self._write(Event(step=purge_step, session_log=SessionLog(status=SessionLog.START)))

    def __enter__(self) -> "Events":
        return self

    def __exit__(self, *exception: object) -> None:
        self._writer.close()

    def add(self, numbers: Mapping[str, float], step: int) -> None:
        """Numbers of one step, by their names. Raises OSError where they cannot be written."""
        for name, value in numbers.items():
            self._write(Event(step=step, summary=scalar(name, value)))
        self._writer.flush()

    def _write(self, event: Event) -> None:
        event.wall_time = time.time()
        self._writer.write_event(event)
