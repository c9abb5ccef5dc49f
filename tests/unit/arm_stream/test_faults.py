"""Every fault and every refusal of a real-time process becomes an error of its driver, in words."""

from __future__ import annotations

from dataclasses import replace

import pytest
from watched_stream import kuka_faults, ur_faults

from ronna_hw.arm.clearance.live_watch import ViolationKind
from ronna_hw.arm_stream.faults import StreamFaults
from ronna_hw.arm_stream.records import NO_STATE, LinkFault, LinkState, MotionResult

KUKA, UR = kuka_faults(), ur_faults()
CODES = {
    LinkFault.MONITOR: ("RSI-005", "URD-026"),
    LinkFault.SILENCE: ("RSI-003", "URD-021"),
    LinkFault.HEARTBEAT: ("RSI-006", "URD-023"),
    LinkFault.PROTECTIVE: ("RSI-009", "URD-029"),
    LinkFault.LINK_STOP: ("RSI-004", "URD-030"),
    LinkFault.DRIVES_OFF: ("EKI-009", "URD-031"),
    LinkFault.PATH: ("RSI-016", "URD-027"),
    LinkFault.RESTARTED: ("RSI-008", "URD-038"),
    LinkFault.BASE: ("RSI-015", "URD-039"),
    LinkFault.LOSSES: ("RSI-019", "URD-028"),
    LinkFault.BROKEN: ("RSI-019", "URD-022"),  # no datagram breaks a connection
}


def _with(fault: LinkFault) -> LinkState:
    return replace(NO_STATE, fault=fault, violation_kind=ViolationKind.SPEED, violation_axis=1)


@pytest.mark.parametrize("fault", CODES)
def test_each_fault_has_the_code_of_its_driver(fault: LinkFault) -> None:
    errors = [faults.error(_with(fault), "automatic") for faults in (KUKA, UR)]
    assert tuple(error.code for error in errors if error is not None) == CODES[fault]


def test_a_silence_is_told_in_seconds() -> None:
    said = str(UR.error(replace(_with(LinkFault.SILENCE), cycles=17, device_clock=20926000), "automatic"))
    limit_s = UR.options.silence_limit_s
    assert f"after 17 cycles no package came for {limit_s:g} s; expected a package in every cycle." in said
    assert "20926000" not in said


@pytest.mark.parametrize("faults", [KUKA, UR], ids=["kuka", "ur"])
def test_every_fault_and_every_refusal_has_a_message(faults: StreamFaults) -> None:
    assert [fault for fault in LinkFault if faults.error(_with(fault), "automatic") is None] == [
        LinkFault.NONE
    ]
    for result in MotionResult:
        if result.name.startswith("REFUSED"):
            assert "robot.master" in str(faults.refusal_error(replace(NO_STATE, result=result)))


@pytest.mark.parametrize(
    ("faults", "busy", "stopped"), [(KUKA, "RSI-012", "RSI-010"), (UR, "URD-034", "URD-032")]
)
def test_a_motion_is_refused_or_stopped_in_the_code_of_its_driver(
    faults: StreamFaults, busy: str, stopped: str
) -> None:
    assert faults.refusal_error(replace(NO_STATE, result=MotionResult.REFUSED_BUSY)).code == busy
    assert faults.refusal_error(replace(NO_STATE, result=MotionResult.REFUSED_STOP)).code == stopped
