"""The first motion is confirmed, and a stopped one is planned again only if the operator agrees."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from coded_errors import raises
from plain_steps import plain_order
from recording_cell import HOME, RecordingArm, RecordingCell, RecordingOperator

from procedures.engine.engine import Engine
from procedures.journal.journal import JOURNAL_FILE, Line, read_journal
from procedures.operator.errors import NotConfirmed, OperatorAborted
from procedures.operator.question import Answer, Question, Topic
from procedures.workcell import MountedTool
from procedures.workcell.errors import INSTRUMENT_IN_GUIDE
from ronna_hw.arm.clearance.sweep import ClosestPair
from ronna_hw.arm.errors import NotClear
from ronna_hw.devices.errors import MotionInterrupted
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.vectors import JointVector


def turned(by_rad: float) -> JointVector:
    A1, A2, A3, A4, A5, A6 = HOME
    return (A1 + by_rad, A2, A3, A4, A5, A6)


def supervised(cell: RecordingCell, *refusing: Topic) -> Engine:
    """An engine over a cell at home with the stereo head mounted, whose arm is active."""
    cell.operator = RecordingOperator(*refusing)
    cell.arm.state = Lifecycle.ACTIVE
    cell.workcell.master.mount.check(MountedTool.STEREO_HEAD)
    cell.workcell.master.set_home()
    return cell.engine(plain_order())


def topics(cell: RecordingCell) -> list[Topic]:
    return [question.topic for question in cell.operator.asked]


@pytest.mark.hazard(36)
def test_only_the_first_motion_is_confirmed_and_the_question_states_what_will_move(
    cell: RecordingCell,
) -> None:
    supervised(cell)
    cell.workcell.master.go(turned(0.1))
    cell.workcell.master.go(turned(0.2))
    assert topics(cell) == [Topic.FIRST_MOTION]
    (asked,) = cell.operator.asked
    assert asked.read_back is not None
    first, then, closest, speed = asked.value.splitlines()
    assert first == f"first: the stereo head {asked.read_back.shown}"
    assert asked.read_back.shown == f"moves {asked.read_back.value} mm"
    assert asked.read_back.fits(f"{asked.read_back.value}mm")
    assert then == (
        "then: a yes also covers every later motion without a question of its own, until the arm is stopped "
        "or its stream ends"
    )
    assert (closest, speed.partition(",")[0]) == ("closest: nothing near", "speed: up to 100 mm/s")


@pytest.mark.hazard(36)
def test_nothing_moves_unless_the_first_motion_is_confirmed(cell: RecordingCell) -> None:
    supervised(cell, Topic.FIRST_MOTION)
    with pytest.raises(NotConfirmed, match="PRO-002"):
        cell.workcell.master.go(turned(0.1))
    assert cell.arm.motions == []


def test_nobody_is_asked_about_a_motion_that_is_not_clear(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    supervised(cell)
    near = ClosestPair("hand of the master", "forearm of the assistant", 3.0, 0.5)
    previews, around = cell.arm.preview, []
    monkeypatch.setattr(
        cell.arm,
        "preview",
        lambda motion, **start: replace(previews(motion, **start), refused=near if around else None),
    )
    monkeypatch.setattr(cell.workcell.motion, "look_around", around.append)

    with pytest.raises(
        NotClear, match="hand of the master would come too close to the forearm of the assist"
    ):
        cell.workcell.master.settle(turned(0.1), None)
    assert topics(cell) == []
    assert cell.arm.motions == []


@pytest.mark.hazard(32)
def test_after_a_stop_the_next_motion_needs_confirmation_again(cell: RecordingCell) -> None:
    supervised(cell)
    cell.workcell.master.go(turned(0.1))
    cell.workcell.stop()
    cell.workcell.master.go(turned(0.2))
    assert topics(cell) == [Topic.FIRST_MOTION] * 2


@pytest.mark.hazard(5)
def test_a_stopped_motion_resumes_from_the_current_position_if_the_operator_agrees(
    cell: RecordingCell,
) -> None:
    engine = supervised(cell)
    cell.arm.interruptions = 1
    cell.workcell.master.go(turned(0.2))
    assert topics(cell) == [Topic.FIRST_MOTION, Topic.PAUSE, Topic.FIRST_MOTION]
    assert cell.arm.motions == [("joints", turned(0.2))]
    assert cell.arm.calls == ["resume"]
    assert engine.machine.state == "idle"


@pytest.mark.hazard(5)
def test_a_stop_during_the_first_question_holds_the_arm_until_it_is_answered(cell: RecordingCell) -> None:
    engine, ask, at_pause = supervised(cell), cell.operator.ask, []

    def stopping(question: Question) -> Answer:
        if question.topic is Topic.FIRST_MOTION and not at_pause:
            engine.checkpoint.pause("somebody stopped the arm")
            cell.arm.state = Lifecycle.HOLD
        if question.topic is Topic.PAUSE:
            at_pause.append((cell.arm.state, list(cell.arm.motions)))
        return ask(question)

    cell.operator.ask = stopping  # type: ignore[method-assign]
    cell.workcell.master.go(turned(0.1))
    assert topics(cell) == [Topic.FIRST_MOTION, Topic.PAUSE, Topic.FIRST_MOTION]
    assert at_pause == [(Lifecycle.HOLD, [])]


@pytest.mark.hazard(5)
def test_a_stop_right_before_a_motion_pauses_the_step(cell: RecordingCell) -> None:
    engine = supervised(cell)
    unwatched = engine.checkpoint.watching

    @contextmanager
    def stopped_once(_what: str, _arm_moves: bool) -> Iterator[None]:
        engine.checkpoint.watching = unwatched
        cell.arm.state = Lifecycle.HOLD
        yield

    engine.checkpoint.watching = stopped_once
    cell.workcell.master.go(turned(0.2))
    assert topics(cell) == [Topic.FIRST_MOTION, Topic.PAUSE, Topic.FIRST_MOTION]
    assert cell.arm.motions == [("joints", turned(0.2))]


@pytest.mark.hazard(5)
def test_a_stop_while_the_arm_rests_between_two_motions_pauses_the_step(cell: RecordingCell) -> None:
    supervised(cell)
    cell.workcell.master.go(turned(0.1))
    cell.arm.state = Lifecycle.HOLD  # by a thread that knows nothing of the case
    cell.workcell.master.go(turned(0.2))
    assert topics(cell) == [Topic.FIRST_MOTION, Topic.PAUSE, Topic.FIRST_MOTION]
    assert cell.arm.motions == [("joints", turned(0.1)), ("joints", turned(0.2))]


def test_an_arm_that_a_step_holds_between_two_motions_is_led_on_without_a_question(
    cell: RecordingCell,
) -> None:
    supervised(cell)
    cell.workcell.master.go(turned(0.1))
    cell.workcell.master.hold()
    cell.workcell.master.go(turned(0.2))
    assert topics(cell) == [Topic.FIRST_MOTION]
    assert cell.arm.motions == [("joints", turned(0.1)), ("joints", turned(0.2))]


@pytest.mark.hazard(5)
def test_a_stop_during_a_question_is_not_undone_by_its_answer(cell: RecordingCell) -> None:
    supervised(cell)

    def stop_once(_question: Question) -> None:
        cell.operator.meanwhile = lambda _later: None
        cell.arm.state = Lifecycle.HOLD

    cell.operator.meanwhile = stop_once
    cell.workcell.master.go(turned(0.1))
    assert topics(cell) == [Topic.FIRST_MOTION, Topic.PAUSE, Topic.FIRST_MOTION]
    assert cell.arm.calls == ["resume"]


def test_a_stopped_motion_does_not_resume_if_the_operator_aborts(cell: RecordingCell) -> None:
    supervised(cell, Topic.PAUSE)
    cell.arm.interruptions = 1
    with pytest.raises(OperatorAborted):
        cell.workcell.master.go(turned(0.2))
    assert cell.arm.motions == []
    assert cell.arm.state is Lifecycle.HOLD


WORDS = "the controller does not report which program it runs"


@dataclass
class ArmThatAsks(RecordingArm):
    to_confirm: str | None = WORDS

    def confirm_start(self, confirmed_by: str) -> None:
        self.calls.append("confirmed")

    def activate(self) -> None:
        if self.failing is not None:
            raise self.failing
        super().activate()


def cell_with(folder: Path, operator: RecordingOperator, *, words: str | None = WORDS) -> RecordingCell:
    """A cell before its arm is started, its engine asking."""
    cell = RecordingCell(folder, operator=operator)
    cell.arm = ArmThatAsks("arm", state=Lifecycle.CONFIGURED, to_confirm=words)
    cell.opened.replace_device("robot.master", cell.arm)
    cell.engine(plain_order())
    return cell


def motion_lines(folder: Path) -> list[Line]:
    return [line for line in read_journal(folder / JOURNAL_FILE) if line["entry"] in ("motion", "moved")]


@pytest.mark.hazard(20)
def test_an_arm_starts_after_the_operator_confirms_the_drivers_statement_and_is_led_nowhere(
    tmp_path: Path,
) -> None:
    cell = cell_with(tmp_path, RecordingOperator())
    cell.workcell.start()
    assert [(one.topic, one.value) for one in cell.operator.asked] == [(Topic.UNVERIFIED, WORDS)]
    assert cell.arm.calls == ["confirmed", "activate"]
    lines = [(line["entry"], line["number"], line.get("what")) for line in motion_lines(tmp_path)]
    assert lines == [("motion", 1, "start"), ("moved", 1, None)]
    assert not cell.workcell.master.place.is_out


def test_a_start_that_fails_has_its_result_in_the_journal(tmp_path: Path) -> None:
    cell = cell_with(tmp_path, RecordingOperator())
    cell.arm.failing = MotionInterrupted("stopped")
    with pytest.raises(MotionInterrupted):
        cell.workcell.start()
    assert [line.get("error") for line in motion_lines(tmp_path)] == [None, MotionInterrupted.code]


@pytest.mark.hazard(44)
def test_the_arm_does_not_start_with_an_instrument_in_the_guide(tmp_path: Path) -> None:
    cell = cell_with(tmp_path, RecordingOperator())
    cell.workcell.master.instrument.record_insertion("T1")
    with raises(INSTRUMENT_IN_GUIDE, match="start the arm"):
        cell.workcell.start()
    assert (cell.operator.asked, cell.arm.calls) == ([], [])


@pytest.mark.hazard(20)
def test_the_arm_stays_off_without_confirmation(tmp_path: Path) -> None:
    cell = cell_with(tmp_path, RecordingOperator(Topic.UNVERIFIED))
    with pytest.raises(NotConfirmed, match="start the arm"):
        cell.workcell.start()
    assert cell.arm.calls == []


@pytest.mark.hazard(36)
def test_the_first_motion_still_needs_its_own_confirmation(tmp_path: Path) -> None:
    cell = cell_with(tmp_path, RecordingOperator())
    cell.workcell.master.set_home()
    cell.workcell.master.mount.identify()
    cell.workcell.start()
    cell.workcell.master.go_home()
    assert [one.topic for one in cell.operator.asked] == [Topic.UNVERIFIED, Topic.FIRST_MOTION]


def test_an_arm_that_requires_no_confirmation_starts_without_asking(tmp_path: Path) -> None:
    cell = cell_with(tmp_path, RecordingOperator(), words=None)
    cell.workcell.start()
    assert cell.operator.asked == []
    assert cell.arm.calls == ["activate"]
