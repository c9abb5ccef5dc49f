"""Numbered event stream for any number of readers; slow readers never block the engine.

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

from procedures.engine.events.event_types import (
    Answered,
    Bodies,
    CaseState,
    DeviceState,
    Event,
    EventContent,
    Fault,
    JournalLine,
    MeasuringVolume,
    Order,
    Questioned,
    Refusal,
    Seat,
    SignalsLost,
    StepState,
    Waiting,
)
from procedures.journal.journal import Entry

LAST_LINES = 3  # of the journal, that a display shows
LAST_ERROR = "last error"


class CurrentState:
    """Current state as events: the latest event for each lasting value, and recent journal lines."""

    def __init__(self) -> None:
        self._events: dict[str, Event] = {}
        self._lines = 0

    @property
    def events(self) -> tuple[Event, ...]:
        """Events of the current state, in chronological order."""
        return tuple(self._events.values())

    def take_in(self, event: Event) -> None:
        """Add an event and drop the events it makes obsolete."""
        match event.what:
            case Answered(question=number):
                self._events.pop(f"question {number}", None)
                return
            case StepState(state="begun"):  # what was wrong before is past
                self._events.pop(LAST_ERROR, None)
            case JournalLine():
                self._lines += 1
            case _:
                pass
        if (key := self._key(event)) is not None:
            self._events.pop(key, None)
            self._events[key] = event

    def _key(self, event: Event) -> str | None:
        """Return the key under which only the latest event is kept, or None for a transient event."""
        match event.what:
            case Questioned(question=number):
                return f"question {number}"
            case StepState(step=step):
                return f"step {step}"
            case DeviceState(device=device):
                return f"device {device}"
            case CaseState() | Order() | Waiting() | Seat() | MeasuringVolume() | SignalsLost():
                return event.what.kind
            case Bodies():
                return event.subject
            case JournalLine(line=line):
                opening = line.get("entry") in (Entry.OPENED, Entry.RESTARTED)
                return "opened" if opening else f"line {self._lines % LAST_LINES}"
            case Fault() | Refusal():
                return LAST_ERROR
            case what if what.signal:
                return event.subject
            case _:
                return None


@dataclass(frozen=True)
class Batch:
    """Events since the last read, in order; `lost` counts signals replaced meanwhile."""

    events: tuple[Event, ...]
    lost: int
    ended: bool


class Reader:
    """Reader of the event stream with its own position."""

    def __init__(self, snapshot: Sequence[Event]) -> None:
        self._arrived = threading.Condition()
        self._facts: list[Event] = list(snapshot)
        self._signals: dict[str, Event] = {}
        self._lost = 0
        self._ended = False
        self._facts_only = False  # signals wake nobody

    def wait(self, timeout_s: float | None = None, *, facts_only: bool = False) -> None:
        """Wait for an event, with `facts_only` for a fact, or for the end of the stream."""
        with self._arrived:
            self._facts_only = facts_only
            self._arrived.wait_for(
                lambda: bool(self._facts or self._ended or (self._signals and not facts_only)), timeout_s
            )
            self._facts_only = False

    def read(self, timeout_s: float | None = None) -> Batch:
        """Wait for an event or the end of the stream, and return all new events."""
        with self._arrived:
            self._arrived.wait_for(lambda: bool(self._facts or self._signals or self._ended), timeout_s)
            events = sorted([*self._facts, *self._signals.values()], key=lambda event: event.number)
            batch = Batch(tuple(events), self._lost, self._ended)
            self._facts, self._signals, self._lost = [], {}, 0
            return batch

    def deliver(self, event: Event) -> None:
        """Deliver an event to the reader; called only by the stream."""
        with self._arrived:
            if event.what.signal:
                self._lost += event.subject in self._signals
                self._signals[event.subject] = event
            else:
                self._facts.append(event)
            if not (event.what.signal and self._facts_only):
                self._arrived.notify_all()

    def end(self) -> None:
        """Mark the end of the stream; called only by the stream."""
        with self._arrived:
            self._ended = True
            self._arrived.notify_all()


class EventStream:
    """Event stream of a case. Any thread may publish."""

    def __init__(self, now_s: Callable[[], float] = lambda: 0.0) -> None:
        """Create a stream; `now_s` returns theatre time."""
        self._now_s = now_s
        self._lock = threading.Lock()
        self._count = 0
        self._readers: list[Reader] = []
        self._current = CurrentState()
        self._ended = False

    def publish(self, what: EventContent) -> Event:
        """Assign an event its number and deliver it to every reader without blocking."""
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
        """Publish a journal line as written."""
        self.publish(JournalLine(line=json.loads(line)))

    def subscribe(self) -> Reader:
        """Return a new reader that starts with a snapshot of the current state, followed by every change."""
        with self._lock:
            reader = Reader(self._current.events)
            self._readers.append(reader)
            if self._ended:
                reader.end()
        return reader

    def hold_time(self) -> None:
        """Freeze the event time before the theatre clock is closed."""
        now_s = self._now_s()
        self._now_s = lambda: now_s

    def end(self) -> None:
        """End the stream."""
        with self._lock:
            self._ended = True
            for reader in self._readers:
                reader.end()
