"""A past case, or one running elsewhere: its view at any moment."""

from __future__ import annotations

from collections.abc import Iterable

from console.feed.fold import fold
from console.feed.view import CaseView
from procedures.engine.events import Event

EVERY = 100  # events between stored views


class RecordedCase:
    """Events in order; a view is folded from the last one stored before it."""

    def __init__(self) -> None:
        self._events: list[Event] = []
        self._kept: list[CaseView] = [CaseView()]
        self.latest = CaseView()
        self.over = False  # the writer is gone

    def extend(self, events: Iterable[Event]) -> None:
        """Add what happened since."""
        for event in events:
            self._events.append(event)
            self.latest = fold(self.latest, event)
            if len(self._events) % EVERY == 0:
                self._kept.append(self.latest)

    def __len__(self) -> int:
        return len(self._events)

    def at(self, count: int) -> CaseView:
        """The view after this many events."""
        count = min(max(count, 0), len(self._events))
        view = self._kept[count // EVERY]
        for event in self._events[count - count % EVERY : count]:
            view = fold(view, event)
        return view

    def time_s(self, count: int) -> float:
        """Theatre time after this many events."""
        return self._events[count - 1].theatre_time_s if 0 < count <= len(self._events) else 0.0
