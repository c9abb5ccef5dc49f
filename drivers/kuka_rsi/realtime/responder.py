"""Computation of the reply to each telegram, without I/O.

Reply k carries a point prepared after reply k-1. When a telegram arrives, only orders, losses and known
faults are checked, to decide between the point that continues and the first point of a stop. The measured
axes are judged once the reply is out.

If the controller reports that it did not accept the last reply, the path waits: the same point is sent again,
and the prepared ones are kept. So each effective step is a prepared one, in spite of losses. If the
controller reports it one telegram late, two prepared steps may take effect at once; it accepts this below an
eighth of full speed. A controller that never reports it gets the path as planned.
"""

from __future__ import annotations

from math import degrees, radians

from drivers.kuka_rsi.realtime.link_health import Losses, SenderCheck
from drivers.kuka_rsi.realtime.link_state import (
    NO_STATE,
    STOP_KIND,
    STOP_KIND_BITS,
    Choice,
    Command,
    CommandKind,
    Fault,
    LinkSettings,
    LinkState,
    Orders,
    Phase,
    Result,
    StopOrder,
)
from drivers.kuka_rsi.realtime.set_points import PreparedReply, Replies, SetPoints
from drivers.kuka_rsi.realtime.telegram import Telegram
from ronna_hw.arm.clearance.live_watch import Violation
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.errors import RonnaError
from ronna_hw.vectors import JointVector

SETTLE_CYCLES = 10  # consecutive, within the tolerance
DEGRADED_SPEED = 0.5  # share of the planned speed after losses
HELD_AFTER_CYCLES = 3  # without an effective reply; after more the arm is at rest at the held point
START_TOLERANCE_RAD = 1e-9  # between a motion's planned start and the last point sent
RANGE_TOLERANCE_DEG = 0.01  # for the first telegram's axes: an arm may be at its end switch

_STOP_FAULTS = {
    StopOrder.PROTECTIVE: Fault.PROTECTIVE,
    StopOrder.LINK: Fault.LINK_STOP,
    StopOrder.DRIVES_OFF: Fault.DRIVES_OFF,
}
STREAMING_PHASES = (Phase.RUNNING, Phase.FAULT, Phase.ENDING)


