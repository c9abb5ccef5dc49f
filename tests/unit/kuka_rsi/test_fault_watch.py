"""Causes of a stop that only EKI tells: which states forbid motion, and why axes no longer follow."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import pytest
from coded_errors import raises
from watched_stream import MOVING, Control, Watched, kuka_faults, watched_kuka

from drivers.kuka_rsi.eki.telegrams import ControllerState
from drivers.kuka_rsi.errors import CONTROLLER_STOPPED
from drivers.kuka_rsi.fault_watch import CAUSE_S
from ronna_hw.arm.clearance.live_watch import ViolationKind
from ronna_hw.arm_stream.records import NO_STATE, LinkFault, StopOrder, StreamPhase
from ronna_hw.wire.kuka_eki import OperationMode, RsiState

A_LITTLE_S = 1e-3
STREAMING_WELL = ControllerState(
    received_s=0.0,
    mode=OperationMode.EXT,
    drives=True,
    emergency_stop=False,
    guard_open=False,
    moving=True,
    error=0,
    rsi=RsiState.MOVECORR,
    tool=1,
    axes_deg=(0.0,) * 6,
)


@dataclass
class Eki(Control):
    """EKI session as the driver sees it."""

    answer: ControllerState | None = None
    asked: int = 0

    def request_state(self) -> int:
        self.asked += 1
        return self.asked

    def find_reply(self, number: int) -> ControllerState | None:
        assert number == self.asked
        return self.answer

    def await_reply(self, number: int, timeout_s: float) -> ControllerState | None:
        assert 0.0 < timeout_s <= CAUSE_S
        return self.find_reply(number)


def watched() -> tuple[Watched, Eki]:
    eki = Eki()
    return watched_kuka(eki), eki


@pytest.mark.hazard(4)
@pytest.mark.parametrize(
    "change",
    [
        {"emergency_stop": True},
        {"guard_open": True},
        {"mode": OperationMode.T1},
        {"drives": False},
        {"error": 1},
    ],
    ids=lambda change: next(iter(change)),
)
def test_a_state_that_forbids_motion_latches_a_fault_and_orders_the_stop_once(change: dict[str, Any]) -> None:
    arm, _ = watched()
    arm.watch.on_state(STREAMING_WELL)
    assert arm.outcome == ("", [])
    arm.watch.on_state(_changed(**change))
    assert arm.outcome == ("EKI-010", [StopOrder.PROTECTIVE])
    arm.watch.on_state(_changed(**change))
    assert arm.outcome == ("EKI-010", [StopOrder.PROTECTIVE])  # latched, and ordered once


def test_a_stop_names_a_foreign_sender_of_telegrams() -> None:
    arm, _ = watched()
    arm.link.state = replace(MOVING, foreign=101, foreign_host="192.168.1.7")
    arm.watch.on_state(_changed(error=29002))
    assert (
        "29002 is not acknowledged; note: 101 telegrams came from another sender, the last from 192.168.1.7"
        in str(arm.guard.fault)
    )


def _changed(**change: Any) -> ControllerState:
    return replace(STREAMING_WELL, **change)


NO_LONGER_FOLLOWS = replace(
    MOVING, phase=StreamPhase.FAULT, fault=LinkFault.MONITOR, violation_kind=ViolationKind.FOLLOWING_ERROR
)


@pytest.mark.hazard(38)
@pytest.mark.parametrize(
    ("change", "code"),
    [({}, "RSI-005"), ({"emergency_stop": True}, "EKI-010"), ({"drives": False}, "EKI-010")],
    ids=["none", "emergency stop", "drives off"],
)
def test_a_following_error_is_attributed_to_the_controllers_next_state(
    change: dict[str, Any], code: str
) -> None:
    arm, eki = watched()
    eki.latest = STREAMING_WELL  # sent before
    arm.link.state = NO_LONGER_FOLLOWS
    arm.watch.check()
    assert arm.outcome[0] == ""
    eki.answer = _changed(**change)
    arm.watch.on_state(eki.answer)
    assert arm.outcome[0] == code
    assert eki.asked == 1


@pytest.mark.hazard(38)
def test_a_call_waits_for_the_cause_of_a_following_error() -> None:
    arm, eki = watched()
    arm.link.state = NO_LONGER_FOLLOWS
    arm.watch.check()
    eki.answer = _changed(guard_open=True)
    with raises(CONTROLLER_STOPPED, match="guard is open"):
        arm.watch.raise_any()


@pytest.mark.hazard(38)
def test_the_wait_for_the_cause_of_a_following_error_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    (arm, _), now_s = watched(), [100.0]
    monkeypatch.setattr("drivers.kuka_rsi.fault_watch.time.monotonic", lambda: now_s[0])
    arm.link.state = NO_LONGER_FOLLOWS
    arm.watch.check()
    now_s[0] += CAUSE_S
    arm.watch.check()
    assert arm.outcome[0] == ""
    now_s[0] += A_LITTLE_S
    arm.watch.check()
    assert arm.outcome[0] == "RSI-005"


def test_the_silence_error_names_the_message_that_the_controller_shows() -> None:
    faults, silent = kuka_faults(), replace(NO_STATE, fault=LinkFault.SILENCE)
    told, untold = SimpleNamespace(error=29002), SimpleNamespace(error=0)
    assert "message 29002" in str(faults.error(silent, "EXT", reported=told))
    assert "the controller shows" not in str(faults.error(silent, "EXT", reported=untold))
    assert "the controller shows" not in str(faults.error(silent, "EXT"))
