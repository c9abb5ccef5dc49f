"""The present state, from all events so far: the snapshot that a new reader starts from."""

from __future__ import annotations

from procedures.engine.events.event import Event
from procedures.engine.events.happenings import (
    Answered,
    Bodies,
    CaseState,
    DeviceState,
    JournalLine,
    MeasuringVolume,
    Order,
    Questioned,
    Seat,
    SignalsLost,
    StepState,
    Waiting,
)

BEGINNINGS = ("opened", "restarted")  # lines of the journal that say in which theatre, with which banner


class CurrentState:
    """The latest event of everything that has a present value."""

    def __init__(self) -> None:
        self._events: dict[str, Event] = {}

    @property
    def events(self) -> tuple[Event, ...]:
        """In the order in which they happened."""
        return tuple(self._events.values())

    def take_in(self, event: Event) -> None:
        """Let an event replace what it makes past."""
        match event.what:
            case Answered(question=number):
                self._events.pop(f"question {number}", None)
            case _ if (key := _key(event)) is not None:
                self._events.pop(key, None)
                self._events[key] = event
            case _:
                pass


def _key(event: Event) -> str | None:
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
        case JournalLine(line=line) if line.get("entry") in BEGINNINGS:
            return "opened"
        case what if what.signal:
            return event.subject
        case _:
            return None
