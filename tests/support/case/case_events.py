"""Events of a case of three steps, and the view of it after them."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from procedures.engine.case_view import CaseView, fold
from procedures.engine.events import Event, EventContent, Order, OrderedStep, Questioned

MOMENT = datetime(2026, 1, 1, tzinfo=UTC)
NAMES = ("image", "localization:T1", "fit:T1")
ORDER = Order(
    steps=tuple(OrderedStep(step=name, title=name, phase="operation", moves=False) for name in NAMES)
)


def question(number: int = 1, **of: Any) -> Questioned:
    plain = {
        "topic": "park",
        "subject": "park",
        "value": "12 mm",
        "answers": ("yes", "no"),
        "timeout_s": None,
    }
    return Questioned.model_validate({"question": number, **plain, **of})


def events_of(happenings: list[EventContent]) -> list[Event]:
    return [
        Event(number=number, host_time=MOMENT, theatre_time_s=number / 10, what=what)
        for number, what in enumerate(happenings, start=1)
    ]


def view_after(*happenings: EventContent) -> CaseView:
    view = CaseView()
    for event in events_of(list(happenings)):
        view = fold(view, event)
    return view
