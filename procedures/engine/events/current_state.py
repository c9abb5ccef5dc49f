"""The present state, from all events so far: the snapshot that a new reader starts from."""

from __future__ import annotations

from procedures.engine.events.event import Event
from procedures.engine.events.happenings import (
    Answered,
    Bodies,
    CaseState,
    DeviceState,
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
    """The latest event of everything that has a present value, and the last lines of the journal."""

    def __init__(self) -> None:
        self._events: dict[str, Event] = {}
        self._lines = 0

    @property
    def events(self) -> tuple[Event, ...]:
        """In the order in which they happened."""
        return tuple(self._events.values())

    def take_in(self, event: Event) -> None:
        """Let an event replace what it makes past."""
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
        """Of events with the same key only the latest holds; None for one that nothing holds of."""
        match event.what:
            case Questioned(question=number):
                return f"question {number}"
            case StepState(step=step):
                return f"step {step}"
            case DeviceState(device=device):
                return f"device {device}"
            case CaseState() | Order() | Waiting() | Seat() | Bodies() | MeasuringVolume() | SignalsLost():
                return event.what.kind
            case JournalLine(line=line):
                opening = line.get("entry") in (Entry.OPENED, Entry.RESTARTED)
                return "opened" if opening else f"line {self._lines % LAST_LINES}"
            case Fault() | Refusal():
                return LAST_ERROR
            case what if what.signal:
                return event.subject
            case _:
                return None
