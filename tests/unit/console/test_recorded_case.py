"""A recorded case at any moment, and the panels after its events."""

from __future__ import annotations

import re
from functools import reduce

from case_events import MOMENT, NAMES, ORDER, events_of, question, view_after
from hypothesis import given
from hypothesis import strategies as st

from console.panels.case_state import case_line, devices
from console.panels.results import journal, notices
from console.recorded_case import RecordedCase
from procedures.engine.case_view import CaseView, fold
from procedures.engine.events import (
    Answered,
    CaseState,
    DeviceAge,
    DeviceState,
    Event,
    EventContent,
    Fault,
    JournalLine,
    LinkHealth,
    Progress,
    Seat,
    StepState,
    Waiting,
)

HAPPENINGS = st.one_of(
    st.builds(CaseState, state=st.sampled_from(["held", "paused", "operation.fit"])),
    st.builds(
        StepState,
        step=st.sampled_from(NAMES),
        state=st.sampled_from(["begun", "done", "failed", "superseded"]),
    ),
    st.builds(Progress, step=st.just("image"), share=st.floats(0, 1), text=st.just("reading")),
    st.integers(1, 3).map(question),
    st.builds(Answered, question=st.integers(1, 3), answer=st.just("yes")),
    st.builds(Seat, holder=st.sampled_from(["", "Ana"])),
    st.builds(Waiting, upcoming=st.sampled_from([None, *NAMES])),
    st.builds(DeviceState, device=st.just("arm"), state=st.just("active"), fault=st.none()),
    st.builds(DeviceAge, device=st.just("arm"), age_s=st.floats(0, 9)),
    st.builds(Fault, code=st.just("RSI-010"), what=st.just("it stopped")),
    st.just(ORDER),
)


@given(st.lists(HAPPENINGS, max_size=40), st.data())
def test_a_snapshot_plus_the_later_events_gives_the_later_snapshot(
    happenings: list[EventContent], data: st.DataObject
) -> None:
    events = events_of(happenings)
    at = data.draw(st.integers(0, len(events)))
    early = reduce(fold, events[:at], CaseView())
    late = reduce(fold, events[at:], early)
    recorded = RecordedCase()
    recorded.extend(events)
    assert recorded.at(at) == early
    assert recorded.latest == recorded.at(len(events)) == late


def test_the_first_journal_line_names_the_theatre_and_the_last_the_outcome() -> None:
    opened = {
        "entry": "opened",
        "run": "r1",
        "banner": "SIMULATED THEATRE",
        "theatre": "mini",
        "strategy": "ocs",
        "methods": "localizer thesis-line, matcher ours: not for clinical use",
    }
    view = view_after(JournalLine(line=opened), JournalLine(line={"entry": "closed", "outcome": "done"}))
    assert (view.run, view.banner, view.outcome) == ("r1", "SIMULATED THEATRE", "done")
    assert "strategy ocs, localizer thesis-line, matcher ours: not for clinical use" in case_line(view)
    assert view_after(JournalLine(line={"entry": "opened", "banner": None})).banner == ""


def view_at(*happenings: tuple[float, EventContent]) -> CaseView:
    view = CaseView()
    for number, (at_s, what) in enumerate(happenings, start=1):
        view = fold(view, Event(number=number, host_time=MOMENT, theatre_time_s=at_s, what=what))
    return view


def test_the_health_of_the_robot_link_is_shown_with_its_age() -> None:
    health = LinkHealth(
        cycles=100, late=0, lost=0, rejected=0, turnaround_median_us=20.0, turnaround_p99_us=90.0
    )
    seen = DeviceState(device="arm", state="fault")
    shown = re.sub(r"<[^>]+>", "", devices(view_at((3.0, health), (45.0, seen))))
    assert "Robot link 42 s ago: 100 cycles, " in shown
    again = health.model_copy(update={"cycles": 1100})
    assert "1100 cycles at 20 Hz, " in devices(view_at((3.0, health), (45.0, seen), (53.0, again)))


def test_the_rate_of_a_device_is_that_of_its_last_second_and_starts_again_with_it() -> None:
    def shown(*counts: tuple[float, int]) -> str:
        seen = DeviceState(device="tracker", state="active")
        ages = [(at_s, DeviceAge(device="tracker", age_s=0.0, readings=count)) for at_s, count in counts]
        return devices(view_at((0.0, seen), *ages))

    assert "60 Hz" in shown((0.0, 1), (0.5, 20), (1.0, 61))
    assert "60 Hz" in shown((0.0, 1), (1.0, 61), (1.2, 61))
    assert "0 Hz" in shown((0.0, 1), (1.0, 61), (2.0, 61))
    assert "Hz" not in shown((0.0, 1), (1.0, 61), (2.0, 3))


def test_a_journal_line_shows_its_time_and_what_it_is_about() -> None:
    line = {"sequence": 121, "host_time": "2026-11-21T10:21:05.246+00:00", "trajectory": "T1"}
    view = view_after(JournalLine(line={"entry": "stage", **line, "task": "skin", "previous": "ab" * 32}))
    assert "<li>121 10:21:05 stage: T1, skin</li>" in journal(view)


def test_the_notice_of_a_failed_step_is_settled_once_the_step_is_done() -> None:
    failed = (
        StepState(step="check", state="begun"),
        Fault(code="TOOL-005", what="TOOL-005: bent. Seat it.", advice="Seat it."),
        StepState(step="check", state="failed"),
        StepState(step="check", state="begun"),
    )
    assert [one.settled for one in view_after(*failed).notices] == [False]
    other = view_after(*failed, StepState(step="other", state="done"))
    assert [one.settled for one in other.notices] == [False]
    passed = view_after(*failed, StepState(step="check", state="done"))
    assert [one.settled for one in passed.notices] == [True]
    assert "✓ settled TOOL-005" in notices(passed)
    assert "Seat it" not in notices(passed)
