"""What holds at present, out of everything that has happened: what a newcomer is shown first."""

from __future__ import annotations

from procedures.engine.events.event import Event
from procedures.engine.events.happenings import (
    Answered,
    CaseState,
    DeviceState,
    Questioned,
    StepState,
    Waiting,
)


class Present:
    """The latest event of everything that has a present value."""

    def __init__(self) -> None:
        self._events: dict[str, Event] = {}

    @property
    def events(self) -> tuple[Event, ...]:
        """In the order of their numbers."""
        return tuple(sorted(self._events.values(), key=lambda event: event.number))

    def take_in(self, event: Event) -> None:
        """Let an event replace what it makes past."""
        what = event.what
        match what:
            case Answered(question=number):
                self._events.pop(f"question {number}", None)
            case Questioned(question=number):
                self._events[f"question {number}"] = event
            case StepState(step=step):
                self._events[f"step {step}"] = event
            case DeviceState(device=device):
                self._events[f"device {device}"] = event
            case Waiting(guard=guard, reason=None):
                self._events.pop(f"waiting {guard}", None)
            case Waiting(guard=guard):
                self._events[f"waiting {guard}"] = event
            case CaseState():
                self._events["case"] = event
            case _ if what.signal:
                self._events[event.subject] = event
            case _:
                pass
