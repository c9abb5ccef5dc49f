"""Hazard 12: the head moves while the guide moves or waits at its target, and the arm stops."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from clinical_case import FIRST, SPHERES_MM, ClinicalCell
from frame_trials import frames_to_alarm
from prepared_results import checked_set_up
from recording_cell import STEREO_HEAD
from waiting import eventually
from watched_case import findings, on_the_way, positioned, voiding, watched

from procedures.engine.events import Advisory
from procedures.guards import head_frames, motion_watch, patient_watch, watch_thread
from procedures.guards.assistant_on_axis import LARGEST_OFF_MM
from procedures.guards.errors import BaseShifted, InsertionDisturbed, PatientMoved
from procedures.guards.guide_displacement import GuideAtRest
from procedures.guards.room_watch import RoomWatch
from procedures.guards.tracker_guards import JUDGED
from procedures.journal.errors import JournalNotWritable, StepRefused
from procedures.journal.journal import Entry
from procedures.operator.question import Answer, Question, Topic
from procedures.steps.clinical import global_localization
from procedures.workcell import MountedTool
from procedures.workcell.arm_history import MotionKind
from ronna_hw.config import WatchPatient
from ronna_hw.devices.errors import MotionInterrupted
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import ArmReading, TrackerFrame
from ronna_hw.errors import DeviceError, LinkTimeout

pytestmark = pytest.mark.hazard(12)

MOVED_MM = np.add(SPHERES_MM, (0.0, 0.5, 0.0))
MOST_FRAMES = 12
TRIALS = 40


def head_moves(cell: ClinicalCell) -> Callable[[], None]:
    """The head moves, and the motion goes on until somebody stops it."""

    def move() -> None:
        cell.tracker.spheres_mm = MOVED_MM
        eventually(lambda: cell.arm.stops > 0)
        cell.arm.interruptions = 1

    return move


@pytest.mark.branch("REFERENCE_MOVED")
@pytest.mark.parametrize(("jogged_rad", "motion"), [(0.0, "go"), (0.1, "home")])  # first of all it goes home
def test_a_head_that_moves_during_a_motion_stops_the_arm_and_voids_the_registration(
    cell: ClinicalCell, jogged_rad: float, motion: str
) -> None:
    engine = watched(cell)
    A1, *others = cell.arm.joints_rad
    cell.arm.joints_rad = (A1 + jogged_rad, *others)
    on_the_way(cell, head_moves(cell))
    with pytest.raises(PatientMoved, match=rf"moved.*, during the motion '{motion}'"):
        positioned(engine)
    assert cell.arm.motions == []  # it has not arrived
    assert cell.entries("voided", "failed") == [
        ("voided", "registration"),
        ("failed", f"positioning:{FIRST}"),
    ]
    assert engine.machine.state == "held"
    engine.retreat_home()  # not stopped by the same shift
    assert cell.workcell.master.place.is_home


def test_a_shift_in_the_first_frame_stops_the_arm_before_the_motion_begins(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(head_frames, "AVERAGED", 1)
    engine = watched(cell)
    positioned(engine)
    cell.arm.state, before = Lifecycle.ACTIVE, cell.arm.stops
    cell.tracker.spheres_mm = MOVED_MM  # while a question was open
    with pytest.raises(PatientMoved), engine.checkpoint.watching("the next motion", MotionKind.GO):
        stops = cell.arm.stops
    assert stops > before


@pytest.mark.hazard(13)
def test_a_moved_cart_that_no_second_look_confirms_is_named_and_leaves_the_way_home_open(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = watched(cell)

    def wheel_away() -> None:
        cell.tracker.frame_shift_mm = (60.0, -40.0, 0.0)
        eventually(lambda: cell.arm.stops > 0)
        cell.arm.interruptions = 1

    def silent(*_args: object) -> None:
        raise LinkTimeout("the tracker does not answer")

    on_the_way(cell, wheel_away)
    monkeypatch.setattr(motion_watch, "read_watched", silent)
    with pytest.raises(BaseShifted, match=r"has moved during.*limit 18\.4 mm"):
        positioned(engine)
    assert engine.setting.memory.find(RoomWatch) is None
    engine.retreat_home()
    assert cell.workcell.master.place.is_home


@pytest.mark.hazard(13)
def test_an_arm_that_a_fault_is_stopping_is_not_taken_for_a_moved_cart(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = watched(cell)
    read, frames = cell.tracker.read_frame, []

    def read_frame(timeout_s: float = 1.0) -> TrackerFrame:
        frames.append(timeout_s)
        return read(timeout_s)

    def coasts() -> None:  # its last reading is from before
        known = replace(cell.arm.observe(), stopped=True)
        monkeypatch.setattr(cell.arm, "observe", lambda: known)
        cell.tracker.frame_shift_mm = (60.0, -40.0, 0.0)
        seen = len(frames)
        eventually(lambda: len(frames) > seen + MOST_FRAMES)
        cell.tracker.frame_shift_mm = (0.0, 0.0, 0.0)
        monkeypatch.undo()

    monkeypatch.setattr(cell.tracker, "read_frame", read_frame)
    on_the_way(cell, coasts)
    positioned(engine)
    assert cell.arm.stops == 0


def test_an_interruption_while_the_first_frame_is_awaited_ends_the_watch(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = watched(cell)

    def interrupted(looking: watch_thread.WatchThread) -> None:
        looking._thread.start()
        raise KeyboardInterrupt

    monkeypatch.setattr(watch_thread.WatchThread, "begin", interrupted)
    with pytest.raises(KeyboardInterrupt):
        positioned(engine)
    assert "patient watch" not in {thread.name for thread in threading.enumerate()}
    assert cell.arm.motions == []


def test_the_stop_is_ordered_again_while_the_arm_may_still_move(cell: ClinicalCell) -> None:
    engine = watched(cell)

    def unheard(*_kind: object) -> None:  # it does not bring the arm into HOLD
        cell.arm.stops += 1

    def move() -> None:
        cell.arm.stop = unheard  # type: ignore[method-assign]
        cell.tracker.spheres_mm = MOVED_MM
        eventually(lambda: cell.arm.stops > 1)
        cell.arm.interruptions = 1

    on_the_way(cell, move)
    with pytest.raises(PatientMoved):
        positioned(engine)


def test_a_tracker_moved_as_the_way_in_begins_is_followed_and_distinguished_from_a_moved_head(
    cell: ClinicalCell,
) -> None:
    engine = watched(cell)
    move, way_mm = cell.arm.move_line, (0.0, 2.0, 0.0)

    def pushed_meanwhile(*_words: Any, **_more: Any) -> ArmReading:
        cell.arm.move_line = move  # type: ignore[method-assign]
        cell.tracker.spheres_mm, cell.tracker.frame_shift_mm = np.add(SPHERES_MM, way_mm), way_mm
        eventually(lambda: cell.arm.stops > 0)
        cell.arm.state = Lifecycle.HOLD
        raise MotionInterrupted("stopped before it has left")

    cell.arm.move_line = pushed_meanwhile  # type: ignore[method-assign]
    positioned(engine)
    (followed,) = [text for text in findings(cell) if "the tracker was moved" in text]
    assert "by 2.0 mm as seen at the head" in followed
    assert "during the motion 'insert'" in followed
    assert cell.entries("voided") == []


def test_a_head_that_moves_while_the_surgeon_works_is_reported_at_once(cell: ClinicalCell) -> None:
    engine = watched(cell)
    positioned(engine)
    reader, answer = engine.events.subscribe(), cell.operator.ask

    def shown() -> bool:
        return any(isinstance(one.what, Advisory) for one in reader.read(0.1).events)

    def move_and_answer(question: Question) -> Answer:
        if question.topic is Topic.AT_TARGET:
            cell.tracker.spheres_mm = MOVED_MM
            eventually(shown)
        return answer(question)

    cell.operator.ask = move_and_answer  # type: ignore[method-assign]
    with pytest.raises(PatientMoved, match=f"the hold at {FIRST}"):
        engine.run_step(engine.order.find(f"at_target:{FIRST}"))
    assert all(
        cell.workcell.master.instrument.stages.tasks_at(FIRST).values()
    )  # what was confirmed meanwhile is done


def test_a_head_that_moved_is_still_watched_when_that_could_not_be_journalled(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = watched(cell)
    positioned(engine)
    write = cell.journal.write

    def full(entry: Entry, theatre_time_s: float, **data: Any) -> None:
        if entry is Entry.VOIDED:
            raise JournalNotWritable("cannot write journal.jsonl: No space left on device")
        write(entry, theatre_time_s, **data)

    def move(question: Question) -> None:
        if question.topic is Topic.SKIN:
            cell.tracker.spheres_mm = MOVED_MM
            read = cell.tracker.frames_read
            eventually(lambda: cell.tracker.frames_read > read + 3 * MOST_FRAMES)

    cell.operator.meanwhile = move
    key = engine.order.find(f"at_target:{FIRST}")
    with monkeypatch.context() as patch:
        patch.setattr(cell.journal, "write", full)
        with pytest.raises(JournalNotWritable):
            engine.run_step(key)
    cell.operator.asked.clear()
    with pytest.raises(PatientMoved):
        engine.run_step(key)
    assert Topic.DRILL not in [question.topic for question in cell.operator.asked]
    assert cell.entries("voided") != []


def test_work_begins_only_with_a_watch_on_the_head(cell: ClinicalCell) -> None:
    engine = watched(cell)
    positioned(engine)
    engine.setting.memory.drop(RoomWatch)
    cell.tracker.spheres_mm = MOVED_MM
    with pytest.raises(PatientMoved):
        engine.run_step(engine.order.find(f"at_target:{FIRST}"))
    assert cell.operator.asked[-1].topic is not Topic.SKIN


def test_a_head_out_of_sight_is_a_finding(cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(motion_watch, "LONGEST_HEAD_UNSEEN_S", 0.05)
    engine = watched(cell)

    def hide() -> None:
        cell.tracker.spheres_mm = SPHERES_MM[:2]
        read = cell.tracker.frames_read
        eventually(lambda: cell.tracker.frames_read > read + 4)

    on_the_way(cell, hide)
    positioned(engine)
    assert len([text for text in findings(cell) if "has not seen the head" in text]) == 1


@pytest.mark.parametrize("problem", [DeviceError("it is too hot"), ValueError("nobody expected that")])
def test_a_watch_that_fails_during_a_motion_stops_nothing_and_is_a_finding(
    cell: ClinicalCell, problem: Exception
) -> None:
    engine = watched(cell)
    read, reader = cell.tracker.read_frame, engine.events.subscribe()

    def fail(_timeout_s: float = 1.0) -> None:
        cell.tracker.read_frame = read  # type: ignore[method-assign]
        raise problem

    def shown() -> bool:
        said = [one.what for one in reader.read(0.1).events]
        return any(isinstance(one, Advisory) and "the head is not watched" in one.text for one in said)

    def break_it() -> None:
        cell.tracker.read_frame = fail  # type: ignore[assignment,method-assign]
        eventually(shown)  # while the arm is on its way
        eventually(lambda: cell.tracker.state is Lifecycle.CONFIGURED)

    on_the_way(cell, break_it)
    positioned(engine)
    assert any("the head was not watched" in text for text in findings(cell))


def test_a_motion_that_the_tracker_cannot_watch_is_a_finding(cell: ClinicalCell) -> None:
    engine = watched(cell)
    positioned(engine)
    cell.tracker.state = Lifecycle.FAULT
    with engine.checkpoint.watching("the next motion", MotionKind.GO):
        pass
    assert findings(cell)[-1] == "the head was not watched during the next motion: the tracker is fault"


@pytest.mark.hazard(64)
def test_a_guide_that_is_pushed_stops_the_assistant_on_its_way_through_it(cell: ClinicalCell) -> None:
    engine = watched(cell)
    positioned(engine)
    unseen_mm = np.full((3, 3), np.nan)
    pushed = GuideAtRest("T1", np.zeros(3), np.zeros(3), unseen_mm, now_mm=0.5, is_worked_through=True)
    engine.setting.memory.keep(pushed)
    with (
        pytest.raises(InsertionDisturbed, match="PRO-054: the guide was pushed"),
        engine.checkpoint.watching("the way in", MotionKind.INSERT),
    ):
        eventually(lambda: cell.arm.stops > 0)
    with engine.checkpoint.watching("the way out", MotionKind.WITHDRAW):
        pass
    pushed.now_mm = 1.1 * LARGEST_OFF_MM
    with (
        pytest.raises(InsertionDisturbed, match="PRO-054: the guide was pushed"),
        engine.checkpoint.watching("the way out", MotionKind.WITHDRAW),
    ):
        pass


def test_a_tracker_that_replies_late_during_a_motion_stops_nothing_and_is_a_finding(
    cell: ClinicalCell,
) -> None:
    engine = watched(cell)
    reader = engine.events.subscribe()

    def shown() -> bool:
        said = [one.what for one in reader.read(0.1).events]
        return any(isinstance(one, Advisory) and "watched late" in one.text for one in said)

    def delay_it() -> None:
        cell.tracker.replies_s = (0.5,) * JUDGED
        eventually(shown)  # while the arm is on its way

    on_the_way(cell, delay_it)
    positioned(engine)
    late = [text for text in findings(cell) if "watched late" in text]
    assert ["'go'" in late[0], "'insert'" in late[1]] == [True, True]  # each motion that was watched so


@pytest.mark.parametrize(("when", "watches"), [(WatchPatient.NEVER, False), (WatchPatient.INSTRUMENT, True)])
def test_watching_the_patient_can_be_switched_off(
    cell: ClinicalCell, when: WatchPatient, watches: bool
) -> None:
    engine = watched(cell)
    watch = patient_watch(engine, voiding(engine))
    watch.when = when
    engine.checkpoint.watching = watch.watching
    seen: list[Lifecycle] = []
    on_the_way(cell, lambda: seen.append(cell.tracker.state))
    positioned(engine)
    assert (seen == [Lifecycle.ACTIVE]) is watches


def test_at_home_the_stereo_head_is_mounted_again_and_the_case_starts_with_the_tracker(
    cell: ClinicalCell,
) -> None:
    cell.carrying(MountedTool.GUIDE)
    engine = cell.begin(checked_set_up(cell), global_localization.STEP)
    engine.run_to(engine.order.sequence[0])
    home = cell.arm.joints_rad
    A1, *others = home
    cell.arm.joints_rad = (A1 + 0.2, *others)
    with pytest.raises(StepRefused, match="send it home"):
        engine.run_to()
    engine.retreat_home()
    engine.run_to()
    assert cell.room.changed == [(STEREO_HEAD, Lifecycle.CONFIGURED, home)]
    assert cell.operator.asked[-1].value == f"the stereo head, tool {STEREO_HEAD}"
    assert cell.workcell.master.tool is MountedTool.STEREO_HEAD
    assert engine.upcoming is None


def test_half_a_millimetre_is_detected_within_twelve_frames_and_quiet_motions_raise_no_alarm() -> None:
    noticed = [frames_to_alarm(trial, 0.5) for trial in range(TRIALS)]
    assert max(noticed, key=lambda count: count or 99) in range(1, MOST_FRAMES + 1), noticed
    assert {frames_to_alarm(trial, 0.0) for trial in range(TRIALS)} == {None}


@pytest.mark.parametrize("hidden", [0.1, 0.3])
def test_a_head_that_moves_behind_hands_is_noticed_and_a_quiet_one_is_not(hidden: float) -> None:
    noticed = [frames_to_alarm(trial, 3.0, hidden) for trial in range(TRIALS)]
    assert None not in noticed
    assert np.median([count or 0 for count in noticed]) <= MOST_FRAMES
    assert {frames_to_alarm(trial, 0.0, hidden) for trial in range(TRIALS)} == {None}
