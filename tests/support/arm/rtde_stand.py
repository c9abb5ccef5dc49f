"""Session of the RTDE process with a controller that runs our script, cycle by cycle, without I/O.

Packages are encoded and decoded here by the vendor's guide, not by the driver.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from itertools import pairwise
from typing import Any

from urscript import RunningScript

from drivers.universal_robots.controller.script import render_script
from drivers.universal_robots.options import UrOptions, script_settings
from drivers.universal_robots.realtime.packages import OUTPUT
from drivers.universal_robots.realtime.session import RtdeSession
from drivers.universal_robots.realtime.settings import LinkSettings
from ronna_hw.arm.motion.limits import MotionLimits, working_limits
from ronna_hw.arm.motion.planning import plan_joint_move
from ronna_hw.arm.universal_robots import universal_robot
from ronna_hw.arm_stream.records import (
    NO_LIMIT,
    Command,
    ForceLimit,
    MotionResult,
    Move,
    OpenStream,
    Orders,
    Request,
    StopOrder,
)
from ronna_hw.vectors import JointVector
from ronna_hw.wire.universal_robots import RuntimeState, ScriptState

MODEL = universal_robot("ur5e")
CYCLE_S = 0.002
LIMITS = replace(working_limits(MODEL), cycle_s=CYCLE_S)
START: JointVector = (0.0, -1.5, -1.5, -1.5, 1.5, -1.5)
FAR: JointVector = (0.5, -1.2, -1.7, -1.3, 1.3, -1.0)
RUN = 77
SETTINGS = LinkSettings(
    parent_pid=1,
    silence_limit_s=0.25,
    heartbeat_limit_s=1.0,
    settle_tolerance_deg=0.0008,
    real_time_priority=0,
    handover_fd=0,
    model="ur5e",
    cycle_s=CYCLE_S,
    starved_cycles=10,
)
OUT = struct.Struct(">HBB d 6d 6d d d i i I i i i 6d 6d 6d")
IN = struct.Struct(">HBB i i i 6d")
SCRIPT = render_script(script_settings(UrOptions()))
RUNS = (ScriptState.NONE, ScriptState.WAITING, ScriptState.STREAMING)  # states of a script that goes on


class RtdeStand:
    """Session, and an arm that follows the set-points used by the script exactly."""

    def __init__(self, limits: MotionLimits = LIMITS, **changes: Any) -> None:
        self.session = RtdeSession(replace(SETTINGS, **changes))
        self.limits = limits
        self.now_ns = 1_000_000_000
        self.timestamp_s = 100.0
        self.beat = 1
        self.beats = True
        self.stop_word = 0
        self.commands = 0
        self.scaling, self.fraction = 1.0, 1.0
        self.robot_mode, self.safety_mode, self.runtime_state = 7, 1, 1
        self.script: RunningScript | None = None
        self.script_state, self.script_run, self.used = 0, 0, 0
        self.inputs: tuple[Any, ...] = (0, 0, 0, *START)
        self.goal: JointVector = START
        self.follows = True
        self.force_N = (0.0, 0.0, 0.0)
        self.currents_A = self.expected_currents_A = (0.0,) * 6
        self.measured: JointVector = START
        self.goals: list[JointVector] = []  # set-points used, one a cycle
        self.is_replaced = False  # another program runs, in other registers than ours
        self.is_late = False  # the reply arrives only with the next one, which takes its place
        self.session.adopt(1, RUN)
        self.give(OpenStream(self.limits))

    def give(self, request: Request) -> None:
        self.commands += 1
        command = Command(self.commands, request, self.stop_word >> 3)
        self.pending: Command | None = command
        if not self.goals:
            self.session.execute_command(command)

    def move(self, target: JointVector = FAR, force: ForceLimit = NO_LIMIT) -> None:
        self.give(Move(plan_joint_move(MODEL, self.goal, target, self.limits), force))

    def stop(self, kind: StopOrder) -> None:
        self.stop_word = ((self.stop_word >> 3) + 1) * 8 + kind

    def start_script(self) -> None:
        self.script, self.runtime_state = RunningScript(SCRIPT, self.goal), RuntimeState.PLAYING

    def package(self) -> bytes:
        return OUT.pack(
            OUT.size, ord("U"), 1, self.timestamp_s, *self.goal, *self.measured, self.scaling, self.fraction,
            self.robot_mode, self.safety_mode, self.runtime_state, self.used, self.script_state,
            self.script_run, *self.force_N, 0.0, 0.0, 0.0, *self.currents_A, *self.expected_currents_A,
        )  # fmt: skip

    def cycle(self, lost: int = 0) -> bytes | None:
        """Run a control cycle and return the session's reply; `lost` packages before it never arrived."""
        for _ in range(lost + 1):
            if not self.is_replaced:
                self._run_script()
            self.timestamp_s += CYCLE_S
            self.now_ns += 2_000_000
        self.beat += self.beats
        orders = Orders(self.beat, self.stop_word, self.commands)
        session = self.session
        package = self.package()
        values = OUTPUT.unpack(package)
        ready = session.match(package, self.stop_word)
        if ready is not None:
            reply: bytes | None = ready.reply
            session.advance_after_reply(values, orders, self.now_ns)
        else:
            reply = session.answer(values, orders, self.now_ns)
        if reply is not None:
            session.finish_cycle(self.pending)
        elif self.pending is not None:
            session.execute_command(self.pending)
        self.pending = None
        if reply is not None and not self.is_late:
            self.inputs = IN.unpack(reply)[3:]
        return reply

    def cycles(self, count: int) -> None:
        for _ in range(count):
            self.cycle()

    def begin(self) -> RtdeStand:
        """Run until the script streams."""
        self.cycles(3)
        self.start_script()
        self.cycles(4)
        return self

    def run(self, most: int = 4000) -> int:
        """Run until the motion has a result."""
        for count in range(most):
            if self.session.result is not MotionResult.RUNNING and count:
                return count
            self.cycle()
        raise AssertionError("no result")

    @property
    def largest_step_rad(self) -> float:
        return max(abs(b - a) for p, q in pairwise(self.goals) for a, b in zip(p, q, strict=True))

    def _run_script(self) -> None:
        script = self.script
        if script is None or self.runtime_state != RuntimeState.PLAYING or self.script_state not in RUNS:
            return
        script.integers, script.doubles = list(self.inputs[:3]), list(self.inputs[3:])
        goes_on = script.cycle()
        self.used, self.script_state, self.script_run = (script.outputs[number] for number in (24, 25, 26))
        if not goes_on:
            return
        a, b, c, d, e, f = script.goal
        self.goal = (a, b, c, d, e, f)
        self.goals.append(self.goal)
        if self.follows:
            self.measured = self.goal


def streaming(**changes: Any) -> RtdeStand:
    return RtdeStand(**changes).begin()


def moving(cycles: int = 200, **changes: Any) -> RtdeStand:
    stand = streaming(**changes)
    stand.move()
    stand.cycles(cycles)
    assert stand.session.moving
    return stand
