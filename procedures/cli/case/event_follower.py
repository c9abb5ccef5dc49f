"""Follower of an event stream in a thread of its own."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator, Sequence

from procedures.engine.events import Event, EventStream

ENDING_S = 2.0  # host time to show the last events
Show = Callable[[Sequence[Event]], None]


class EventFollower:
    """Follows an event stream in its own thread. Calls to `show` never overlap."""

    def __init__(self, events: EventStream, show: Show) -> None:
        """Start following."""
        self._reader = events.subscribe()
        self._show = show
        self._showing = threading.RLock()
        self._thread = threading.Thread(target=self._follow, name="event follower", daemon=True)
        self._thread.start()

    @contextlib.contextmanager
    def quiet(self) -> Iterator[None]:
        """Show pending events, then suppress output while the block runs."""
        with self._showing:
            self.catch_up()
            yield

    def catch_up(self) -> bool:
        """Show all events so far; return whether the stream has ended."""
        with self._showing:
            batch = self._reader.read(0.0)
            self._show(batch.events)
            return batch.ended

    def join(self) -> None:
        """Wait until the rest of the stream has been shown."""
        self._thread.join(ENDING_S)

    def _follow(self) -> None:
        ended = False
        while not ended:
            self._reader.wait()
            ended = self.catch_up()
