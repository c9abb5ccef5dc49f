"""The fold: the view at one moment plus the events since gives the view at the later moment."""

from __future__ import annotations

from datetime import UTC, datetime

from hypothesis import given
from hypothesis import strategies as st

from console.case_view import JOURNAL_KEPT, MOST_DEVICES, CaseView, RecordedCase, fold
from console.panels.case_state import case_line, devices
from console.panels.results import notices
from procedures.engine.events import (
    Answered,
    Bodies,
    CaseState,
    DeviceAge,
    DeviceState,
    Event,
    EventContent,
    Fault,
    JournalLine,
    LinkHealth,
    Order,
    OrderedStep,
    Pose,
    Progress,
    Questioned,
    Seat,
    StepState,
    Waiting,
)

MOMENT = datetime(2026, 1, 1, tzinfo=UTC)
NAMES = ("image", "localization:T1", "fit:T1")
ORDER = Order(
    steps=tuple(OrderedStep(step=name, title=name, phase="operation", moves=False) for name in NAMES)
)


def question(number: int) -> Questioned:
    return Questioned(
        question=number, topic="park", subject="park", value="12 mm", answers=("yes", "no"), timeout_s=None
    )


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
    early = CaseView()
    for event in events[:at]:
        early = fold(early, event)
    late = early
    for event in events[at:]:
        late = fold(late, event)
    recorded = RecordedCase()
    recorded.extend(events)
    assert recorded.at(at) == early
    assert recorded.latest == recorded.at(len(events)) == late


def test_a_completed_step_is_shown_as_done_and_a_superseded_one_as_superseded() -> None:
    done = StepState(step="fit:T1", state="done", summary="0.2 mm", record="03-fit-T1")
    view = view_after(ORDER, StepState(step="fit:T1", state="begun"), done)
    assert (view.steps[2].state, view.steps[2].summary, view.running) == ("done", "0.2 mm", "")
    gone = StepState(step="image", state="superseded", record="03-fit-T1")
    again = view_after(ORDER, done, gone)
    assert (again.steps[2].state, again.steps[2].summary) == ("superseded", done.summary)
    voided = view_after(ORDER, done, gone.model_copy(update={"summary": "the cart has moved"}))
    assert (voided.steps[2].state, voided.steps[2].summary) == ("superseded", "the cart has moved")


def test_a_resumed_run_shows_its_results_as_done_and_drops_open_question_and_seat() -> None:
    step = OrderedStep(step="image", title="Image", phase="operation", moves=False, record="01-image")
    killed = (JournalLine(line={"entry": "opened"}), ORDER, question(2), Seat(holder="Ana"))
    view = view_after(*killed, JournalLine(line={"entry": "restarted"}), Order(steps=(step,)))
    assert [(row.state, row.record) for row in view.steps] == [("done", "01-image")]
    assert (view.question, view.seat, view.results) == (None, None, 1)


def test_an_answer_removes_only_its_own_question() -> None:
    assert view_after(question(2), Answered(question=1, answer="yes")).question is not None
    assert view_after(question(2), Answered(question=2, answer="yes")).question is None


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


def test_a_signal_that_was_written_late_changes_neither_the_time_nor_the_next_step() -> None:
    late = Progress(step="image", share=0.9, text="reading")
    early, begun = events_of([late, StepState(step="fit:T1", state="begun")])
    view = fold(fold(CaseView(), begun), early)
    assert (view.running, view.share, view.doing) == ("fit:T1", 0.0, "")
    assert (view.number, view.theatre_time_s) == (2, 0.2)


def test_the_bodies_of_one_arm_do_not_follow_the_joints_of_another() -> None:
    bodies = Bodies(moving=(), fixed=(), pairs=())
    own, other = (
        Pose(arm=arm, joints_rad=(angle,), age_s=0.0) for arm, angle in (("arm", 0.1), ("assistant", 0.2))
    )
    view = view_after(bodies, own, other)
    assert view.pose is not None
    assert view.pose.pose == own


