"""Computation of the set-point that answers each data package, without I/O.

The script reports the sequence number of the set-point that it used. If it has not advanced with the cycles,
a set-point came late and the arm was held: the path waits. If that lasts for longer than the script itself
puts up with, and the script does not say so, another program runs in its place. What the controller reports
of safety, power and program is compared in every cycle; a stop of its own ends the stream, and nothing is
sent any more.
"""

from __future__ import annotations

from math import isfinite, radians
from typing import NamedTuple

from drivers.universal_robots.realtime.packages import (
    ACTUAL,
    CURRENTS,
    ECHO,
    EXPECTED_CURRENTS,
    FORCE,
    ROBOT_MODE,
    RUN,
    RUNTIME_STATE,
    SAFETY_MODE,
    SCRIPT_STATE,
    SPEED_FRACTION,
    SPEED_SCALING,
    STATUS,
    STATUS_BYTES,
    STATUS_OFFSET,
    TARGET,
    TIMESTAMP,
    TIMESTAMP_BYTES,
    TIMESTAMP_OFFSET,
    Cause,
    ControllerWord,
    Output,
    encode_input,
)
from drivers.universal_robots.realtime.settings import LinkSettings
from ronna_hw.arm.clearance.live_watch import Violation
from ronna_hw.arm_stream.load_sums import Signals
from ronna_hw.arm_stream.losses import LossCount
from ronna_hw.arm_stream.records import NO_STATE, LinkFault, OpenStream, StreamPhase
from ronna_hw.arm_stream.session import STREAMING_PHASES, PreparedReply, StreamSession
from ronna_hw.arm_stream.set_points import SetPoints
from ronna_hw.vectors import JointVector, Vector3, joint_vector
from ronna_hw.wire.universal_robots import RobotMode, RuntimeState, SafetyMode, ScriptOrder, ScriptState

AGREE_RAD = radians(0.1)  # between target and measured joints at the start: the arm must be at rest
RANGE_TOLERANCE_RAD = radians(0.01)  # an arm may be at the end of a joint's range
SPEED_STEPS = 100  # the speed of the path follows the slider in steps of a hundredth
RESTART_S = 10.0  # a jump of the time stamp beyond this is a restarted controller, not a gap
LATEST_TIMESTAMP_S = 1e9  # thirty years
LARGEST_SEQUENCE = 2**31 - 1
HALF_CYCLE = 0.5
REPORT_CYCLES = 5  # from a word of the script to its package, with room (U)


class NextPackage(NamedTuple):
    """Content of the next package to which the prepared reply belongs."""

    status: bytes
    earliest_s: float  # time stamp
    latest_s: float


