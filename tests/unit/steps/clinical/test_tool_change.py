"""The guide is mounted on the parked arm with its stream ended; the tool is then read and confirmed."""

from __future__ import annotations

import pytest
from clinical_case import HOME_RAD, ClinicalCell
from prepared_results import checked_plan, checked_set_up, coarse, localized_fiducials
from recording_cell import GUIDE, RecordingOperator

from procedures.engine.case import Stored
from procedures.journal.errors import StepRefused
from procedures.journal.journal import Entry, read_journal
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Topic
from procedures.steps.clinical.tool_change import STEP, MountedGuide
from procedures.strategies.strategy import ONE_SIDE, approach_joints
from procedures.workcell import MountedTool
from procedures.workcell.errors import WrongTool
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.vectors import JointVector

WAY_HOME = [approach_joints(HOME_RAD, ONE_SIDE), HOME_RAD]  # every joint arrives from the same side


def went(cell: ClinicalCell) -> list[JointVector]:
    return [to for _, to in cell.arm.motions]


def exchange(cell: ClinicalCell) -> Stored[MountedGuide]:
    """The step, with the arm away from home, its stream and the cameras running."""
    cell.carrying(MountedTool.STEREO_HEAD).workcell.start(cameras=True)
    A1, *others = HOME_RAD
    cell.arm.joints_rad = (A1 + 0.2, *others)
    return cell.run(checked_set_up(cell), *coarse(), localized_fiducials(), checked_plan(), STEP)


def test_the_tool_is_changed_on_the_parked_arm_and_exchange_and_tip_calibration_are_confirmed(
    cell: ClinicalCell,
) -> None:
    done = exchange(cell).result
    assert cell.room.changed == [(GUIDE, Lifecycle.CONFIGURED, HOME_RAD)]
    assert cell.stereo.state is Lifecycle.CONFIGURED
    assert went(cell) == WAY_HOME
    tip = cell.calibrations.tool_tip
    assert (done.tool_number, done.calibration) == (GUIDE, tip.identifier)
    _parked, exchanged, calibrated = cell.operator.asked
    assert exchanged.value == f"the surgical guide, tool {GUIDE}"
    assert calibrated.value.startswith(f"{tip.identifier}, made ")
    assert cell.entries("confirmation") == [("confirmation", "")] * 3
    assert cell.workcell.master.tool is MountedTool.GUIDE


@pytest.mark.hazard(37)
@pytest.mark.parametrize("mounted", [0, 1, 3])
@pytest.mark.branch("WRONG_TOOL")
def test_a_tool_other_than_the_guide_is_refused(cell: ClinicalCell, mounted: int) -> None:
    cell.room.mounts = mounted

    with pytest.raises(WrongTool, match=f"PRO-009.*guide, number {GUIDE}, got number {mounted}"):
        exchange(cell)
    assert len(cell.room.changed) == 3  # attempts
    assert cell.workcell.master.tool is MountedTool.UNKNOWN
    assert cell.case.find(MountedGuide, None) is None


@pytest.mark.hazard(36)
def test_an_unconfirmed_exchange_does_not_count_as_a_mounted_guide(cell: ClinicalCell) -> None:
    cell.operator = RecordingOperator(Topic.TOOL_CHANGE)
    with pytest.raises(NotConfirmed, match="Has the tool been exchanged"):
        exchange(cell)
    assert cell.workcell.master.tool is not MountedTool.GUIDE
    assert went(cell) == WAY_HOME  # before


def test_a_completed_exchange_cannot_be_repeated(cell: ClinicalCell) -> None:
    exchange(cell)
    again = cell.begin(checked_set_up(cell), *coarse(), localized_fiducials(), checked_plan(), STEP)
    with pytest.raises(StepRefused, match="the arm carries the guide, not the stereo head"):
        again.run_step(again.order.find(STEP.name))


@pytest.mark.hazard(37)
@pytest.mark.branch("WRONG_TOOL")
def test_a_wrong_tool_is_exchanged_and_read_again_without_a_motion(cell: ClinicalCell) -> None:
    hang = cell.room.change_tool

    def hang_it_right_the_second_time(number: int, description: str) -> None:
        cell.room.mounts = 0 if not cell.room.changed else None
        hang(number, description)

    cell.room.change_tool = hang_it_right_the_second_time  # type: ignore[method-assign]
    assert exchange(cell).result.tool_number == GUIDE
    _parked, _exchanged, again, _tip = cell.operator.asked
    assert again.topic is Topic.TOOL_CHANGE
    assert "got number" not in again.value, "what was read before is told before, not of the right tool"
    found = [line for line in read_journal(cell.journal.path) if line["entry"] == Entry.FINDING]
    assert "got number 0" in str(found[0]["text"])
    assert went(cell) == WAY_HOME  # before


def test_a_failed_exchange_is_repeated_without_moving_the_arm(cell: ClinicalCell) -> None:
    cell.room.mounts = 0
    cell.carrying(MountedTool.STEREO_HEAD).workcell.start(cameras=True)
    engine = cell.begin(checked_set_up(cell), *coarse(), localized_fiducials(), checked_plan(), STEP)
    with pytest.raises(WrongTool):
        engine.run_to()
    moved = len(cell.arm.motions)
    cell.room.mounts = None
    engine.run_to()
    assert cell.workcell.master.tool is MountedTool.GUIDE
    assert len(cell.arm.motions) == moved


def test_an_unconfirmed_exchange_resumes_with_the_guide_already_mounted(cell: ClinicalCell) -> None:
    cell.operator = RecordingOperator(Topic.TOOL_CHANGE)
    cell.carrying(MountedTool.STEREO_HEAD).workcell.start(cameras=True)
    engine = cell.begin(checked_set_up(cell), *coarse(), localized_fiducials(), checked_plan(), STEP)
    with pytest.raises(NotConfirmed):
        engine.run_to()
    cell.operator.refusing = ()
    cell.operator.asked.clear()
    engine.run_to()
    assert cell.workcell.master.tool is MountedTool.GUIDE
    assert len(cell.room.changed) == 1  # it is not to be mounted twice
    (still,) = (one for one in cell.operator.asked if one.topic is Topic.TOOL_CHANGE)
    assert still.subject == "Is the tool still mounted? Leave it on."


def test_after_an_arm_fault_the_tool_is_read_again_before_the_next_step(cell: ClinicalCell) -> None:
    cell.carrying(MountedTool.STEREO_HEAD).workcell.start()
    engine = cell.begin(checked_set_up(cell), *coarse(), localized_fiducials(), checked_plan(), STEP)
    engine.run_to(engine.order.sequence[3])
    cell.arm.state = Lifecycle.FAULT
    engine.faults.acknowledge("A. Nurse")
    engine.run_to()
    assert cell.workcell.master.tool is MountedTool.GUIDE
