"""Hazard 13: the tracker is pushed while the patient's frame is in view, and the case follows it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from clinical_case import FIRST, SPHERES_MM, ClinicalCell
from pushed_tracker import PushedTracker, localized_by_frame, with_patient_frame
from waiting import eventually
from watched_case import findings, on_the_way, positioned, watched

from procedures.engine.engine import Engine
from procedures.guards import GuideDisplacement
from procedures.guards.errors import PatientMoved, RoomUndecided
from procedures.guards.guide_displacement import PUSHED_MM
from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.operator.question import Question, Topic
from procedures.runs.comparison import Comparison, compare_room
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.workcell import MountedTool
from procedures.workcell.arm_history import arm_history
from procedures.workcell.tracker_move import UNPUSHED
from ronna_hw.devices.errors import MotionInterrupted
from ronna_hw.devices.lifecycle import Lifecycle

pytestmark = [pytest.mark.hazard(12), pytest.mark.hazard(13)]

PUSH_MM = (12.0, -8.0, 5.0)
TURN_RAD = 0.005
READINGS = 10  # without noise
NAME = "global_localization"


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("procedures.guards.guide_displacement.BETWEEN_LOOKS_S", 0.0)
    monkeypatch.setattr("procedures.guards.guide_displacement.PLACE_READINGS", READINGS // 2)
    monkeypatch.setattr("procedures.guards.guide_displacement.END_READINGS", READINGS)


@pytest.fixture
def cell(tmp_path: Path) -> ClinicalCell:
    return ClinicalCell(tmp_path / "run")


@pytest.fixture
def tracker(cell: ClinicalCell) -> PushedTracker:
    return with_patient_frame(cell, MountedTool.GUIDE)


def before_the_approach(cell: ClinicalCell) -> Engine:
    engine = watched(cell, localized_by_frame())
    setting = engine.setting
    engine.checkpoint.guards.append(GuideDisplacement(setting.workcell, setting.memory))
    return engine


def follows(cell: ClinicalCell) -> list[str]:
    return [text for text in findings(cell) if "the tracker was moved" in text and "goes on" in text]


def pushed_at_the_target(tracker: PushedTracker, *, seen_by_watch: bool) -> Callable[[Question], None]:
    def push(question: Question) -> None:
        if question.topic is Topic.DRILL:
            tracker.push(PUSH_MM, TURN_RAD)
            read = tracker.frames_read
            if seen_by_watch:
                eventually(lambda: tracker.frames_read > read + 40)

    return push


@pytest.mark.parametrize("is_watched", [True, False], ids=["watched", "guide alone"])
def test_a_push_while_work_goes_on_at_the_target_is_followed_and_the_guide_is_not_pushed(
    cell: ClinicalCell, tracker: PushedTracker, is_watched: bool
) -> None:
    engine = before_the_approach(cell)
    positioned(engine)
    if not is_watched:
        engine.checkpoint.watching = lambda _what, _moves: nullcontext()
    cell.operator.meanwhile = pushed_at_the_target(tracker, seen_by_watch=is_watched)
    engine.run_step(engine.order.find(f"at_target:{FIRST}"))
    assert len(follows(cell)) == 1
    assert [one.topic for one in cell.operator.asked if one.topic is Topic.GUARD] == []
    assert not any("was pushed" in text for text in findings(cell))
    reached = cell.case.get(ReachedTarget, FIRST).result
    assert reached.pushed_mm is not None
    assert reached.pushed_mm < PUSHED_MM
    assert cell.entries("voided") == []


def test_a_guide_that_is_pushed_after_a_push_of_the_tracker_suspends_the_case(
    cell: ClinicalCell, tracker: PushedTracker
) -> None:
    engine = before_the_approach(cell)
    positioned(engine)

    def push(question: Question) -> None:
        if question.topic is Topic.DRILL:
            tracker.push(PUSH_MM, TURN_RAD)
        guarded = [one for one in cell.operator.asked if one.topic is Topic.GUARD]
        tracker.frame_shift_mm = (0.0, 1.0 if question.topic is Topic.DURA and not guarded else 0.0, 0.0)

    engine.checkpoint.watching = lambda _what, _moves: nullcontext()
    cell.operator.meanwhile = push
    engine.run_step(engine.order.find(f"at_target:{FIRST}"))
    assert [one.topic for one in cell.operator.asked if one.topic is Topic.GUARD] == [Topic.GUARD]


def pushed_on_the_way(cell: ClinicalCell, tracker: PushedTracker) -> Callable[[], None]:
    def push() -> None:
        tracker.push(PUSH_MM, TURN_RAD)
        eventually(lambda: cell.arm.stops > 0)
        cell.arm.interruptions = 1

    return push


@pytest.mark.branch("REFERENCE_UNDECIDED")
def test_a_push_during_a_motion_stops_it_voids_nothing_and_is_followed_from_home(
    cell: ClinicalCell, tracker: PushedTracker
) -> None:
    engine = before_the_approach(cell)
    on_the_way(cell, pushed_on_the_way(cell, tracker))
    with pytest.raises(RoomUndecided, match=r"PRO-052: the tracker, or the head with its clamp.*'go'"):
        positioned(engine)
    assert cell.entries("voided") == []
    with pytest.raises(RoomUndecided):  # the arm is still on its way
        positioned(engine)
    engine.retreat_home()
    positioned(engine)
    assert len(follows(cell)) == 1
    assert cell.entries("voided") == []


def test_a_push_as_a_motion_begins_is_followed_and_the_stopped_motion_is_planned_again(
    cell: ClinicalCell, tracker: PushedTracker
) -> None:
    engine = before_the_approach(cell)

    def push() -> None:
        tracker.push(PUSH_MM, TURN_RAD)
        eventually(lambda: cell.arm.stops > 0)
        cell.arm.state = Lifecycle.HOLD
        raise MotionInterrupted("stopped before it has left home")

    on_the_way(cell, push)
    positioned(engine)
    assert len(follows(cell)) == 1
    assert cell.entries("voided") == []
    assert [kind for kind, _ in cell.arm.motions] == ["joints", "line"]


@pytest.mark.parametrize(
    ("way_mm", "known_at_once", "void"),
    [
        (PUSH_MM, True, NAME),
        ((2.0, -3.0, 1.0), True, "registration"),
        ((1.5, 0.0, 1.0), False, "registration"),
    ],
    ids=["far", "as no push shows the arm", "as a push may show the arm"],
)
def test_a_head_that_moves_with_its_clamp_during_a_motion_is_never_followed(
    cell: ClinicalCell,
    tracker: PushedTracker,
    way_mm: tuple[float, float, float],
    known_at_once: bool,
    void: str,
) -> None:
    engine = before_the_approach(cell)

    def move() -> None:
        tracker.clamp_mm, tracker.spheres_mm = way_mm, np.add(SPHERES_MM, way_mm)
        eventually(lambda: cell.arm.stops > 0)
        cell.arm.interruptions = 1

    on_the_way(cell, move)
    with pytest.raises(PatientMoved if known_at_once else RoomUndecided):
        positioned(engine)
    if not known_at_once:
        assert cell.entries("voided") == []
        engine.retreat_home()
        with pytest.raises(PatientMoved, match="the head has moved"):
            positioned(engine)
    assert ("voided", void) in cell.entries("voided")
    assert follows(cell) == []


def restarted(cell: ClinicalCell, engine: Engine) -> None:
    """As after a restart of the program, which has all from the journal."""
    engine.setting.memory.clear()
    cell.workcell.master.restore_history(arm_history(read_journal(cell.folder / JOURNAL_FILE)))


def compared(engine: Engine) -> tuple[bool, Comparison]:
    comparison = Comparison()
    return compare_room(engine, comparison), comparison


def test_a_followed_push_is_known_after_a_restart_with_the_arm_anywhere(
    cell: ClinicalCell, tracker: PushedTracker
) -> None:
    engine = before_the_approach(cell)
    tracker.push(PUSH_MM, TURN_RAD)
    positioned(engine)  # from home: followed
    name = engine.case.record_of(engine.order.find(NAME))
    assert name is not None
    history = arm_history(read_journal(cell.folder / JOURNAL_FILE))
    assert history.tracker is not None
    assert history.tracker[0] == name
    assert tracker.move is not None
    known = history.tracker[1]
    assert known.move.translation_mm == pytest.approx(tracker.move.translation_mm, abs=1e-6)

    assert known.pushes == 1
    assert cell.workcell.tracker_move("another") is UNPUSHED
    restarted(cell, engine)
    seen, comparison = compared(engine)
    assert seen
    assert comparison.differences == []
    assert any("patient: spheres within 0.00 mm" in text for text in comparison.findings)


def test_a_push_while_the_program_was_not_running_is_followed_where_the_arm_was_seen_before(
    cell: ClinicalCell, tracker: PushedTracker
) -> None:
    engine = before_the_approach(cell)
    positioned(engine)
    tracker.push(PUSH_MM, TURN_RAD)
    restarted(cell, engine)
    seen, comparison = compared(engine)
    assert seen
    assert comparison.differences == []
    assert any("the tracker was moved" in text for text in comparison.findings)


def test_a_push_while_the_program_was_not_running_is_otherwise_compared_once_the_arm_is_home(
    cell: ClinicalCell, tracker: PushedTracker
) -> None:
    engine = before_the_approach(cell)
    A1, A2, *others = cell.arm.joints_rad
    cell.arm.joints_rad = (A1 + 0.1, A2 + 0.2, *others)
    engine.compare_places()  # as a program does that begins
    tracker.push(PUSH_MM, TURN_RAD)
    engine.setting.memory.clear()
    seen, comparison = compared(engine)
    assert not seen
    assert comparison.differences == []
    engine.retreat_home()
    seen, comparison = compared(engine)
    assert seen
    assert comparison.differences == []
    assert any("the tracker was moved" in text for text in comparison.findings)


def test_two_spheres_and_an_unknown_point_are_compared_once_the_arm_is_home(
    cell: ClinicalCell, tracker: PushedTracker
) -> None:
    engine = before_the_approach(cell)
    tracker.spheres_mm = np.vstack([SPHERES_MM[:2], np.add(SPHERES_MM[2], (0.0, 20.0, 0.0))])
    seen, comparison = compared(engine)
    assert not seen
    assert comparison.differences == []


def test_what_the_head_is_compared_by_is_said(cell: ClinicalCell, tracker: PushedTracker) -> None:
    engine = before_the_approach(cell)
    tracker.spheres_mm = SPHERES_MM[:0]
    seen, comparison = compared(engine)
    assert seen
    said = "patient: the frame on the clamp within 0.00 mm of its recorded position; "
    assert said + "the head in the clamp was not compared" in comparison.findings
