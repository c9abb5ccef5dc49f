"""An arm is not to be had as a device of another kind, past the workcell."""

from __future__ import annotations

import pytest
from recording_cell import RecordingCell

from ronna_hw.devices import Device
from ronna_hw.devices.errors import WrongKind


@pytest.mark.hazard(24)
def test_an_arm_declared_as_another_kind_of_device_is_refused(cell: RecordingCell) -> None:
    second = {"second": cell.theatre.robot["master"]}
    cell.opened.file = cell.theatre.model_copy(update={"device": second})
    with pytest.raises(WrongKind, match=r"DEV-008: device\.second is an arm.*Declare it as \[robot\.NAME\]"):
        cell.workcell.device("second", Device)
    with pytest.raises(WrongKind):
        _ = cell.workcell.devices
