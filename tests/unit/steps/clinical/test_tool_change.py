"""Parked, with its stream ended, the arm is given the guide; what hangs there is read and confirmed."""

import pytest
from clinical_case import (
    HOME_RAD,
    ClinicalCell,
    checked_plan,
    checked_set_up,
    correspondence,
    localized_fiducials,
)
from recording_cell import GUIDE, RecordingOperator

from procedures.engine.case import Stored
from procedures.engine.errors import NotConfirmed, StepRefused
from procedures.engine.operator import Topic
from procedures.steps.clinical.tool_change import STEP, MountedGuide
from procedures.workcell import MountedTool
from procedures.workcell.errors import WrongTool
from ronna_hw.devices.lifecycle import Lifecycle


def exchange(cell: ClinicalCell) -> Stored[MountedGuide]:
    """The step, with the arm away from home, its stream and the cameras running."""
    cell.carrying(MountedTool.STEREO_HEAD).workcell.start(cameras=True)
    A1, *others = HOME_RAD
    cell.arm.joints_rad = (A1 + 0.2, *others)
    return cell.run(checked_set_up(cell), correspondence(), localized_fiducials(), checked_plan(), STEP)


def test_the_arm_is_parked_and_its_stream_ended_while_the_tool_is_changed(cell: ClinicalCell) -> None:
    exchange(cell)
    assert cell.room.changed == [(GUIDE, Lifecycle.CONFIGURED, HOME_RAD)]
    assert cell.stereo.state is Lifecycle.CONFIGURED
    assert [to for _, to in cell.arm.motions] == [HOME_RAD]


def test_exchange_and_tip_calibration_are_both_confirmed(cell: ClinicalCell) -> None:
    done = exchange(cell).result
    tip = cell.calibrations.tool_tip
    assert (done.tool_number, done.calibration) == (GUIDE, tip.identifier)
    _parked, exchanged, calibrated = cell.operator.asked
    assert exchanged.value == f"the surgical guide, tool {GUIDE}"
    assert calibrated.value.startswith(f"{tip.identifier}, made ")
    assert cell.entries("confirmation") == [("confirmation", "")] * 3
    assert cell.workcell.tool is MountedTool.GUIDE


@pytest.mark.hazard(37)
@pytest.mark.parametrize("mounted", [0, 1, 3])
def test_another_tool_than_the_guide_is_refused(cell: ClinicalCell, mounted: int) -> None:
    cell.room.mounts = mounted
    with pytest.raises(WrongTool, match=f"PRO-009.*expected {GUIDE}, got {mounted}"):
        exchange(cell)
    assert cell.workcell.tool is MountedTool.UNKNOWN
    assert cell.case.find(MountedGuide, None) is None


@pytest.mark.hazard(36)
def test_without_a_yes_the_guide_does_not_count_as_mounted(cell: ClinicalCell) -> None:
    cell.operator = RecordingOperator(Topic.TOOL_CHANGE)
    with pytest.raises(NotConfirmed, match="the tool has been exchanged"):
        exchange(cell)
    assert cell.workcell.tool is not MountedTool.GUIDE
    assert len(cell.arm.motions) == 1  # the way home, before


def test_what_has_been_exchanged_is_not_exchanged_again(cell: ClinicalCell) -> None:
    exchange(cell)
    again = cell.begin(checked_set_up(cell), correspondence(), localized_fiducials(), checked_plan(), STEP)
    with pytest.raises(StepRefused, match="the arm carries the guide, not the stereo head"):
        again.run_step(again.order.find(STEP.name))
