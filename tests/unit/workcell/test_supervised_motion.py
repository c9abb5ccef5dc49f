"""The first motion is confirmed, and a stopped one is planned again only if the operator agrees."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from plain_steps import plain_order
from recording_cell import HOME, RecordingCell, RecordingOperator

from procedures.engine.engine import Engine
from procedures.operator.errors import NotConfirmed, OperatorAborted
from procedures.operator.question import Question, Topic
from procedures.workcell import MountedTool
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import JointVector


def turned(by_rad: float) -> JointVector:
    A1, A2, A3, A4, A5, A6 = HOME
    return (A1 + by_rad, A2, A3, A4, A5, A6)


def supervised(cell: RecordingCell, *refusing: Topic) -> Engine:
    """An engine over a cell at home with the stereo head mounted, whose arm is active."""
    cell.operator = RecordingOperator(*refusing)
    cell.arm.state = Lifecycle.ACTIVE
    cell.workcell.check_mounted(MountedTool.STEREO_HEAD)
    cell.workcell.set_home()
    return cell.engine(plain_order())


def topics(cell: RecordingCell) -> list[Topic]:
    return [question.topic for question in cell.operator.asked]


@pytest.mark.hazard(36)
def test_only_the_first_motion_is_confirmed_and_the_question_states_what_will_move(
    cell: RecordingCell,
) -> None:
    supervised(cell)
    cell.workcell.go(turned(0.1))
    cell.workcell.go(turned(0.2))
    assert topics(cell) == [Topic.FIRST_MOTION]
    (asked,) = cell.operator.asked
    assert asked.read_back is not None
    assert asked.value.startswith(f"the stereo head moves {asked.read_back.value} mm,\njoints turn ")
    assert asked.read_back.fits(f"{asked.read_back.value}mm")
    assert asked.value.endswith(
        "a yes also covers every later motion without a question of its own, until the arm is stopped or "
        "its stream ends"
    )


@pytest.mark.hazard(36)
def test_nothing_moves_unless_the_first_motion_is_confirmed(cell: RecordingCell) -> None:
    supervised(cell, Topic.FIRST_MOTION)
    with pytest.raises(NotConfirmed, match="PRO-002"):
        cell.workcell.go(turned(0.1))
    assert cell.arm.motions == []


@pytest.mark.hazard(32)
def test_after_a_stop_the_next_motion_needs_confirmation_again(cell: RecordingCell) -> None:
    supervised(cell)
    cell.workcell.go(turned(0.1))
    cell.workcell.stop()
    cell.workcell.go(turned(0.2))
    assert topics(cell) == [Topic.FIRST_MOTION] * 2


@pytest.mark.hazard(5)
def test_a_stopped_motion_resumes_from_the_current_position_if_the_operator_agrees(
    cell: RecordingCell,
) -> None:
    engine = supervised(cell)
    cell.arm.interruptions = 1
    cell.workcell.go(turned(0.2))
    assert topics(cell) == [Topic.FIRST_MOTION, Topic.PAUSE, Topic.FIRST_MOTION]
    assert cell.arm.motions == [("joints", turned(0.2))]
    assert cell.arm.calls == ["resume"]
    assert engine.machine.state == "idle"


@pytest.mark.hazard(5)
def test_a_stop_during_the_first_question_holds_the_arm_until_it_is_answered(cell: RecordingCell) -> None:
    engine, ask, at_pause = supervised(cell), cell.operator.ask, []

    def stopping(question: Question) -> str:
        if question.topic is Topic.FIRST_MOTION and not at_pause:
            engine.checkpoint.pause("somebody stopped the arm")
            cell.arm.state = Lifecycle.HOLD
        if question.topic is Topic.PAUSE:
            at_pause.append((cell.arm.state, list(cell.arm.motions)))
        return ask(question)

    cell.operator.ask = stopping  # type: ignore[method-assign]
    cell.workcell.go(turned(0.1))
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
    cell.workcell.go(turned(0.2))
    assert topics(cell) == [Topic.FIRST_MOTION, Topic.PAUSE, Topic.FIRST_MOTION]
    assert cell.arm.motions == [("joints", turned(0.2))]


@pytest.mark.hazard(5)
def test_a_stop_while_the_arm_rests_between_two_motions_pauses_the_step(cell: RecordingCell) -> None:
    supervised(cell)
    cell.workcell.go(turned(0.1))
    cell.arm.state = Lifecycle.HOLD  # by a thread that knows nothing of the case
    cell.workcell.go(turned(0.2))
    assert topics(cell) == [Topic.FIRST_MOTION, Topic.PAUSE, Topic.FIRST_MOTION]
    assert cell.arm.motions == [("joints", turned(0.1)), ("joints", turned(0.2))]


def test_an_arm_that_a_step_holds_between_two_motions_is_led_on_without_a_question(
    cell: RecordingCell,
) -> None:
    supervised(cell)
    cell.workcell.go(turned(0.1))
    cell.workcell.hold()
    cell.workcell.go(turned(0.2))
    assert topics(cell) == [Topic.FIRST_MOTION]
    assert cell.arm.motions == [("joints", turned(0.1)), ("joints", turned(0.2))]


@pytest.mark.hazard(5)
def test_a_stop_during_a_question_is_not_undone_by_its_answer(cell: RecordingCell) -> None:
    supervised(cell)

    def stop_once(_question: Question) -> None:
        cell.operator.meanwhile = lambda _later: None
        cell.arm.state = Lifecycle.HOLD

    cell.operator.meanwhile = stop_once
    cell.workcell.go(turned(0.1))
    assert topics(cell) == [Topic.FIRST_MOTION, Topic.PAUSE, Topic.FIRST_MOTION]
    assert cell.arm.calls == ["resume"]


def test_a_stopped_motion_does_not_resume_if_the_operator_aborts(cell: RecordingCell) -> None:
    supervised(cell, Topic.PAUSE)
    cell.arm.interruptions = 1
    with pytest.raises(OperatorAborted):
        cell.workcell.go(turned(0.2))
    assert cell.arm.motions == []
    assert cell.arm.state is Lifecycle.HOLD
