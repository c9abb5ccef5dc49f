"""A held case: a fault is acknowledged by name, the arm leaves the head, and steps continue."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest
from plain_steps import plain_order
from recording_cell import GUIDE, HOME, RecordingCell, RecordingOperator, tool_pose

from procedures.engine.context import StepContext
from procedures.engine.device_faults import DeviceFaults
from procedures.engine.engine import Engine
from procedures.journal.errors import StepRefused
from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.operator.errors import NotConfirmed, OperatorAborted
from procedures.operator.question import Topic
from procedures.steps.conditions import needs_arm_home
from procedures.workcell import InsertionAxis, MountedTool
from procedures.workcell.arm_history import ArmPlace, HeldDrill, HeldInstrument, PlaceKind
from procedures.workcell.arms import Halt
from ronna_hw.devices.capabilities import Fact
from ronna_hw.devices.errors import PersonNotNamed, WrongState
from ronna_hw.devices.lifecycle import LastKnown, Lifecycle
from ronna_hw.errors import LimitError, LinkTimeout
from ronna_hw.frames import Transform
from ronna_hw.roles import ASSISTANT, MASTER
from ronna_hw.wire.room_tasks import EMPTY, OUT, REST_DRILL


def with_the_guide_on_its_axis(cell: RecordingCell, *refusing: Topic) -> Engine:
    cell.operator = RecordingOperator(*refusing)
    cell.arm.state, cell.arm.mounted = Lifecycle.ACTIVE, GUIDE
    cell.workcell.master.mount.check(MountedTool.GUIDE)
    cell.workcell.master.set_home()
    engine = cell.engine(plain_order())
    here = tool_pose(HOME, cell)
    target = Transform.of(
        here.target,
        here.source,
        translation_mm=here.apply([0.0, 0.0, 110.0]),
        quaternion_wxyz=here.quaternion_wxyz,
    )
    cell.workcell.master.insert(InsertionAxis("T1", target, 110.0))
    cell.operator.asked.clear()
    return engine


@pytest.mark.hazard(32)
@pytest.mark.branch("ARM_FAULT")
def test_no_step_starts_while_a_device_is_in_fault_and_the_fault_is_named(cell: RecordingCell) -> None:
    engine = cell.engine(plain_order())
    cell.arm.state = Lifecycle.FAULT
    with pytest.raises(StepRefused, match="the arm is in fault"):
        engine.run_step(engine.order.find("image"))


HOMEWARD = ["joints", "joints"]  # a little before home, then onto it
EMERGENCY = LinkTimeout("the arm was stopped: emergency stop is active")
STOP = Fact("emergency stop", "pressed", ready=False, advice="Release it.")
MESSAGE = Fact("messages", "1 is not acknowledged", ready=False, advice="Remove its cause.")


def test_a_fault_is_reported_from_the_current_device_state_with_the_actions_in_order(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    def descriptions(*says: Fact) -> str:
        seen = LastKnown(Lifecycle.FAULT, EMERGENCY, None, says)
        monkeypatch.setattr(cell.arm, "observe", lambda: seen)
        return cell.engine(plain_order()).faults.descriptions["arm"]

    assert "emergency stop: pressed; messages: 1 is not acknowledged. Release it. Then ack" in descriptions(
        STOP, MESSAGE
    )
    released = Fact("emergency stop", "released", advice="Release it.")
    assert "emergency stop: released; messages: 1 is not acknowledged. To continue, ack" in descriptions(
        released, MESSAGE
    )


def test_homing_an_arm_in_fault_is_refused_with_the_reason(cell: RecordingCell) -> None:
    engine = cell.engine(plain_order())
    cell.workcell.master.set_home()
    cell.arm.state = Lifecycle.FAULT
    with pytest.raises(StepRefused, match="the arm cannot move: the arm is in fault"):
        engine.retreat_home()
    assert cell.entries("home", "motion") == []


@pytest.mark.parametrize("name", ["", " ", "123", "7 8"])
def test_a_name_without_letters_is_refused_and_recovers_nothing(cell: RecordingCell, name: str) -> None:
    engine = cell.engine(plain_order())
    cell.arm.state = Lifecycle.FAULT
    with pytest.raises(PersonNotNamed, match="DEV-006"):
        engine.faults.acknowledge(name)
    assert (cell.arm.calls, cell.entries()) == ([], [])


@pytest.mark.hazard(32)
def test_acknowledging_recovers_the_device_and_moves_nothing(cell: RecordingCell) -> None:
    engine = cell.engine(plain_order())
    cell.arm.state = Lifecycle.FAULT
    engine.faults.acknowledge("A. Nurse")
    assert cell.arm.calls == ["recovered by A. Nurse"]
    assert cell.arm.motions == []
    assert cell.entries() == [("acknowledged", "")]
    assert engine.why_refused(engine.order.find("image")) == ()


def test_a_message_left_from_an_earlier_session_is_acknowledged_too_and_named(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    def holds_none(*_: object) -> None:
        raise WrongState("recover is not allowed now")

    engine = cell.engine(plain_order())
    cell.arm.state = cell.stereo.state = Lifecycle.CONNECTED
    cell.stereo.recover = holds_none  # type: ignore[attr-defined]
    seen = LastKnown(Lifecycle.CONNECTED, None, None, (MESSAGE,))
    monkeypatch.setattr(cell.arm, "observe", lambda: seen)
    which = "a message from before this connection (1 is not acknowledged)"
    assert engine.faults.acknowledge("A. Nurse") == {"arm": which}
    assert cell.arm.calls == ["recovered by A. Nurse"]


def test_what_is_kept_of_a_fault_says_what_happened_and_no_longer_what_to_do(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = cell.engine(plain_order())
    fault = StepRefused("the arm was stopped", got="emergency stop", action="Release the emergency stop.")
    monkeypatch.setattr(cell.arm, "observe", lambda: LastKnown(Lifecycle.FAULT, fault, None))
    assert engine.faults.acknowledge("A. Nurse") == {"arm": "PRO-001: the arm was stopped: emergency stop"}
    (line,) = read_journal(cell.folder / JOURNAL_FILE)
    assert line["fault"] == "PRO-001: the arm was stopped: emergency stop"


@pytest.mark.hazard(37)
def test_the_tool_on_a_recovered_arm_counts_as_unchecked(cell: RecordingCell) -> None:
    cell.workcell.master.mount.check(MountedTool.STEREO_HEAD)
    engine = cell.engine(plain_order())
    cell.arm.state = Lifecycle.FAULT
    engine.faults.acknowledge("A. Nurse")
    assert cell.workcell.master.tool is MountedTool.UNKNOWN


@pytest.mark.hazard(24)
def test_homing_retracts_a_guide_from_its_entry_along_the_axis_before_parking(cell: RecordingCell) -> None:
    engine = with_the_guide_on_its_axis(cell)
    engine.retreat_home()
    assert [question.topic for question in cell.operator.asked] == [Topic.RETREAT, Topic.PARK]
    assert [kind for kind, _ in cell.arm.motions] == ["line", "line", *HOMEWARD]
    assert cell.arm.joints_rad == HOME
    assert not cell.workcell.master.place.is_on_axis
    assert engine.machine.state == "held"


def test_an_arm_at_home_is_asked_for_nothing_and_moves_nowhere(cell: RecordingCell) -> None:
    engine = with_the_guide_on_its_axis(cell)
    engine.retreat_home()
    asked, moved = len(cell.operator.asked), cell.entries("motion")
    engine.retreat_home()
    assert (len(cell.operator.asked), cell.entries("motion")) == (asked, moved)
    assert engine.machine.state == "held"


@pytest.mark.hazard(24)
def test_an_arm_jogged_while_the_instrument_is_taken_out_is_found_where_it_is(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = with_the_guide_on_its_axis(cell)
    remove = engine.questions.request_instrument_removal

    def jog_home() -> None:
        remove()
        cell.arm.joints_rad = HOME

    monkeypatch.setattr(engine.questions, "request_instrument_removal", jog_home)
    moved = cell.entries("motion")
    engine.retreat_home()
    assert cell.entries("motion") == moved
    assert cell.workcell.master.place.is_home


@pytest.mark.hazard(36)
def test_the_guide_stays_in_place_when_the_retreat_is_not_confirmed(cell: RecordingCell) -> None:
    engine = with_the_guide_on_its_axis(cell, Topic.RETREAT)
    with pytest.raises(NotConfirmed):
        engine.retreat_home()
    assert cell.workcell.master.place.is_on_axis
    assert [kind for kind, _ in cell.arm.motions] == ["line"]


def test_a_failed_retreat_can_be_repeated(cell: RecordingCell) -> None:
    engine = with_the_guide_on_its_axis(cell)
    cell.arm.failing = LinkTimeout("the controller is silent")
    with pytest.raises(LinkTimeout):
        engine.retreat_home()
    assert cell.workcell.master.place.is_on_axis
    cell.arm.failing = None
    engine.retreat_home()
    assert not cell.workcell.master.place.is_on_axis


@pytest.mark.branch("ABORTED")
def test_a_guide_is_still_retracted_along_its_axis_after_an_abort(cell: RecordingCell) -> None:
    engine = with_the_guide_on_its_axis(cell)
    engine.checkpoint.abort()
    with pytest.raises(OperatorAborted):
        engine.run_step(engine.order.find("image"))
    engine.checkpoint.pause()
    engine.retreat_home()
    assert [question.topic for question in cell.operator.asked] == [Topic.RETREAT, Topic.PAUSE, Topic.PARK]
    assert [kind for kind, _ in cell.arm.motions] == ["line", "line", *HOMEWARD]
    assert not cell.workcell.master.place.is_on_axis
    assert cell.entries("rested", "resumed") == [("rested", ""), ("resumed", "")]
    assert engine.machine.state == "aborted"


@pytest.mark.branch("ABORTED")
def test_an_abort_at_a_pause_on_the_way_home_ends_the_case_with_the_arm_at_rest(cell: RecordingCell) -> None:
    engine = with_the_guide_on_its_axis(cell, Topic.PAUSE)
    stops, motions = cell.arm.stops, len(cell.arm.motions)
    engine.checkpoint.pause()
    with pytest.raises(OperatorAborted):
        engine.retreat_home()
    assert engine.machine.state == "aborted"
    assert cell.entries("interrupted") == [("interrupted", "")]
    assert (cell.arm.stops, len(cell.arm.motions)) == (stops + 1, motions)
    engine.checkpoint.pause()
    with pytest.raises(OperatorAborted):  # what has ended ends once
        engine.retreat_home()
    assert cell.entries("interrupted") == [("interrupted", "")]
    cell.operator.refusing = ()
    engine.retreat_home()
    assert (cell.arm.joints_rad, engine.machine.state) == (HOME, "aborted")


@pytest.mark.hazard(44)
@pytest.mark.branch("INSTRUMENT_INSIDE")
def test_homing_has_the_instrument_taken_out_before_anything_moves(cell: RecordingCell) -> None:
    engine = with_the_guide_on_its_axis(cell)
    cell.workcell.master.instrument.record_insertion("T1")
    motions, asked_after = len(cell.arm.motions), []
    cell.operator.meanwhile = lambda _question: asked_after.append(len(cell.arm.motions))
    engine.retreat_home()
    assert asked_after[0] == motions
    assert [task.name for task in cell.room.worked] == ["out"]
    assert cell.operator.asked[0].topic is Topic.INSTRUMENT_OUT
    assert engine.instrument_in is None
    assert cell.arm.joints_rad == HOME


@pytest.mark.hazard(44)
@pytest.mark.branch("INSTRUMENT_INSIDE")
def test_the_arm_does_not_move_until_removal_of_the_instrument_is_confirmed(cell: RecordingCell) -> None:
    engine = with_the_guide_on_its_axis(cell, Topic.INSTRUMENT_OUT)
    cell.workcell.master.instrument.record_insertion("T1")
    with pytest.raises(NotConfirmed, match="still in T1: nothing moves"):
        engine.retreat_home()
    assert engine.instrument_in == "T1"
    assert [kind for kind, _ in cell.arm.motions] == ["line"]


class HoldingAssistant(SimpleNamespace):
    """Assistant with an instrument in its holder."""

    def __init__(self, drill: HeldDrill | None = None) -> None:
        super().__init__(history=SimpleNamespace(held=HeldInstrument("T1", 170.0, (), drill)), emptied=0)

    def record_drill(self, *, may_turn: bool) -> None:
        held = self.history.held
        self.history.held = replace(held, drill=held.drill.model_copy(update={"may_turn": may_turn}))

    def release_instrument(self) -> None:
        self.history.held, self.emptied = None, self.emptied + 1


@pytest.mark.hazard(63)
def test_a_holder_that_may_hold_an_instrument_is_emptied_although_none_is_in_the_guide(
    cell: RecordingCell,
) -> None:
    cell.operator = RecordingOperator(Topic.INSTRUMENT_OUT)
    engine, assistant = cell.engine(plain_order()), HoldingAssistant()
    cell.add_assistant(assistant)
    with pytest.raises(NotConfirmed, match="still in the assistant's holder"):
        engine.questions.request_instrument_removal()
    assert not assistant.emptied
    cell.operator.refusing = ()
    engine.questions.request_instrument_removal()
    assert assistant.emptied == 1
    assert [task.name for task in cell.room.worked] == [EMPTY, EMPTY]
    engine.questions.request_instrument_removal()
    assert len(cell.operator.asked) == 2


@pytest.mark.hazard(65)
def test_a_drill_that_may_be_turning_is_switched_off_before_anything_else_on_the_way_out(
    cell: RecordingCell,
) -> None:
    engine = with_the_guide_on_its_axis(cell)
    assistant = HoldingAssistant(HeldDrill(entry_mm=100.0, may_turn=True))
    cell.workcell.master.instrument.record_insertion("T1")
    cell.add_assistant(assistant)
    assert "MAY BE TURNING" in (engine.setting.workcell.instrument_description or "")
    engine.questions.request_instrument_removal()
    assert [task.name for task in cell.room.worked] == [REST_DRILL, OUT]
    assert "remove the drill" in cell.room.worked[-1].subject
    assert cell.operator.asked[-1].subject.startswith("Is the drill out of T1")


@pytest.mark.hazard(63)
def test_what_is_taken_out_of_the_guide_is_taken_out_of_the_holder_too(cell: RecordingCell) -> None:
    engine, assistant = cell.engine(plain_order()), HoldingAssistant()
    cell.workcell.master.instrument.record_insertion("T1")
    cell.add_assistant(assistant)
    engine.questions.request_instrument_removal()
    assert cell.operator.asked[-1].subject.endswith("out of the guide, and out of the assistant's holder?")
    assert assistant.emptied == 1
    assert cell.workcell.master.instrument.inside is None


def test_staff_go_to_clamp_and_cart_with_every_arm_at_home(cell: RecordingCell) -> None:
    context = cast("StepContext", SimpleNamespace(workcell=cell.workcell))
    cell.workcell.master.set_home()
    assert needs_arm_home(context) == ()
    away = SimpleNamespace(spoken_name="assistant", place=ArmPlace(PlaceKind.AWAY))
    cell.add_assistant(away)
    assert needs_arm_home(context) == ("the assistant is not home: send it there first (home)",)


FROZEN = "the assistant has gone to fault: its telegrams stopped"


class Stopped(LimitError):
    """A stop, for these tests."""

    code = "TST-001"


def doubts_after(halt: Halt | None) -> list[str]:
    """Return what is said to have cast doubt on the bases after a fault of the arm."""
    lines: list[str] = []
    order = SimpleNamespace(localizations=(), checks_of_tool=(), relations_of_arms=("base_to_base",))
    case = SimpleNamespace(trusts=lambda _key: True, doubt=lambda _key, _fault: None)
    known = LastKnown[object](Lifecycle.FAULT, Stopped("a stop was requested"), None)
    master = SimpleNamespace(role=MASTER)
    devices = {"arm": SimpleNamespace(observe=lambda: known)}
    clock = SimpleNamespace(now_s=lambda: 12.0)
    cell = SimpleNamespace(
        devices=devices, halt=halt, master=master, clock=clock, arm_of_device=lambda _name: master
    )
    faults = DeviceFaults(
        cast("Any", SimpleNamespace(order=order, case=case)),
        cast("Any", cell),
        cast("Any", SimpleNamespace(write=lambda _entry, _at_s, **more: lines.append(more["fault"]))),
    )
    faults.doubt_results()
    return lines


@pytest.mark.parametrize(
    ("halt", "says"),
    [
        (Halt(ASSISTANT, FROZEN, None), f"a stop was requested, since {FROZEN} (theatre time 12 s)"),
        (Halt(MASTER, "the master has gone to fault", None), "a stop was requested (theatre time 12 s)"),
        (None, "a stop was requested (theatre time 12 s)"),
    ],
)
def test_a_doubt_names_the_arm_for_which_the_other_was_stopped(halt: Halt | None, says: str) -> None:
    assert doubts_after(halt) == [f"TST-001: {says}"]
