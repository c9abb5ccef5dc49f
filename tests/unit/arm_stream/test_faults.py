"""Every fault and every refusal of a real-time process becomes an error of its driver, in words."""

from __future__ import annotations

from dataclasses import replace

import pytest
from watched_stream import kuka_faults, ur_faults

from drivers.kuka_rsi.errors import STREAM_ERRORS as KUKA_ERRORS
from drivers.universal_robots.errors import STREAM_ERRORS as UR_ERRORS
from ronna_hw.arm.clearance.live_watch import ViolationKind
from ronna_hw.arm_stream.errors import ControllerNotFound, MakeRow, StreamErrors, StreamWords
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


ERROR_CODES = {
    "not_found": ("EKI-001", "URD-002"),
    "lost": ("EKI-002", "URD-014"),
    "no_answer": ("EKI-003", "URD-015"),
    "not_started": ("RSI-001", "URD-020"),
    "died": ("RSI-007", "URD-024"),
    "stalled": ("RSI-020", "URD-025"),
    "silent": ("RSI-003", "URD-021"),
    "heartbeat_late": ("RSI-006", "URD-023"),
    "tripped": ("RSI-005", "URD-026"),
    "path_failed": ("RSI-016", "URD-027"),
    "unusable": ("RSI-019", "URD-028"),
    "protective_stop": ("RSI-009", "URD-029"),
    "link_stopped": ("RSI-004", "URD-030"),
    "drives_off": ("EKI-009", "URD-031"),
    "stopped": ("RSI-010", "URD-032"),
    "not_finished": ("RSI-011", "URD-033"),
    "refused": ("RSI-012", "URD-034"),
}
NO_WORDS = StreamWords(clock="", message="", answers="", stop="")


def test_each_make_has_every_error_of_the_table_under_its_own_code() -> None:
    kuka, ur = KUKA_ERRORS.rows(), UR_ERRORS.rows()
    assert {name: (kuka[name].code, ur[name].code) for name in kuka | ur} == ERROR_CODES


def test_an_error_is_of_the_same_kind_and_says_something_in_each_make() -> None:
    for kuka, ur in zip(KUKA_ERRORS.rows().values(), UR_ERRORS.rows().values(), strict=True):
        assert kuka.kind is ur.kind
        assert kuka.meaning
        assert ur.meaning


def test_the_kind_is_caught_whatever_the_make() -> None:
    for errors in (KUKA_ERRORS, UR_ERRORS):
        with pytest.raises(ControllerNotFound):
            raise errors.not_found("nothing answers")


def test_a_make_without_a_code_for_an_error_is_refused() -> None:
    with pytest.raises(KeyError):
        StreamErrors(NO_WORDS, {})


def test_a_make_with_a_code_for_an_unknown_error_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ronna_hw.errors.ErrorCode.known", {})
    with pytest.raises(TypeError, match="gone"):
        StreamErrors(NO_WORDS, {name: MakeRow(name) for name in (*ERROR_CODES, "gone")})
