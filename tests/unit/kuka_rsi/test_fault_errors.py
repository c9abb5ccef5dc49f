"""Every fault and every refusal of the real-time process becomes its error, in words."""

from __future__ import annotations

import pytest

from drivers.kuka_rsi.errors import (
    ControllerRestarted,
    DrivesOff,
    HeartbeatLate,
    LinkStopped,
    MotionTripped,
    PathFailed,
    PoseDisagrees,
    ProtectiveStop,
)
from drivers.kuka_rsi.fault_errors import fault_error, stream_faults
from drivers.kuka_rsi.options import KukaOptions
from ronna_hw.arm_stream.records import NO_STATE, Fault, LinkState, Result
from ronna_hw.errors import RonnaError
from ronna_hw.wire.kuka_eki import OperationMode


@pytest.mark.parametrize(
    ("fault", "error", "code"),
    [
        (Fault.HEARTBEAT, HeartbeatLate, "RSI-006"),
        (Fault.PATH, PathFailed, "RSI-016"),
        (Fault.BASE, PoseDisagrees, "RSI-015"),
        (Fault.LINK_STOP, LinkStopped, "RSI-004"),
        (Fault.DRIVES_OFF, DrivesOff, "EKI-009"),
        (Fault.MONITOR, MotionTripped, "RSI-005"),
        (Fault.PROTECTIVE, ProtectiveStop, "RSI-009"),
        (Fault.RESTARTED, ControllerRestarted, "RSI-008"),
    ],
)
def test_a_latched_fault_becomes_its_error(fault: Fault, error: type[RonnaError], code: str) -> None:
    made = fault_error("arm", _with(fault), KukaOptions(), OperationMode.EXT)
    assert isinstance(made, error)
    assert made.code == code


def _with(fault: Fault) -> LinkState:
    return NO_STATE._replace(fault=fault, violation_kind="speed", violation_axis=1)


def test_the_silence_error_names_the_message_that_the_controller_shows() -> None:
    silent = NO_STATE._replace(fault=Fault.SILENCE)
    assert "message 29002" in str(fault_error("arm", silent, KukaOptions(), OperationMode.EXT, 29002))
    assert "message" not in str(fault_error("arm", silent, KukaOptions(), OperationMode.EXT)).split(";")[0]


def test_every_fault_and_every_refusal_has_a_message() -> None:
    for fault in Fault:
        made = fault_error("arm", _with(fault), KukaOptions(), OperationMode.EXT)
        assert (made is None) == (fault is Fault.NONE)
    refusal_error = stream_faults("arm", KukaOptions()).refusal_error
    for result in Result:
        if result.name.startswith("REFUSED"):
            assert "arm" in str(refusal_error(NO_STATE._replace(result=result)))
    busy = refusal_error(NO_STATE._replace(result=Result.REFUSED_BUSY))
    assert (busy.code, "another motion is running" in str(busy)) == ("RSI-012", True)