def test_the_health_of_the_robot_link_is_shown_with_its_age() -> None:
    health = LinkHealth(
        cycles=100, late=0, lost=0, rejected=0, turnaround_median_us=20.0, turnaround_p99_us=90.0
    )
    said = Event(number=1, host_time=MOMENT, theatre_time_s=3.0, what=health)
    seen = DeviceState(device="arm", state="fault")
    later = Event(number=2, host_time=MOMENT, theatre_time_s=45.0, what=seen)
    view = fold(CaseView(), said)
    assert "Robot link 42 s ago: 100 cycles, " in devices(fold(view, later))
    again = health.model_copy(update={"cycles": 1100})
    moved = Event(number=3, host_time=MOMENT, theatre_time_s=53.0, what=again)
    assert "1100 cycles at 20 Hz, " in devices(fold(fold(view, later), moved))


def test_the_rate_of_a_device_is_that_of_its_last_second_and_starts_again_with_it() -> None:
    def shown(*counts: tuple[float, int]) -> str:
        seen = DeviceState(device="tracker", state="active")
        view = fold(CaseView(), Event(number=1, host_time=MOMENT, theatre_time_s=0.0, what=seen))
        for number, (at_s, count) in enumerate(counts, start=2):
            age = DeviceAge(device="tracker", age_s=0.0, readings=count)
            view = fold(view, Event(number=number, host_time=MOMENT, theatre_time_s=at_s, what=age))
        return devices(view)

    assert "60 Hz" in shown((0.0, 1), (0.5, 20), (1.0, 61))
    assert "60 Hz" in shown((0.0, 1), (1.0, 61), (1.2, 61))
    assert "0 Hz" in shown((0.0, 1), (1.0, 61), (2.0, 61))
    assert "Hz" not in shown((0.0, 1), (1.0, 61), (2.0, 3))


def test_a_long_case_keeps_a_bounded_number_of_journal_lines() -> None:
    lines = [JournalLine(line={"entry": "motion", "sequence": number}) for number in range(2 * JOURNAL_KEPT)]
    assert len(view_after(*lines).journal) == JOURNAL_KEPT


def test_a_journal_line_shows_its_time_and_what_it_is_about() -> None:
    line = {
        "entry": "stage",
        "sequence": 121,
        "host_time": "2026-11-21T10:21:05.246+00:00",
        "trajectory": "T1",
    }
    view = view_after(JournalLine(line={**line, "task": "skin", "previous": "ab" * 32}))
    assert view.journal == ("121 10:21:05 stage: T1, skin",)


def test_a_fault_notice_shows_the_advice_only_once() -> None:
    view = view_after(Fault(code="RSI-010", what="RSI-010: it stopped. Look.", advice="Look."))
    assert (view.notices[0].what, view.notices[0].advice) == ("it stopped.", "Look.")


def test_the_notice_of_a_failed_step_is_settled_once_the_step_is_done() -> None:
    failed = (
        StepState(step="check", state="begun"),
        Fault(code="TOOL-005", what="TOOL-005: bent. Seat it.", advice="Seat it."),
        StepState(step="check", state="failed"),
        StepState(step="check", state="begun"),
    )
    assert [one.settled for one in view_after(*failed).notices] == [False]
    assert [one.settled for one in view_after(*failed, StepState(step="other", state="done")).notices] == [
        False
    ]
    passed = view_after(*failed, StepState(step="check", state="done"))
    assert [one.settled for one in passed.notices] == [True]
    assert "✓ settled TOOL-005" in notices(passed)
    assert "Seat it" not in notices(passed)


def test_a_file_of_more_devices_than_any_theatre_has_does_not_fill_every_stored_view() -> None:
    seen = view_after(*(DeviceState(device=f"d{number}", state="active") for number in range(200)))
    assert list(seen.devices) == [f"d{number}" for number in range(MOST_DEVICES)]
