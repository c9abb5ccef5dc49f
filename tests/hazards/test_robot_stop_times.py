"""Hazard 4: how soon the moving arm rests and the operator is informed, in cycles of a world in lock-step.

Somebody on the wire holds the next telegram back until EKI has been heard. The world stands still meanwhile,
so that nothing here depends on the pace of the machine.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
import pytest
from rsi_tap import RsiTap
from waiting import eventually

from ronna_hw.arm.kr6_r900 import SIXX, kr6_r900
from ronna_hw.arm.monitor import SPEED_MARGIN
from ronna_hw.arm.motion.limits import WORKING_SPEED_FRACTION
from ronna_hw.arm_stream.records import Choice
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.robot import JointMove
from ronna_hw.errors import RonnaError

CYCLE_S = 0.004
FULL_STEP_DEG = np.degrees(kr6_r900(SIXX).full_speed_rad_s) * CYCLE_S
AWAY_RAD = 1.5
AT_SPEED = 0.99 * WORKING_SPEED_FRACTION  # of a full-speed step
LONGEST_STOP_CYCLES = 125  # half a second: what the table of disturbances promises for a path stop
STANDS_CYCLES = 25  # for which it is then watched
HANG_S = 60.0
STILL_RAD = 1e-6


class Case(NamedTuple):
    """A fault line, and what the operator reads; `asks`: the fault waits for a question."""

    fault: str
    code: str
    words: str
    asks: bool = False


CASES = (
    Case("robot emergency stop for 1 s", "EKI-010", "emergency stop is active"),
    Case("robot guard open for 1 s", "EKI-010", "guard is open"),
    Case("robot eki cut", "EKI-002", "closed the connection"),
    Case("robot eki half telegram", "EKI-004", "is truncated"),
    Case("robot mode T1 for 1 s", "EKI-010", "operating mode is T1"),
    Case("robot drives off", "EKI-010", "drives are off"),
    Case("robot collision", "EKI-010", "message 117"),
    Case("robot eki overflow", "EKI-002", "closed the connection", asks=True),
)
QUICK = ("robot emergency stop for 1 s", "robot guard open for 1 s", "robot eki cut")


class Witness:
    """Begins a fault at full working speed, and holds the telegram after it until the driver has heard."""

    def __init__(self, cell: Any, tap: RsiTap, arm: Any, case: Case) -> None:
        self._world, self._tap, self._arm, self._case = cell.world, tap, arm, case
        self._stops = arm.connections.link.stop_number
        self.begun_at = -1  # the cycle at whose end the fault begins
        self.heard = False
        tap.on_cycle = self._on_cycle

    def _on_cycle(self) -> None:
        cycle = len(self._tap.seen) - 1
        if self.begun_at < 0:
            if cycle > 0 and self._largest_step() > AT_SPEED:
                begin_s = self._world.clock.now_s() - CYCLE_S / 4
                self._world.set_fault_script(f"at {begin_s:.6f} s: {self._case.fault}")
                self.begun_at = cycle
        elif not self.heard:
            if self._case.asks:
                with suppress(RonnaError):
                    self._arm.read_tool_identity(HANG_S)
            eventually(lambda: self._arm.connections.link.stop_number > self._stops)
            self.heard = True

    def _largest_step(self) -> float:
        steps = np.subtract(self._tap.acting_deg[-1], self._tap.acting_deg[-2])
        return float((np.abs(steps) / FULL_STEP_DEG).max())


@pytest.mark.hazard(4)
@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, id=case.fault, marks=() if case.fault in QUICK else pytest.mark.slow)
        for case in CASES
    ],
)
def test_the_first_telegram_after_the_report_is_answered_by_a_stop_and_the_arm_rests_in_time(
    tapped_cell: Any, case: Case
) -> None:
    cell, tap = tapped_cell(late=False)
    arm = cell.active_arm(silence_limit_s=HANG_S, heartbeat_limit_s=HANG_S)
    start = arm.read_state().joints_rad
    witness = Witness(cell, tap, arm, case)
    with pytest.raises(RonnaError) as caught:
        arm.move(JointMove((start[0] + AWAY_RAD, *start[1:])))
    assert witness.heard
    assert caught.value.code == case.code
    assert case.words in str(caught.value)
    assert "flight-record-robot.master.txt" in caught.value.attachments
    assert arm.state is Lifecycle.FAULT
    # Cycles of the driver count from 1. The reply of the one in which it happened was out already.
    first_stop = next(cycle for cycle in arm.recorded_cycles if cycle.choice is Choice.STOP)
    assert first_stop.cycle - 1 == witness.begun_at + 1
    rest_at = witness.begun_at + LONGEST_STOP_CYCLES
    eventually(lambda: len(tap.seen) > rest_at + STANDS_CYCLES)
    truly, sent = np.array(tap.seen), np.array(tap.acting_deg)
    assert len(np.unique(sent[rest_at:], axis=0)) == 1
    assert np.abs(truly[rest_at:] - truly[-1]).max() < STILL_RAD
    assert truly[-1][0] < start[0] + AWAY_RAD - 0.1
    assert (np.abs(np.diff(sent, axis=0)) / FULL_STEP_DEG).max() <= WORKING_SPEED_FRACTION * SPEED_MARGIN
