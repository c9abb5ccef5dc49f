"""The doctor says whether the record of the arm is of this very arm, or that it cannot know."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from recording_cell import RecordingArm, RecordingCell, theatre_of

from procedures.cli.doctor import inspection
from procedures.cli.doctor.inspection import OF_THIS_ARM
from procedures.engine.order import order_of
from procedures.steps.clinical import set_up
from procedures.workcell.errors import AnotherArm
from ronna_hw.config import TheatreFile
from ronna_hw.devices.lifecycle import Identity
from sim.world.process import load_scene


def theatre(serial: str | None) -> TheatreFile:
    """With a record of the arm with that serial number."""
    file = theatre_of(load_scene("mini", seed=3, calibrated=True))
    assert file.calibration is not None
    assert file.calibration.arm is not None
    arm = file.calibration.arm.model_copy(update={"serial": serial})
    return file.model_copy(update={"calibration": file.calibration.model_copy(update={"arm": arm})})


@pytest.mark.parametrize(
    ("recorded", "reported", "well", "advised"),
    [("A1", "A1", True, False), ("A1", "A2", False, True), ("A1", "", True, True), (None, "A1", True, True)],
)
def test_the_doctor_compares_serial_numbers_of_the_arm_or_says_that_there_are_none(
    monkeypatch: pytest.MonkeyPatch, recorded: str | None, reported: str, well: bool, advised: bool
) -> None:
    monkeypatch.setattr(inspection, "RobotArm", RecordingArm)
    monkeypatch.setattr(inspection, "require_interface", lambda *_: None)
    inspect = inspection.inspection("robot.master", theatre(recorded))
    arm: Any = RecordingArm("robot.master")
    found = {one.subject: one for one in inspect(arm, Identity("Lab", "A", reported, "1"))}
    of_arm = found["robot.master: calibration of the arm"]
    assert of_arm.well is well
    assert bool(of_arm.advice) is advised
    assert (of_arm.advice == OF_THIS_ARM) is (advised and well)
    assert ("CAL-013" in of_arm.seen) is not well


def test_a_case_is_refused_with_the_record_of_another_arm_of_the_model(tmp_path: Path) -> None:
    other = RecordingCell(tmp_path, theatre=theatre("2"))
    with pytest.raises(AnotherArm, match="CAL-013"):
        other.engine(order_of([set_up.STEP], ())).run_to()
