"""The last seconds of a tracker, to be done again with a late detection in its place."""

from collections.abc import Callable
from typing import Any, NamedTuple


class Event(NamedTuple):
    """Something that a tracker did at a time [s]; `move` predicts to a time, `act` does all of it again."""

    time_s: float
    act: Callable[[], Any]
    move: Callable[[float], Any] | None = None


class History:
    """Events of the last `lag_s` seconds in order, and the state of the tracker before each; empty with a lag of 0."""

    def __init__(self, lag_s: float) -> None:
        self.lag_s = lag_s
        self._events: list[tuple[Event, float, Any]] = []

    def keep(self, event: Event, now_s: float, state: Callable[[], Any]) -> None:
        """Remember an event before it happens; `now_s` is the time of the state."""
        if self.lag_s > 0:
            self._events.append((event, now_s, state()))
            # The last state at or before the start of the buffer is needed, and none before it.
            while len(self._events) > 1 and self._events[1][1] <= event.time_s - self.lag_s:
                del self._events[0]

    def clear(self) -> None:
        """Forget everything: the clock begins."""
        self._events.clear()

    def since(self, time_s: float, now_s: float) -> tuple[Any, list[Event]] | None:
        """Take out the events after a time, with the state before them; None if the time is too long ago."""
        if time_s < now_s - self.lag_s * (1 + 1e-9) or not self._events or time_s < self._events[0][1]:
            return None
        first = next(i for i, (event, _, _) in enumerate(self._events) if event.time_s > time_s)
        later, state = [event for event, _, _ in self._events[first:]], self._events[first][2]
        del self._events[first:]
        return state, later