class Responder:
    """Protocol state machine: `answer` and `finish_cycle` per telegram, `monitor_silence` without one."""

    def __init__(self, settings: LinkSettings) -> None:
        self._settings = settings
        self._kinematics = kr6_r900(settings.variant)
        self._limits: MotionLimits | None = None  # of the stream's operating mode
        self._cycle_s = settings.cycle_ms / 1000.0
        self._tolerance_rad = radians(settings.settle_tolerance_deg)
        self._silence_ns = round(settings.silence_limit_s * 1e9)
        self._heartbeat_ns = round(settings.heartbeat_limit_s * 1e9)
        self._replies = Replies(settings)
        self.phase = Phase.IDLE
        self.fault = Fault.NONE
        self.result = Result.NONE
        self.violation: Violation | None = None
        self.rejected = 0
        self.dropped = 0
        self.senders = SenderCheck()
        self.cycles = 0
        self.jitter_us = 0.0  # deviation of the last telegram from its expected arrival
        self.is_parent_gone = False
        self.choice = Choice.GO
        self.ready: PreparedReply | None = None
        self._heartbeat = (0, 0)  # value, and when it was first seen
        self._stop_word = 0  # last order seen
        self._command_number = 0
        self._ipoc = 0
        self._received_ns = self._previous_ns = 0
        self._missing = 0  # telegrams lost before the last one
        self._axes_deg: JointVector = NO_STATE.measured_rad
        self._measured: JointVector = NO_STATE.measured_rad
        self._losses = Losses(settings.cycle_ms)
        self._stopping = False
        self._settled_cycles = 0
        self._speed = 1.0
        self._points: SetPoints | None = None

    @property
    def moving(self) -> bool:
        """Whether a motion is in progress."""
        return self._points is not None and self._points.moving

    @property
    def sent_rad(self) -> JointVector:
        """Set-point sent last."""
        return self._points.last_rad if self._points else NO_STATE.commanded_rad

    @property
    def measured_rad(self) -> JointVector:
        """Joint angles measured in the last telegram."""
        return self._measured

    def answer(self, telegram: Telegram, orders: Orders, now_ns: int) -> bytes | None:
        """Return the reply up to its IPOC, or None if this telegram must not be answered."""
        self.ready = None
        self._axes_deg = telegram.axes_deg
        self._previous_ns, self._received_ns = self._received_ns, now_ns
        self.senders.foreign_sent_last = False
        self._check_heartbeat(orders.heartbeat, now_ns)
        ipoc = int(telegram.ipoc)
        if self.phase is Phase.ARMED and self._limits is not None:
            self._losses.count(ipoc, telegram.delay)
            self._ipoc = ipoc
            return self._begin_run(telegram.axes_deg, self._limits)
        if self.phase not in STREAMING_PHASES or self._points is None:
            self._ipoc = ipoc
            return None
        missing = self._losses.count(ipoc, telegram.delay)
        if missing == -1:
            return None
        self._ipoc = ipoc
        self._missing = missing or 0
        if missing is None:
            # Our corrections are meaningless for a run that we did not start: it gets no reply at all.
            self._latch(Fault.RESTARTED)
            self._stop_replying(self._points)
            return None
        self._check_stop(orders.stop_word)
        if self.phase is Phase.SILENT:
            return None
        points = self._points
        if points.violation is not None:
            self._trip(points.violation)
        elif points.path_failed:
            self._latch(Fault.PATH)
        elif points.moving and self._losses.is_unusable:
            self._latch(Fault.LOSSES)
        if points.moving and (self._losses.reply_lost or missing > HELD_AFTER_CYCLES):
            return self._answer_loss(points)
        self.choice = Choice.STOP if self._stopping else Choice.GO
        return self._replies.head_for(self.choice)

    def note_answered(self, telegram: Telegram, orders: Orders, now_ns: int) -> None:
        """Update the state as `answer` does, after the prepared reply has been sent."""
        self._axes_deg = telegram.axes_deg
        self._previous_ns, self._received_ns = self._received_ns, now_ns
        self.senders.foreign_sent_last = False
        self._ipoc = int(telegram.ipoc)
        self._missing = self._losses.count(self._ipoc, telegram.delay) or 0
        if self.ready is not None:
            self.choice = self.ready.choice
        self._check_heartbeat(orders.heartbeat, now_ns)

    def finish_cycle(self, command: Command | None) -> None:
        """Check the measured joint angles, accept a new command and prepare the next reply."""
        points = self._points
        if points is None:
            return
        self.cycles += 1
        due_ns = (self._missing + 1) * self._cycle_s * 1e9
        self.jitter_us = (
            abs(self._received_ns - self._previous_ns - due_ns) / 1000.0 if self.cycles > 1 else 0.0
        )
        self._measure()
        following_violation = points.monitor.check_measured(self._measured)
        if following_violation is not None:
            self._trip(following_violation)
        points.commit(self.choice)
        self._follow_motion(points)
        if command is not None:
            self.execute_command(command)
        if self._losses.degraded != (self._speed < 1.0):
            self._speed = DEGRADED_SPEED if self._losses.degraded else 1.0
            points.limit_speed(self._speed)
        points.prepare()
        self._replies.prepare(points, ending=self.phase is Phase.ENDING)
        self._make_ready(points)

    def is_expected(self, telegram: Telegram) -> bool:
        """Return whether a telegram may open the stream."""
        self._axes_deg = telegram.axes_deg
        self._measure()
        return self.senders.matches_expected(telegram.axes_deg)

    def execute_command(self, command: Command) -> None:
        """Execute a new command."""
        self.ready = None
        if command.number == self._command_number:
            return
        self._command_number = command.number
        if command.kind is CommandKind.MOVE and command.plan is not None:
            self.result = self._start_motion(command.plan, command)
        elif command.kind is CommandKind.OPEN and command.limits is not None and self.phase is Phase.IDLE:
            self._limits = command.limits
            self.phase, self.fault, self.result = Phase.ARMED, Fault.NONE, Result.NONE
            self.violation = None
            self.cycles = self.rejected = self.dropped = 0
            self.senders = SenderCheck(command.axes_rad)
            self._losses = Losses(self._settings.cycle_ms)
            self._stopping, self._speed, self._points = False, 1.0, None
        elif command.kind is CommandKind.END and not self.moving:
            if self.phase in (Phase.RUNNING, Phase.FAULT):
                self.phase = Phase.ENDING
        elif command.kind is CommandKind.CLOSE and not self.moving:
            self.phase, self.fault, self._points = Phase.IDLE, Fault.NONE, None

    def monitor_silence(self, orders: Orders, now_ns: int) -> None:
        """Check silence, heartbeat and stop orders while no telegrams arrive."""
        self.ready = None
        self._check_heartbeat(orders.heartbeat, now_ns)
        if self.phase not in STREAMING_PHASES or self._points is None:
            self._stop_word = orders.stop_word
            return
        self._check_stop(orders.stop_word)
        if now_ns - self._received_ns > self._silence_ns:
            # The controller has held the last point for long: the arm is at rest there.
            self._points.abandon()
            self._follow_motion(self._points)
            self._points.prepare()
            self._replies.prepare(self._points, ending=self.phase is Phase.ENDING)
            if self.phase is Phase.RUNNING:
                # A controller that restarts its program sends from another port.
                self._latch(Fault.RESTARTED if self.senders.foreign_sent_last else Fault.SILENCE)
        self._make_ready(self._points)

    def silent_for_ns(self, now_ns: int) -> int:
        """Return the host time since the last telegram."""
        return now_ns - self._received_ns

    def state(self, *, real_time: bool, locked: bool) -> LinkState:
        """Build the state for the mailbox."""
        violation = self.violation
        return LinkState(  # by position, in the order of its fields: by name costs five times as much
            self.cycles,
            self._ipoc,
            self._received_ns,
            self.phase,
            self.fault,
            self.result,
            self._losses.degraded,
            self.moving,
            self._settled_cycles >= SETTLE_CYCLES,
            real_time,
            locked,
            self._command_number,
            self._stop_word >> STOP_KIND_BITS,
            self._losses.late,
            self._losses.lost,
            self.rejected,
            self.dropped,
            self.senders.count,
            self.senders.host,
            self.senders.disagreeing,
            self._measured,
            self.sent_rad,
            NO_STATE.base_rad if self._points is None else self._base_rad,
            violation.kind if violation else "",
            violation.axis if violation else 0,
            violation.value if violation else 0.0,
            violation.limit if violation else 0.0,
        )

    def _answer_loss(self, points: SetPoints) -> bytes:
        """Build the reply that makes the arm wait because replies or telegrams were lost."""
        violation = points.monitor.mark_not_accepted() if self._losses.reply_lost else None
        if violation is not None:
            self._trip(violation)
        if violation is not None or self._losses.held_cycles > HELD_AFTER_CYCLES:
            self.choice = Choice.HOLD
            return self._replies.head(points.held_rad, False)
        self.choice = Choice.REPEAT
        return self._replies.head(points.last_rad, False)

    def _measure(self) -> None:
        a, b, c, d, e, f = self._axes_deg
        self._measured = (radians(a), radians(b), radians(c), radians(d), radians(e), radians(f))

    def _begin_run(self, axes_deg: JointVector, limits: MotionLimits) -> bytes:
        """Start a run from these joint angles; returns its first reply, a zero correction."""
        lower, upper = self._kinematics.lower_rad, self._kinematics.upper_rad
        for low, angle, high in zip(lower, axes_deg, upper, strict=True):
            if not degrees(low) - RANGE_TOLERANCE_DEG <= angle <= degrees(high) + RANGE_TOLERANCE_DEG:
                self._latch(Fault.BASE)
        self._measure()
        self._replies.begin(axes_deg)
        self._base_rad = self._measured
        self._points = SetPoints(self._kinematics, limits, self._cycle_s, self._measured)
        self._settled_cycles = 0
        self.choice = Choice.GO
        if self.phase is Phase.ARMED:
            self.phase = Phase.RUNNING if self.fault is Fault.NONE else Phase.FAULT
        self._replies.prepare(self._points, ending=self.phase is Phase.ENDING)
        return self._replies.head_for(Choice.GO)

    def _start_motion(self, plan: MotionPlan, command: Command) -> Result:
        points = self._points
        if self.phase is not Phase.RUNNING or points is None:
            return Result.REFUSED_PHASE
        if command.stop_number != self._stop_word >> STOP_KIND_BITS:
            return Result.REFUSED_STOP
        if points.moving or self._stopping:
            return Result.REFUSED_BUSY
        gap = max(abs(x - y) for x, y in zip(plan.start_rad, points.last_rad, strict=True))
        if not gap <= START_TOLERANCE_RAD:
            return Result.REFUSED_START
        try:
            points.start(plan, self._speed, command.surroundings)
        except RonnaError:
            return Result.REFUSED_NUMBERS
        self._settled_cycles = 0
        return Result.RUNNING

    def _follow_motion(self, points: SetPoints) -> None:
        if points.moving:
            self._settled_cycles = 0
            return
        if self._stopping and self.phase is not Phase.FAULT:
            self._stopping = False
        last = points.last_rad
        is_near = all(abs(x - y) <= self._tolerance_rad for x, y in zip(self._measured, last, strict=True))
        self._settled_cycles = self._settled_cycles + 1 if is_near else 0
        if self.result is Result.RUNNING:
            if points.was_stopped_early and (self._settled_cycles >= SETTLE_CYCLES or self.fault):
                self.result = Result.STOPPED
            elif self._settled_cycles >= SETTLE_CYCLES:
                self.result = Result.DONE
        if self.phase in (Phase.RUNNING, Phase.FAULT) and (
            self.is_parent_gone or self.fault is Fault.HEARTBEAT
        ):
            self.phase = Phase.ENDING

    def _check_stop(self, stop_word: int) -> None:
        if stop_word == self._stop_word:
            return
        self._stop_word = stop_word
        kind = StopOrder(stop_word & STOP_KIND)
        if kind is not StopOrder.HOLD:
            self._latch(_STOP_FAULTS[kind])
        if kind is StopOrder.LINK and self._points is not None:
            self._stop_replying(self._points)
        self._stopping = self.moving

    def _stop_replying(self, points: SetPoints) -> None:
        """Stop replying, so that the controller holds the last point and its Timeout ends the run."""
        self.phase = Phase.SILENT
        points.abandon()
        self._follow_motion(points)

    def _check_heartbeat(self, value: int, now_ns: int) -> None:
        seen, since = self._heartbeat
        if value != seen or not since:
            self._heartbeat = (value, now_ns)
        elif now_ns - since > self._heartbeat_ns and self.phase in (Phase.ARMED, Phase.RUNNING):
            self._latch(Fault.HEARTBEAT)
        if self.is_parent_gone:
            self._stopping = self.moving

    def _trip(self, violation: Violation) -> None:
        if self.violation is None:
            self.violation = violation
        self._latch(Fault.MONITOR)

    def _latch(self, fault: Fault) -> None:
        if self.fault is Fault.NONE:
            self.fault = fault
        if self.phase in (Phase.ARMED, Phase.RUNNING):
            self.phase = Phase.FAULT
        self._stopping = self.moving

    def _make_ready(self, points: SetPoints) -> None:
        """Prepare the complete next reply, if nothing but new information can change it."""
        self.ready = None
        is_unsettled = (
            points.violation is not None
            or points.path_failed
            or self.is_parent_gone
            or self._losses.is_unusable
        )
        if is_unsettled or self.phase not in STREAMING_PHASES:
            return
        self.ready = self._replies.complete(
            Choice.STOP if self._stopping else Choice.GO,
            last_ipoc=self._ipoc,
            reported_late=self._losses.reported_late,
            stop_word=self._stop_word,
        )
