"""Session of an arm's stream, without I/O: motions, stops, faults, and the answer to each telegram.

Reply k carries a point prepared after reply k-1. When a telegram arrives, only orders, losses and known
faults are checked, to decide between the point that continues and the first point of a stop. The reply to a
telegram that contains nothing unexpected is prepared as a whole. The measured axes are judged once the reply
is out.

If the controller reports that it did not use the last reply, the path waits: the same point is sent again,
and the prepared ones are kept. So each effective step is a prepared one, in spite of losses. A controller
that reports it one telegram late may take two prepared steps at once; one that never reports it gets the path
as planned.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from math import radians
from typing import Generic, NamedTuple, TypeVar

from ronna_hw.arm.clearance.live_watch import Violation
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.arm_stream.drill_feed import DrillFeed
from ronna_hw.arm_stream.force import NO_FORCE, ForceWatch
from ronna_hw.arm_stream.load_sums import LoadSums, Signals
from ronna_hw.arm_stream.losses import DEGRADED_SPEED, LossCount
from ronna_hw.arm_stream.records import (
    NO_STATE,
    STOP_KIND,
    STOP_KIND_BITS,
    Choice,
    CloseStream,
    Command,
    EndStream,
    ForceLimit,
    GuideByHand,
    LinkFault,
    LinkState,
    MotionResult,
    Move,
    OpenStream,
    Orders,
    StopOrder,
    StreamPhase,
    StreamSettings,
)
from ronna_hw.arm_stream.set_points import SetPoints
from ronna_hw.errors import RonnaError
from ronna_hw.vectors import JointVector, Vector3

SETTLE_CYCLES = 10  # consecutive, within the tolerance
HELD_AFTER_CYCLES = 3  # without an effective reply; after more the arm is at rest at the held point
START_TOLERANCE_RAD = 1e-9  # between a motion's planned start and the last point sent

_STOP_FAULTS = {
    StopOrder.PROTECTIVE: LinkFault.PROTECTIVE,
    StopOrder.LINK: LinkFault.LINK_STOP,
    StopOrder.DRIVES_OFF: LinkFault.DRIVES_OFF,
}
STREAMING_PHASES = (StreamPhase.RUNNING, StreamPhase.FAULT, StreamPhase.ENDING)
M = TypeVar("M")  # a decoded telegram
E = TypeVar("E")  # what is compared in the next one


class Senders:
    """Counts of others that sent to the link; to a connection nobody else can."""

    count = 0
    host = ""  # of the last one
    disagreeing = 0  # readable telegrams with other axes, before the controller's first


class PreparedReply(NamedTuple, Generic[E]):
    """Complete reply to the next telegram, valid if that contains nothing unexpected."""

    expected: E  # in the telegram
    stop_word: int  # no new stop
    choice: Choice
    reply: bytes


class StreamSession(ABC, Generic[M, E]):
    """Session of one arm: a driver answers each telegram with `choose` and calls `finish_cycle`."""

    def __init__(self, settings: StreamSettings, kinematics: Kinematics, cycle_s: float) -> None:
        self._kinematics = kinematics
        self._limits: MotionLimits | None = None  # of the stream's operating mode
        self._cycle_s = cycle_s
        self._tolerance_rad = radians(settings.settle_tolerance_deg)
        self._silence_ns = round(settings.silence_limit_s * 1e9)
        self._heartbeat_ns = round(settings.heartbeat_limit_s * 1e9)
        self.phase = StreamPhase.IDLE
        self.fault = LinkFault.NONE
        self.result = MotionResult.NONE
        self._settles = True  # whether the motion under way ends with a settled arm
        self.violation: Violation | None = None
        self.rejected = 0
        self.dropped = 0
        self.senders = Senders()
        self.cycles = 0
        self.jitter_us = 0.0  # deviation of the last telegram from its expected arrival
        self.is_parent_gone = False
        self.choice = Choice.GO
        self.device_clock = 0
        self.controller_word = 0  # packed by the driver for its errors
        self._heartbeat = (0, 0)  # value, and when it was first seen
        self._is_parent_frozen = False  # no heartbeat for too long, also after another fault
        self._stop_word = 0  # last order seen
        self._command_number = 0
        self._received_ns = self._previous_ns = 0
        self.ready: PreparedReply[E] | None = None
        self._missing = 0  # telegrams lost before the last one
        self._measured: JointVector = NO_STATE.measured_rad
        self._base_rad: JointVector = NO_STATE.base_rad
        self._losses = LossCount()
        self._stopping = False
        self._settled_cycles = 0
        self._controller_speed = 1.0  # share of the planned speed that the controller leaves
        self._speed = 1.0  # and that losses leave
        self._feed = 1.0  # and that the force on a drill leaves
        self._points: SetPoints | None = None
        self._force: ForceWatch | None = None
        if settings.force_filter_s:
            self._force = ForceWatch(cycle_s, settings.force_filter_s, settings.force_at_rest_N)
        self._is_force_exceeded = False  # in the last motion
        self._drill: DrillFeed | None = None  # of the last motion, if it was one of a drill
        self._drilled_cycles = 0
        self._loads = LoadSums()

    @abstractmethod
    def _accept(self, telegram: M) -> bool:
        """Take over a telegram; returns False to ignore it."""

    @abstractmethod
    def _accept_expected(self, telegram: M) -> None:
        """Take over a telegram to which the prepared reply has been sent, and count its losses."""

    @abstractmethod
    def _answer_before_start(self, telegram: M) -> bytes | None:
        """Return the reply to a telegram of an open stream that has not begun, and begin it if it may."""

    @abstractmethod
    def _judge_link(self, telegram: M, points: SetPoints) -> bool:
        """Judge the link by a telegram: count losses, and return whether to answer it.

        A telegram of another run, and a stop of the controller, are latched and end the stream.
        """

    @abstractmethod
    def _encode(self, joints_rad: JointVector) -> bytes:
        """Encode the reply to the last telegram."""

    @abstractmethod
    def _expect(self) -> E | None:
        """Return what the next telegram must contain for a prepared reply; None if none can be prepared."""

    @abstractmethod
    def _encode_next(self, joints_rad: JointVector) -> bytes:
        """Encode the reply to the next telegram, if that is the expected one."""

    @abstractmethod
    def _measure(self) -> None:
        """Take over the measured axes of the last telegram."""

    def _measured_force(self) -> Vector3:
        """Return the force on the tool in the last telegram, of an arm that estimates one."""
        return NO_FORCE

    def _carries_loads(self) -> bool:
        """Return whether the last telegram has load signals, valid or not."""
        return True

    def _measured_loads(self) -> Signals | None:
        """Return the load signals of the last telegram, None without them; asked at rest only."""
        return None

    @abstractmethod
    def _open(self, opened: OpenStream) -> bool:
        """Prepare for the first telegram of a stream; False if there is nothing to receive it from."""

    def _judge_measured(self, violation: Violation) -> None:
        """Act on measured axes that are not where the set-points were."""
        self._trip(violation)

    def _silence_fault(self) -> LinkFault:
        """Return the fault to latch when no telegram has come for too long."""
        return LinkFault.SILENCE

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

    def answer(self, telegram: M, orders: Orders, now_ns: int) -> bytes | None:
        """Return the reply to a telegram, or None if it must not be answered."""
        self.ready = None
        if not self._accept(telegram):
            return None
        self._previous_ns, self._received_ns = self._received_ns, now_ns
        self._check_heartbeat(orders.heartbeat, now_ns)
        if self.phase is StreamPhase.ARMED:
            return self._answer_before_start(telegram)
        points = self._points
        if points is None or self.phase not in STREAMING_PHASES or not self._judge_link(telegram, points):
            return None
        if (choice := self._choose(points, orders.stop_word)) is None:
            return None
        self.choice = choice
        return self._encode(points.at(choice))

    def advance_after_reply(self, telegram: M, orders: Orders, now_ns: int) -> None:
        """Update the state as `answer` does, after the prepared reply has been sent."""
        self._previous_ns, self._received_ns = self._received_ns, now_ns
        self._accept_expected(telegram)
        if self.ready is not None:
            self.choice = self.ready.choice
        self._check_heartbeat(orders.heartbeat, now_ns)

    def _choose(self, points: SetPoints, stop_word: int) -> Choice | None:
        """Choose the set-point of the next reply; None if there must be no reply."""
        self._check_stop(stop_word)
        if self.phase is StreamPhase.SILENT:
            return None
        if points.violation is not None:
            self._trip(points.violation)
        elif points.path_failed:
            self._latch(LinkFault.PATH)
        elif points.moving and self._losses.is_unusable:
            self._latch(LinkFault.LOSSES)
        if points.moving and (self._losses.reply_lost or self._missing > HELD_AFTER_CYCLES):
            return self._choose_after_loss(points)
        return Choice.STOP if self._stopping else Choice.GO

    def finish_cycle(self, command: Command | None) -> None:
        """Check the measured joint angles, accept a new command and prepare the next reply."""
        if (points := self._points) is None:
            return
        self.cycles += 1
        due_ns = (self._missing + 1) * self._cycle_s * 1e9
        self.jitter_us = (
            abs(self._received_ns - self._previous_ns - due_ns) / 1000.0 if self.cycles > 1 else 0.0
        )
        self._measure()
        if self._force is not None:
            self._follow_force(points, self._force)
        if (following_violation := points.monitor.check_measured(self._measured)) is not None:
            self._judge_measured(following_violation)
        points.commit(self.choice)
        self._follow_motion(points)
        self._follow_loads()
        if command is not None:
            self.execute_command(command)
        feed = self._drill.share if self._drill is not None and points.moving else 1.0
        speed = self._controller_speed * (DEGRADED_SPEED if self._losses.degraded else 1.0)
        if speed != self._speed or feed != self._feed:
            self._speed, self._feed = speed, feed
            points.limit_speed(speed * feed)
        points.prepare()
        self._prepare_reply(points)

    def execute_command(self, command: Command) -> None:
        """Execute a new command."""
        self.ready = None
        if command.number == self._command_number:
            return
        self._command_number = command.number
        match command.request:
            case Move() | GuideByHand() as motion:
                self.result = self._start_motion(motion, command)
            case OpenStream() as opened if self.phase is StreamPhase.IDLE:
                self._limits = opened.limits
                self.fault, self.result = LinkFault.NONE, MotionResult.NONE
                self.violation = None
                self.cycles = self.rejected = self.dropped = self.device_clock = 0
                self._stopping, self._speed, self._points = False, 1.0, None
                if self._open(opened):
                    self.phase = StreamPhase.ARMED
            case EndStream() if not self.moving and self.phase in (StreamPhase.RUNNING, StreamPhase.FAULT):
                self.phase = StreamPhase.ENDING
            case CloseStream() if not self.moving:
                self.phase, self.fault, self._points = StreamPhase.IDLE, LinkFault.NONE, None

    def monitor_silence(self, orders: Orders, now_ns: int) -> None:
        """Check silence, heartbeat and stop orders while no telegrams arrive."""
        self.ready = None
        self._check_heartbeat(orders.heartbeat, now_ns)
        points = self._points
        if self.phase not in STREAMING_PHASES or points is None:
            self._stop_word = orders.stop_word
            return
        self._check_stop(orders.stop_word)
        if now_ns - self._received_ns > self._silence_ns:
            # The controller has held the last point for long: the arm is at rest there.
            self._rest(points)
            if self.phase is StreamPhase.RUNNING:
                self._latch(self._silence_fault())
        self._prepare_reply(points)

    def silent_for_ns(self, now_ns: int) -> int:
        """Return the host time since the last telegram."""
        return now_ns - self._received_ns

    def state(self, *, real_time: bool, locked: bool) -> LinkState:
        """Build the state for the mailbox."""
        state = LinkState()
        losses, senders, loads = self._losses, self.senders, self._loads
        state.cycles = self.cycles
        state.device_clock = self.device_clock
        state.received_ns = self._received_ns
        state.phase = self.phase
        state.fault = self.fault
        state.result = self.result
        state.degraded = losses.degraded
        state.moving = self.moving
        state.settled = self._settled_cycles >= SETTLE_CYCLES
        state.real_time = real_time
        state.locked = locked
        state.command_number = self._command_number
        state.stop_number = self._stop_word >> STOP_KIND_BITS
        state.late = losses.late
        state.lost = losses.lost
        state.rejected = self.rejected
        state.dropped = self.dropped
        state.foreign = senders.count
        state.foreign_host = senders.host
        state.disagreeing = senders.disagreeing
        state.measured_rad = self._measured
        state.commanded_rad = self.sent_rad
        state.speed_share = self._speed
        state.controller_word = self.controller_word
        state.carries_loads = self._carries_loads()
        state.load_since = loads.since
        state.load_cycles = loads.cycles
        state.load_sums = loads.sums
        if self._points is not None:
            state.base_rad = self._base_rad
        if self._force is not None:
            state.force_N = self._force.filtered_N
            state.is_force_known = self._force.is_known
            state.peak_force_N = self._force.peak_N
        if self._drill is not None:
            state.drilled_cycles, state.slowed_cycles = self._drilled_cycles, self._drill.slowed_cycles
            state.drilled_N, state.side_force_N = tuple(self._drill.forces_N), self._drill.peak_side_N
            state.is_in_bone, state.is_through = self._drill.in_bone, self._drill.has_broken_through
            state.free_share = self._drill.free_share
        if (violation := self.violation) is not None:
            state.violation_kind = violation.kind
            state.violation_axis = violation.axis
            state.violation_value = violation.value
            state.violation_limit = violation.limit
        return state

    def _begin(self, start_rad: JointVector, limits: MotionLimits) -> SetPoints:
        """Begin to stream set-points from rest at `start_rad`."""
        self._base_rad = start_rad
        self._loads.clear()
        self._points = points = SetPoints(self._kinematics, limits, self._cycle_s, start_rad)
        self._settled_cycles = 0
        self.choice = Choice.GO
        if self.phase is StreamPhase.ARMED:
            self.phase = StreamPhase.RUNNING if self.fault is LinkFault.NONE else StreamPhase.FAULT
        return points

    def _prepare_reply(self, points: SetPoints) -> None:
        """Prepare the complete next reply, if nothing but new information can change it."""
        self.ready = None
        if points.violation is not None or points.path_failed or self._losses.is_unusable:
            return
        if self.is_parent_gone or self.phase not in STREAMING_PHASES:
            return
        if (expected := self._expect()) is not None:
            choice = Choice.STOP if self._stopping else Choice.GO
            reply = self._encode_next(points.at(choice))
            self.ready = PreparedReply(expected, self._stop_word, choice, reply)

    def _choose_after_loss(self, points: SetPoints) -> Choice:
        """Choose the set-point that makes the arm wait because replies or telegrams were lost."""
        violation = points.monitor.mark_not_accepted() if self._losses.reply_lost else None
        if violation is not None:
            self._trip(violation)
        if violation is not None or self._losses.held_cycles > HELD_AFTER_CYCLES:
            return Choice.HOLD
        return Choice.REPEAT

    def _start_motion(self, motion: Move | GuideByHand, command: Command) -> MotionResult:
        points = self._points
        if self.phase is not StreamPhase.RUNNING or points is None:
            return MotionResult.REFUSED_PHASE
        if command.stop_number != self._stop_word >> STOP_KIND_BITS:
            return MotionResult.REFUSED_STOP
        if points.moving or self._stopping:
            return MotionResult.REFUSED_BUSY
        if isinstance(motion, Move) and not _starts_at(motion.plan, points.last_rad):
            return MotionResult.REFUSED_START
        force = motion.force if isinstance(motion, Move) else ForceLimit(motion.force_limit_N)
        if (force.limit_N or isinstance(motion, GuideByHand)) and not (
            self._force is not None and self._force.begin(force)
        ):
            return MotionResult.REFUSED_LOADED
        self._is_force_exceeded, self._drilled_cycles = False, 0
        before, self._drill = self._drill if force.goes_on else None, None
        if force.drill is not None:
            was_in_bone, free_share = (False, 0.0) if before is None else (before.in_bone, before.free_share)
            self._drill = DrillFeed(force.drill, self._cycle_s, in_bone=was_in_bone, free_share=free_share)
        try:
            if isinstance(motion, Move):
                points.start(motion.plan, self._speed, command.surroundings)
            else:
                points.guide(motion.limits, self._speed, command.surroundings)
        except RonnaError:
            return MotionResult.REFUSED_NUMBERS
        self._settled_cycles = 0
        self._settles = not isinstance(motion, Move) or motion.settles
        return MotionResult.RUNNING

    def _follow_force(self, points: SetPoints, force: ForceWatch) -> None:
        """Stop a motion whose force limit is exceeded, or pass the force on to one that follows it."""
        force.note(self._measured_force(), moving=points.moving)
        if not points.moving:
            return
        if force.is_exceeded:
            self._is_force_exceeded = self._stopping = True
        if (drill := self._drill) is not None:
            self._drilled_cycles += 1
            drill.note(force.change_N, points.progress)
            self._stopping |= drill.has_ended
        if points.push(force.change_N):
            self._stopping = True

    def _follow_loads(self) -> None:
        """Sum the load signals of the arm at rest."""
        if self._settled_cycles < SETTLE_CYCLES:
            self._loads.clear()
        elif (signals := self._measured_loads()) is not None:
            self._loads.note(signals, self.cycles)

    def _follow_motion(self, points: SetPoints) -> None:
        if points.moving:
            self._settled_cycles = 0
            return
        if self._stopping and self.phase is not StreamPhase.FAULT:
            self._stopping = False
        last = points.last_rad
        is_near = all(abs(x - y) <= self._tolerance_rad for x, y in zip(self._measured, last, strict=True))
        self._settled_cycles = self._settled_cycles + 1 if is_near else 0
        if self.result is MotionResult.RUNNING:
            has_settled = self._settled_cycles >= SETTLE_CYCLES
            if points.was_stopped_early:
                if has_settled or self.fault:
                    self.result = self._why_stopped()
            elif has_settled or not self._settles:
                self.result = MotionResult.DONE
            if self._force is not None and self.result is not MotionResult.RUNNING:
                self._force.end()
        if self.phase in (StreamPhase.RUNNING, StreamPhase.FAULT) and (
            self.is_parent_gone or self._is_parent_frozen or self.fault is LinkFault.HEARTBEAT
        ):
            self.phase = StreamPhase.ENDING

    def _why_stopped(self) -> MotionResult:
        """Return why the motion has ended before the end of its path."""
        if self._is_force_exceeded:
            return MotionResult.FORCE
        if self._drill is not None and self._drill.is_pushed_aside:
            return MotionResult.ASIDE
        if self._drill is not None and self._drill.has_broken_through:
            return MotionResult.THROUGH
        if self._drill is not None and self._drill.has_stalled:
            return MotionResult.STALLED
        if self._drill is not None and self._drill.has_missed_bone:
            return MotionResult.BONELESS
        if self._drill is not None and self._drill.is_hidden:
            return MotionResult.HIDDEN
        return MotionResult.STOPPED

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
        """Stop replying, so that the controller holds the last point and ends the run by itself."""
        self.phase = StreamPhase.SILENT
        self._rest(points)

    def _rest(self, points: SetPoints) -> None:
        """Abandon a motion whose arm is at rest, or stopped by its controller."""
        points.abandon()
        self._follow_motion(points)
        points.prepare()

    def _check_heartbeat(self, value: int, now_ns: int) -> None:
        seen, since = self._heartbeat
        if value != seen or not since:
            self._heartbeat = (value, now_ns)
            self._is_parent_frozen = False
        elif now_ns - since > self._heartbeat_ns:
            self._is_parent_frozen = True
            if self.phase in (StreamPhase.ARMED, StreamPhase.RUNNING):
                self._latch(LinkFault.HEARTBEAT)
        if self.is_parent_gone:
            self._stopping = self.moving

    def _trip(self, violation: Violation) -> None:
        if self.violation is None:
            self.violation = violation
        self._latch(LinkFault.MONITOR)

    def _latch(self, fault: LinkFault) -> None:
        if self.fault is LinkFault.NONE:
            self.fault = fault
        if self.phase in (StreamPhase.ARMED, StreamPhase.RUNNING):
            self.phase = StreamPhase.FAULT
        self._stopping = self.moving


def _starts_at(plan: MotionPlan, last_rad: JointVector) -> bool:
    gap = max(abs(x - y) for x, y in zip(plan.start_rad, last_rad, strict=True))
    return gap <= START_TOLERANCE_RAD  # NaN fails here
