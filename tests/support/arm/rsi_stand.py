"""Session of the real-time process with a controller around it, cycle by cycle, without any process."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from math import degrees, inf
from typing import Any

from drivers.kuka_rsi.realtime.session import RsiSession
from drivers.kuka_rsi.realtime.settings import LinkSettings
from drivers.kuka_rsi.realtime.telegram import Telegram
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.motion.limits import MotionLimits, working_limits
from ronna_hw.arm.motion.planning import plan_joint_move
from ronna_hw.arm.pose import radians6
from ronna_hw.arm_stream.records import Command, MotionResult, Move, OpenStream, Orders, Request, StopOrder
from ronna_hw.vectors import JointVector

MODEL = kr6_r900("kr6_r900_sixx")
LIMITS = working_limits(MODEL)
START_DEG = (0.0, -90.0, 90.0, 0.0, 60.0, 0.0)
START = radians6(*START_DEG)
FAR = radians6(40, -60, 60, 30, 80, 90)
AXES = tuple(f"AK.A{k}" for k in range(1, 7))
SETTINGS = LinkSettings(
    host="127.0.0.1",
    port=1,
    parent_pid=1,
    mailbox_fd=0,
    event_fd=0,
    variant="kr6_r900_sixx",
    cycle_ms=4,
    sentype="KROSHU",
    send_tags=("DEF_AIPos",),
    receive_tags=("Stop", *AXES),
    axis_tags=AXES,
    stop_tag="Stop",
    silence_limit_s=0.25,
    heartbeat_limit_s=1.0,
    settle_tolerance_deg=0.0002,
    real_time_priority=0,
)
RAMP_DOWN_SHARE = 1.3  # a stop within the jerk limit still gains speed until its acceleration is gone
NUMBERS = re.compile(rb'"(-?\d+\.\d{6})"')
WORKING_STEP_DEG = [degrees(v) * 0.004 for v in LIMITS.speed_rad_s]


class RsiStand:
    """Session and an arm that follows it exactly, cycle by cycle."""

    def __init__(self, limits: MotionLimits = LIMITS, **changes: Any) -> None:
        self.limits = limits
        self.session = RsiSession(replace(SETTINGS, **changes))
        self.now_ns = 1_000_000_000
        self.ipoc = 1000
        self.delay = 0
        self.beat = 1
        self.beats = True
        self.stop_word = 0
        self.commands = 0
        self.axes: JointVector = START_DEG
        self.follows = True
        self.clamp_deg = inf  # largest correction that the arm carries out
        self.sent: list[tuple[JointVector, int]] = []
        self.give(OpenStream(self.limits))

    def give(self, request: Request, stop_number: int | None = None) -> None:
        self.commands += 1
        seen = self.stop_word >> 3 if stop_number is None else stop_number
        self.pending: Command | None = Command(self.commands, request, seen)
        if not self.sent:
            self.session.execute_command(self.pending)

    def stop(self, kind: StopOrder) -> None:
        self.stop_word = ((self.stop_word >> 3) + 1) * 8 + kind

    def cycle(self, lost: int = 0) -> bool:
        """Exchange one telegram; True when it was answered."""
        self.now_ns += 4_000_000 * (1 + lost)
        self.beat += self.beats
        self.ipoc += 4 * (1 + lost)
        telegram = Telegram(self.axes, self.delay, str(self.ipoc).encode())
        head = self.session.answer(telegram, Orders(self.beat, self.stop_word, self.commands), self.now_ns)
        if head is None:
            return False
        A1, A2, A3, A4, A5, A6 = (float(v) for v in NUMBERS.findall(head))
        corrections = (A1, A2, A3, A4, A5, A6)
        self.sent.append((corrections, int(head[head.index(b"<Stop>") + 6 : head.index(b"</Stop>")])))
        self.session.finish_cycle(self.pending)
        if self.follows:
            least, most = -self.clamp_deg, self.clamp_deg
            a, b, c, d, e, f = (
                s + min(max(v, least), most) for s, v in zip(START_DEG, corrections, strict=True)
            )
            self.axes = (a, b, c, d, e, f)
        return True

    def cycles(self, count: int) -> None:
        for _ in range(count):
            self.cycle()

    def run(self, most: int = 3000) -> int:
        """Run cycles until the motion has a result."""
        for count in range(most):
            if self.session.result is not MotionResult.RUNNING:
                return count
            self.cycle()
        raise AssertionError("no result")

    @property
    def violation_kind(self) -> str:
        """Kind of the violation that stopped the arm; empty without one."""
        return "" if self.session.violation is None else self.session.violation.kind

    def smooth(self, share: float = 1.05) -> bool:
        """Assert that no step exceeds `share` of the working step, far below a controller's limit."""
        steps = (
            (abs(y - x), limit)
            for (a, _), (b, _) in pairwise(self.sent)
            for x, y, limit in zip(a, b, WORKING_STEP_DEG, strict=True)
        )
        return all(step <= limit * share for step, limit in steps)


def begun(cycles: int = 3, **changes: Any) -> RsiStand:
    stand = RsiStand(**changes)
    stand.cycles(cycles)
    return stand


def moving(cycles: int = 120, target: JointVector = FAR) -> RsiStand:
    stand = begun()
    stand.give(Move(plan_joint_move(MODEL, START, target, LIMITS)))
    stand.cycles(cycles)
    assert stand.session.moving
    return stand
