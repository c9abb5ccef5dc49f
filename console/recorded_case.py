"""Recorded events of a case, and its view after any number of them."""

from __future__ import annotations

from collections.abc import Iterable

from procedures.engine.case_view import CaseView, fold
from procedures.engine.events import Event

STORED_EVERY = 100  # events between stored views


class RecordedCase:
    """Recorded events in order. Views are folded from periodic snapshots."""

    def __init__(self) -> None:
        self._events: list[Event] = []
        self._stored_views: list[CaseView] = [CaseView()]
        self.latest = CaseView()
        self.is_over = False  # the writer is gone

    def extend(self, events: Iterable[Event]) -> None:
        for event in events:
            self._events.append(event)
            self.latest = fold(self.latest, event)
            if len(self._events) % STORED_EVERY == 0:
                self._stored_views.append(self.latest)

    def __len__(self) -> int:
        return len(self._events)

    def at(self, count: int) -> CaseView:
        """Return the view after the given number of events."""
        count = min(max(count, 0), len(self._events))
        view = self._stored_views[count // STORED_EVERY]
        for event in self._events[count - count % STORED_EVERY : count]:
            view = fold(view, event)
        return view

    def time_s(self, count: int) -> float:
        """Return the theatre time after the given number of events."""
        return self._events[count - 1].theatre_time_s if 0 < count <= len(self._events) else 0.0
