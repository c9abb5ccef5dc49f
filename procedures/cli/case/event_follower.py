"""Hands the events of a case to its display, in a thread alongside the engine's."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator, Sequence

from procedures.engine.events import Event, EventStream

ENDING_S = 2.0  # host time to show the last of it

Show = Callable[[Sequence[Event]], None]


class EventFollower:
    """Follows a stream to its end; `show` is never called by two threads at once."""

    def __init__(self, events: EventStream, show: Show) -> None:
        self._reader = events.subscribe()
        self._show = show
        self._showing = threading.RLock()
        self._thread = threading.Thread(target=self._follow, name="event follower", daemon=True)

    def start(self) -> None:
        """Begin to follow."""
        self._thread.start()

    @contextlib.contextmanager
    def quiet(self) -> Iterator[None]:
        """Show what has happened so far, and nothing more while the block runs."""
        with self._showing:
            self.catch_up()
            yield

    def catch_up(self) -> bool:
        """Show what has happened so far; whether the stream has ended."""
        with self._showing:
            batch = self._reader.read(0.0)
            self._show(batch.events)
            return batch.ended

    def join(self) -> None:
        """Wait until the end of the stream is shown."""
        self._thread.join(ENDING_S)

    def _follow(self) -> None:
        ended = False
        while not ended:
            self._reader.wait()
            ended = self.catch_up()
