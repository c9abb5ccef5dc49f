"""The course of a case that has been, or that goes on elsewhere: its view at any moment."""

from __future__ import annotations

from collections.abc import Iterable

from console.feed.fold import fold
from console.feed.view import CaseView
from procedures.engine.events import Event

EVERY = 100  # events from one kept view to the next


class RecordedCase:
    """Events in their order; a view is folded from the last one that was kept before it."""

    def __init__(self) -> None:
        self._events: list[Event] = []
        self._kept: list[CaseView] = [CaseView()]
        self.latest = CaseView()
        self.over = False  # nobody writes any more

    def extend(self, events: Iterable[Event]) -> None:
        """Take in what happened since."""
        for event in events:
            self._events.append(event)
            self.latest = fold(self.latest, event)
            if len(self._events) % EVERY == 0:
                self._kept.append(self.latest)

    def __len__(self) -> int:
        return len(self._events)

    def at(self, count: int) -> CaseView:
        """The view after that many events."""
        count = min(max(count, 0), len(self._events))
        view = self._kept[count // EVERY]
        for event in self._events[count - count % EVERY : count]:
            view = fold(view, event)
        return view

    def time_s(self, count: int) -> float:
        """The theatre's time after that many events."""
        return self._events[count - 1].theatre_time_s if 0 < count <= len(self._events) else 0.0
