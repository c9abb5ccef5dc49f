"""The view of a case is folded from its events alone."""

from __future__ import annotations

from case_events import ORDER, events_of, question, view_after

from procedures.engine.case_view import JOURNAL_KEPT, MOST_DEVICES, CaseView, fold
from procedures.engine.events import (
    Answered,
    Bodies,
    DeviceState,
    Fault,
    JournalLine,
    Order,
    OrderedStep,
    Pose,
    Progress,
    ScanProgress,
    Seat,
    StepState,
)


def test_a_completed_step_is_shown_as_done_and_a_superseded_one_as_superseded() -> None:
    done = StepState(step="fit:T1", state="done", summary="0.2 mm", record="03-fit-T1")
    view = view_after(ORDER, StepState(step="fit:T1", state="begun"), done)
    assert (view.steps[2].state, view.steps[2].summary, view.running) == ("done", "0.2 mm", "")
    gone = StepState(step="image", state="superseded", record="03-fit-T1")
    again = view_after(ORDER, done, gone)
    assert (again.steps[2].state, again.steps[2].summary) == ("superseded", done.summary)
    voided = view_after(ORDER, done, gone.model_copy(update={"summary": "the cart has moved"}))
    assert (voided.steps[2].state, voided.steps[2].summary) == ("superseded", "the cart has moved")


def test_a_scan_stays_in_view_through_the_steps_after_it_until_a_result_is_superseded() -> None:
    scan = ScanProgress(looks_done=1, looks_planned=2, covered_share=0.5, predicted_error_mm=None)
    begun, after = (StepState(step=step, state="begun") for step in ("image", "fit:T1"))
    scanned = (ORDER, begun, Progress(step="image", share=0.5, text="", scan=scan))
    later = (*scanned, after, Progress(step="fit:T1", share=0.5, text=""))
    assert view_after(*later).scan == scan
    assert view_after(*later, StepState(step="image", state="superseded", record="1")).scan is None


def test_a_resumed_run_shows_its_results_as_done_and_drops_open_question_and_seat() -> None:
    step = OrderedStep(step="image", title="Image", phase="operation", moves=False, record="01-image")
    killed = (JournalLine(line={"entry": "opened"}), ORDER, question(2), Seat(holder="Ana"))
    view = view_after(*killed, JournalLine(line={"entry": "restarted"}), Order(steps=(step,)))
    assert [(row.state, row.record) for row in view.steps] == [("done", "01-image")]
    assert (view.question, view.seat, view.results) == (None, None, 1)


def test_a_result_older_than_a_fault_of_the_arm_is_in_doubt_until_it_is_kept_or_made_again() -> None:
    steps = ("localization:T1", "fit:T1")
    done = [StepState(step=step, state="done", record=step) for step in steps]
    doubted = JournalLine(line={"entry": "doubted", "steps": list(steps), "fault": "EKI-010"})
    view = view_after(ORDER, *done, doubted)
    assert [row.doubt for row in view.steps] == ["", "EKI-010", "EKI-010"]
    again = view_after(ORDER, *done, doubted, done[1])
    assert [row.doubt for row in again.steps] == ["", "EKI-010", ""]
    asked = question(1, topic="registration_kept:T1")
    for answer, doubt in (("yes", ""), ("no", "EKI-010")):
        kept = view_after(ORDER, *done, doubted, asked, Answered(question=1, answer=answer))
        assert kept.steps[2].doubt == doubt


def test_a_resumed_run_shows_which_results_are_in_doubt() -> None:
    known = {"title": "Fit", "phase": "operation", "moves": False, "record": "03"}
    view = view_after(Order(steps=(OrderedStep(step="fit:T1", doubt="EKI-010", **known),)))
    assert view.steps[0].doubt == "EKI-010"


def test_an_answer_removes_only_its_own_question() -> None:
    assert view_after(question(2), Answered(question=1, answer="yes")).question is not None
    assert view_after(question(2), Answered(question=2, answer="yes")).question is None


def test_a_signal_that_was_written_late_changes_neither_the_time_nor_the_next_step() -> None:
    late = Progress(step="image", share=0.9, text="reading")
    early, begun = events_of([late, StepState(step="fit:T1", state="begun")])
    view = fold(fold(CaseView(), begun), early)
    assert (view.running, view.share, view.doing) == ("fit:T1", 0.0, "")
    assert (view.number, view.theatre_time_s) == (2, 0.2)


def test_each_arm_has_its_own_pose_and_the_guides_arm_is_the_one_whose_bodies_came_first() -> None:
    places_mm = {"arm": ((0.0,) * 6, (1.0,) * 6), "assistant": ((2.0,) * 6,)}
    bodies = [Bodies(arm=arm, moving=(), links=1, fixed=(), pairs=()) for arm in places_mm]
    own, other = (
        Pose(arm=arm, joints_rad=(0.1,), age_s=0.0, bodies_mm=places) for arm, places in places_mm.items()
    )
    view = view_after(*bodies, other, own)
    assert {arm: reported.pose for arm, reported in view.poses.items()} == {"arm": own, "assistant": other}
    assert view.tool_with_guide_mm == ((1.0,) * 6,)


def test_the_guides_arm_is_the_first_for_whoever_joins_after_a_tool_change() -> None:
    arm, assistant = (
        Bodies(arm=name, with_guide=name == "arm", moving=(), fixed=(), pairs=())
        for name in ("arm", "assistant")
    )
    assert list(view_after(assistant, arm).bodies) == ["arm", "assistant"]


def test_an_event_file_of_ever_other_arms_keeps_a_bounded_view() -> None:
    poses = [Pose(arm=f"arm {number}", joints_rad=(), age_s=0.0) for number in range(200)]
    assert list(view_after(*poses).poses) == [f"arm {number}" for number in range(MOST_DEVICES)]


def test_a_long_case_of_many_devices_keeps_a_bounded_view() -> None:
    lines = [JournalLine(line={"entry": "motion", "sequence": number}) for number in range(2 * JOURNAL_KEPT)]
    devices = [DeviceState(device=f"d{number}", state="active") for number in range(200)]
    seen = view_after(*lines, *devices)
    assert len(seen.journal) == JOURNAL_KEPT
    assert list(seen.devices) == [f"d{number}" for number in range(MOST_DEVICES)]


def test_a_fault_notice_shows_the_advice_only_once() -> None:
    view = view_after(Fault(code="RSI-010", what="RSI-010: it stopped. Look.", advice="Look."))
    assert (view.notices[0].what, view.notices[0].advice) == ("it stopped.", "Look.")
