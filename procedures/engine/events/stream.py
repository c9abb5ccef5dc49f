"""One numbered stream of events with any number of readers, none of which can hold up the engine.

A reader begins with a snapshot (the latest of everything that has a present value) and then gets changes.
Facts wait for it without limit: a case has some thousands. Of a signal only the latest waits, so that a slow
reader loses poses first; the next batch says how many it lost.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from procedures.engine.events.current_state import CurrentState
from procedures.engine.events.event import Event
from procedures.engine.events.happenings import Happening, JournalLine


@dataclass(frozen=True)
class Batch:
    """What has happened since the reader last looked, in order; `lost` signals were replaced meanwhile."""

    events: tuple[Event, ...]
    lost: int
    ended: bool


class Reader:
    """One reader's place in the stream."""

    def __init__(self, snapshot: Sequence[Event]) -> None:
        self._arrived = threading.Condition()
        self._facts: list[Event] = list(snapshot)
        self._signals: dict[str, Event] = {}
        self._lost = 0
        self._ended = False

    def wait(self, timeout_s: float | None = None) -> None:
        """Wait for something to happen, or for the end of the stream."""
        with self._arrived:
            self._arrived.wait_for(lambda: bool(self._facts or self._signals or self._ended), timeout_s)

    def read(self, timeout_s: float | None = None) -> Batch:
        """Wait for something to happen, or for the end of the stream, and return all of it."""
        with self._arrived:
            self._arrived.wait_for(lambda: bool(self._facts or self._signals or self._ended), timeout_s)
            events = sorted([*self._facts, *self._signals.values()], key=lambda event: event.number)
            batch = Batch(tuple(events), self._lost, self._ended)
            self._facts, self._signals, self._lost = [], {}, 0
            return batch

    def deliver(self, event: Event) -> None:
        """Take an event in. For the stream alone."""
        with self._arrived:
            if event.what.signal:
                self._lost += event.subject in self._signals
                self._signals[event.subject] = event
            else:
                self._facts.append(event)
            self._arrived.notify_all()

    def end(self) -> None:
        """Nothing more will come. For the stream alone."""
        with self._arrived:
            self._ended = True
            self._arrived.notify_all()


class EventStream:
    """Where everything that happens in a case is published, from any thread."""

    def __init__(self, now_s: Callable[[], float] = lambda: 0.0) -> None:
        """`now_s` is the theatre's time."""
        self._now_s = now_s
        self._lock = threading.Lock()
        self._count = 0
        self._readers: list[Reader] = []
        self._current = CurrentState()
        self._ended = False

    def publish(self, what: Happening) -> Event:
        """Number an event and hand it to every reader; returns at once, whatever they do."""
        with self._lock:
            self._count += 1
            event = Event(
                number=self._count, host_time=datetime.now(UTC), theatre_time_s=self._now_s(), what=what
            )
            self._current.take_in(event)
            for reader in self._readers:
                reader.deliver(event)
        return event

    def journal_line(self, line: bytes) -> None:
        """Publish a line of the journal, as it was written."""
        self.publish(JournalLine(line=json.loads(line)))

    def subscribe(self) -> Reader:
        """A new reader: first a snapshot of what holds at present, then every change."""
        with self._lock:
            reader = Reader(self._current.events)
            self._readers.append(reader)
            if self._ended:
                reader.end()
        return reader

    def hold_time(self) -> None:
        """From here on every event bears the present time: the theatre's clock is about to close."""
        now_s = self._now_s()
        self._now_s = lambda: now_s

    def end(self) -> None:
        """Nothing more will happen."""
        with self._lock:
            self._ended = True
            for reader in self._readers:
                reader.end()