class RtdeSession(StreamSession[Output, NextPackage]):
    """Protocol state machine: `answer` and `finish_cycle` per package, `monitor_silence` without one."""

    def __init__(self, settings: LinkSettings) -> None:
        super().__init__(settings, settings.kinematics(), settings.cycle_s)
        self.has_line = False
        self._recipe = 0
        self._run = 0
        self._cause = Cause.NONE
        self._values: Output = ()
        self._status: tuple[float, ...] = ()  # last seen
        self._timestamp_s: float | None = None
        self._before_s: float | None = None  # time stamp of the package before
        self._sequence = 0  # of the last set-point sent
        self._echo = 0  # of the last set-point that the script used
        self._unused_cycles = 0  # since then
        self._most_unused_cycles = settings.starved_cycles + REPORT_CYCLES
        self._doubt: Violation | None = None  # seen while the script, if it still runs, used no set-point
        self._safety_mode: int = SafetyMode.NORMAL  # of the stream's limits
        self._start_rad: JointVector | None = None

    def adopt(self, recipe: int, run: int, safety_mode: int = SafetyMode.NORMAL) -> None:
        """Take over a connection: our input recipe, and the number by which the script proves to be ours.

        `safety_mode` is the one that the limits are for.
        """
        self._recipe, self._run, self.has_line = recipe, run, True
        self._safety_mode = safety_mode

    def match(self, data: bytes, stop_word: int) -> PreparedReply[NextPackage] | None:
        """Return the prepared reply unless the package has something new, or a stop is ordered.

        The package is one of our recipe, of exactly its size.
        """
        if (ready := self.ready) is None or stop_word != ready.stop_word:
            return None
        status, earliest_s, latest_s = ready.expected
        if not data.startswith(status, STATUS_OFFSET):
            return None
        timestamp_s: float = TIMESTAMP_BYTES.unpack_from(data, TIMESTAMP_OFFSET)[0]
        return ready if earliest_s < timestamp_s < latest_s else None

    def break_off(self) -> None:
        """End the stream because its connection is broken."""
        self.ready = None
        if self.phase is StreamPhase.ARMED or self.phase in STREAMING_PHASES:
            self._latch(LinkFault.BROKEN)
        if self._points is not None:
            self._rest(self._points)

    def _accept(self, values: Output) -> bool:
        timestamp_s = values[TIMESTAMP]
        if not 0.0 <= timestamp_s < LATEST_TIMESTAMP_S:  # NaN fails here
            self.rejected += 1
            return False
        self._values = values
        self._before_s, self._timestamp_s = self._timestamp_s, timestamp_s
        self.device_clock = round(timestamp_s * 1e6)
        if (status := values[STATUS]) != self._status:
            self._status = status
            scaling, fraction = values[SPEED_SCALING], values[SPEED_FRACTION]
            share = scaling * fraction if 0.0 <= scaling <= 1.0 and 0.0 <= fraction <= 1.0 else 0.0
            self._controller_speed = int(share * SPEED_STEPS + HALF_CYCLE) / SPEED_STEPS
            self._write_word()
        if self._points is None or self.phase not in STREAMING_PHASES:
            self._measure()
        return True

    def _accept_expected(self, values: Output) -> None:
        self._values = values
        self._timestamp_s = timestamp_s = values[TIMESTAMP]
        self.device_clock = round(timestamp_s * 1e6)
        self._sequence = _following(self._sequence)
        self._count(1, values)

    def _judge_link(self, values: Output, points: SetPoints) -> bool:
        before_s, timestamp_s = self._before_s, self._timestamp_s
        if before_s is None or timestamp_s is None:
            return False
        cycles = round((timestamp_s - before_s) / self._cycle_s)
        if not 0 < cycles * self._cycle_s < RESTART_S:
            self._latch(LinkFault.RESTARTED)
            self._stop_replying(points)
            return False
        self._count(cycles, values)
        if self._is_stopped(values):
            self._stop_replying(points)
            self._measure()
            return False
        if self._doubt is not None and not (self._unused_cycles and self._controller_speed):
            self._trip(self._doubt)
            self._doubt = None
        return True

    def _write_word(self) -> None:
        places = (ROBOT_MODE, SAFETY_MODE, RUNTIME_STATE, SCRIPT_STATE)
        robot, safety, runtime, script = (round(self._values[place]) for place in places)
        self.controller_word = ControllerWord(robot, safety, runtime, script, self._cause).number

    def _count(self, cycles: int, values: Output) -> None:
        """Count the cycles since the last package, and those in which no new set-point was used."""
        echo = round(values[ECHO])
        used = max(echo - self._echo, 0)
        self._echo, self._missing = echo, cycles - 1
        standing = not self._controller_speed  # at a slider of zero a script may stand still (U)
        if used:
            self._unused_cycles = 0
        elif not standing:
            self._unused_cycles += cycles
        self._losses.note(cycles - 1, max(cycles - used, 0), standing=standing)

    def _is_stopped(self, values: Output) -> bool:
        """Return whether the controller has ended the stream, and latch that unless we asked for it."""
        if (cause := self._find_cause(values)) is Cause.NONE:
            return False
        if self.phase is StreamPhase.ENDING:
            if self.is_parent_gone:
                self.phase = StreamPhase.IDLE
            return cause is not Cause.SCRIPT
        self._cause = cause
        self._write_word()
        self._latch(LinkFault.CONTROLLER)
        return True

    def _find_cause(self, values: Output) -> Cause:
        if values[SAFETY_MODE] != self._safety_mode:
            return Cause.SAFETY
        if values[ROBOT_MODE] != RobotMode.RUNNING:
            return Cause.ROBOT_MODE
        if values[RUN] != self._run:
            return Cause.OTHER_SCRIPT
        if values[SCRIPT_STATE] != ScriptState.STREAMING:
            return Cause.SCRIPT
        if values[RUNTIME_STATE] != RuntimeState.PLAYING:
            return Cause.PROGRAM
        if self._unused_cycles > self._most_unused_cycles:
            return Cause.OTHER_SCRIPT
        return Cause.NONE

    def _judge_measured(self, violation: Violation) -> None:
        """Stop the arm; before saying that it does not follow our script, await whether that still runs."""
        if self._unused_cycles and self._controller_speed and self.fault is LinkFault.NONE:
            self._doubt = self._doubt or violation
            self._stopping = self.moving
        else:
            self._trip(violation)

    def _answer_before_start(self, values: Output) -> bytes | None:
        """Hold the arm where it is until the script uses our set-points, and begin to stream then."""
        target = joint_vector(values[TARGET])
        if not all(map(isfinite, target)):
            self.rejected += 1
            return None
        state = round(values[SCRIPT_STATE]) if values[RUN] == self._run else ScriptState.NONE
        if state == ScriptState.NONE:  # not started yet; the registers are an earlier program's
            return encode_input(self._recipe, 0, ScriptOrder.STREAM, self._run, target)
        if self._start_rad is None:
            self._start_rad = target
        if state == ScriptState.STREAMING and self._limits is not None:
            self._echo = round(values[ECHO])
            points = self._begin(self._start_rad, self._limits)
            if self._is_stopped(values):
                self._stop_replying(points)
                return None
            if not self._is_plausible(self._start_rad):
                self._latch(LinkFault.BASE)
            return self._encode(points.last_rad)
        if state != ScriptState.WAITING:
            self._cause = Cause.SCRIPT
            self._write_word()
            self._latch(LinkFault.CONTROLLER)
            return None
        return self._encode(self._start_rad)

    def _is_plausible(self, start_rad: JointVector) -> bool:
        arm, slack = self._kinematics, RANGE_TOLERANCE_RAD
        return all(
            low - slack <= angle <= high + slack and abs(angle - measured) <= AGREE_RAD
            for low, angle, high, measured in zip(
                arm.lower_rad, start_rad, arm.upper_rad, self._measured, strict=True
            )
        )

    def _encode(self, joints_rad: JointVector) -> bytes:
        """Encode the next set-point; at rest and ending, also the order to leave the script."""
        self._sequence = _following(self._sequence)
        return encode_input(self._recipe, self._sequence, self._order(), self._run, joints_rad)

    def _order(self) -> ScriptOrder:
        return ScriptOrder.END if self.phase is StreamPhase.ENDING and not self.moving else ScriptOrder.STREAM

    def _open(self, opened: OpenStream) -> bool:
        self._losses = LossCount()
        self._cause, self._start_rad, self._timestamp_s = Cause.NONE, None, None
        self._sequence = self._echo = self._unused_cycles = 0
        self._doubt = None
        self._status, self.controller_word, self._measured = (), 0, NO_STATE.measured_rad
        return self.has_line

    def _measure(self) -> None:
        self._measured = joint_vector(self._values[ACTUAL])

    def _measured_force(self) -> Vector3:
        x, y, z = self._values[FORCE]
        return x, y, z

    def _measured_loads(self) -> Signals | None:
        values = self._values
        signals = values[CURRENTS] + values[EXPECTED_CURRENTS] + values[FORCE]
        return signals if isfinite(sum(signals)) else None

    def _expect(self) -> NextPackage | None:
        timestamp_s = self._timestamp_s
        if timestamp_s is None or self._doubt is not None or self._echo >= LARGEST_SEQUENCE:
            return None
        status = list(self._values[STATUS])
        status[ECHO - SPEED_SCALING] = self._echo + 1
        if not isfinite(status[0] + status[1]):  # speeds; what is no number is new each time
            return None
        return NextPackage(
            STATUS_BYTES.pack(*status),
            timestamp_s + HALF_CYCLE * self._cycle_s,
            timestamp_s + (1.0 + HALF_CYCLE) * self._cycle_s,
        )

    def _encode_next(self, joints_rad: JointVector) -> bytes:
        sequence = _following(self._sequence)
        return encode_input(self._recipe, sequence, self._order(), self._run, joints_rad)


def _following(sequence: int) -> int:
    """Return the next sequence number; 0 is none."""
    return sequence + 1 if sequence < LARGEST_SEQUENCE else 1
