"""An arm that requires confirmation before it starts asks in its driver's words, or else stays off."""

from dataclasses import dataclass
from pathlib import Path

import pytest
from plain_steps import plain_order
from recording_cell import RecordingArm, RecordingCell, RecordingOperator

from procedures.journal.journal import JOURNAL_FILE, Line, read_journal
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Topic
from procedures.workcell.errors import InstrumentInGuide
from ronna_hw.devices.errors import MotionInterrupted
from ronna_hw.devices.lifecycle import Lifecycle

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
    cell.opened._devices["robot.master"] = cell.arm
    cell.engine(plain_order())
    return cell


def motion_lines(folder: Path) -> list[Line]:
    return [line for line in read_journal(folder / JOURNAL_FILE) if line["entry"] in ("motion", "moved")]


@pytest.mark.hazard(20)
def test_an_arm_starts_after_the_operator_confirms_the_drivers_statement(tmp_path: Path) -> None:
    cell = cell_with(tmp_path, RecordingOperator())
    cell.workcell.start()
    assert [(one.topic, one.value) for one in cell.operator.asked] == [(Topic.UNVERIFIED, WORDS)]
    assert cell.arm.calls == ["confirmed", "activate"]


def test_a_confirmed_start_is_a_motion_in_the_journal_and_leads_the_arm_nowhere(tmp_path: Path) -> None:
    cell = cell_with(tmp_path, RecordingOperator())
    cell.workcell.start()
    lines = [(line["entry"], line["number"], line.get("what")) for line in motion_lines(tmp_path)]
    assert lines == [("motion", 1, "start"), ("moved", 1, None)]
    assert not cell.workcell.place.is_out


def test_a_start_that_fails_has_its_result_in_the_journal(tmp_path: Path) -> None:
    cell = cell_with(tmp_path, RecordingOperator())
    cell.arm.failing = MotionInterrupted("stopped")
    with pytest.raises(MotionInterrupted):
        cell.workcell.start()
    assert [line.get("error") for line in motion_lines(tmp_path)] == [None, MotionInterrupted.code]


@pytest.mark.hazard(44)
def test_the_arm_does_not_start_with_an_instrument_in_the_guide(tmp_path: Path) -> None:
    cell = cell_with(tmp_path, RecordingOperator())
    cell.workcell.instrument.goes_in("T1")
    with pytest.raises(InstrumentInGuide, match="start the arm"):
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
    cell.workcell.set_home()
    cell.workcell.identify_mounted()
    cell.workcell.start()
    cell.workcell.go_home()
    assert [one.topic for one in cell.operator.asked] == [Topic.UNVERIFIED, Topic.FIRST_MOTION]


def test_an_arm_that_requires_no_confirmation_starts_without_asking(tmp_path: Path) -> None:
    cell = cell_with(tmp_path, RecordingOperator(), words=None)
    cell.workcell.start()
    assert cell.operator.asked == []
    assert cell.arm.calls == ["activate"]
