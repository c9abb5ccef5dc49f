"""Computation of the reply to each telegram, without I/O.

A reply that is lost or late shows in the controller's count in the next telegram, or the one after it. Two
prepared steps that then take effect at once are accepted by the controller below an eighth of full speed.
"""

from __future__ import annotations

from math import degrees, radians

from drivers.kuka_rsi.realtime.link_health import Losses, SenderCheck
from drivers.kuka_rsi.realtime.replies import PreparedReply, Replies
from drivers.kuka_rsi.realtime.settings import LinkSettings
from drivers.kuka_rsi.realtime.telegram import Telegram, read_currents
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm_stream.load_sums import NO_SIGNALS, Signals
from ronna_hw.arm_stream.records import NO_STATE, Choice, Fault, OpenStream, Orders, Phase
from ronna_hw.arm_stream.session import SETTLE_CYCLES, STREAMING_PHASES, StreamSession
from ronna_hw.arm_stream.set_points import SetPoints
from ronna_hw.vectors import JointVector

__all__ = ["SETTLE_CYCLES", "STREAMING_PHASES", "Responder"]

NOTHING_ELSE = NO_SIGNALS[6:]  # no currents that it would expect, no force
RANGE_TOLERANCE_DEG = 0.01  # for the first telegram's axes: an arm may be at its end switch


class Responder(StreamSession):
    """Protocol state machine: `answer` and `finish_cycle` per telegram, `monitor_silence` without one."""

    senders: SenderCheck
    _losses: Losses

    def __init__(self, settings: LinkSettings) -> None:
        super().__init__(settings, kr6_r900(settings.variant), settings.cycle_ms / 1000.0)
        self._cycle_ms = settings.cycle_ms
        self._replies = Replies(settings)
        self.senders = SenderCheck()
        self.ready: PreparedReply | None = None
        self._axes_deg: JointVector = NO_STATE.measured_rad
        self._currents = b""  # of the last telegram, as text
        self._losses = Losses(settings.cycle_ms)

    def answer(self, telegram: Telegram, orders: Orders, now_ns: int) -> bytes | None:
        """Return the reply up to its IPOC, or None if this telegram must not be answered."""
        self.ready = None
        self._axes_deg, self._currents = telegram.axes_deg, telegram.currents
        self._previous_ns, self._received_ns = self._received_ns, now_ns
        self.senders.foreign_sent_last = False
        self._check_heartbeat(orders.heartbeat, now_ns)
        ipoc = int(telegram.ipoc)
        if self.phase is Phase.ARMED and self._limits is not None:
            self._losses.count(ipoc, telegram.delay)
            self.device_clock = ipoc
            return self._begin_run(telegram.axes_deg, self._limits)
        points = self._points
        if self.phase not in STREAMING_PHASES or points is None:
            self.device_clock = ipoc
            return None
        missing = self._losses.count(ipoc, telegram.delay)
        if missing == -1:
            return None
        self.device_clock = ipoc
        self._missing = missing or 0
        if missing is None:
            # Our corrections are meaningless for a run that we did not start: it gets no reply at all.
            self._latch(Fault.RESTARTED)
            self._stop_replying(points)
            return None
        choice = self.choose(points, orders.stop_word, missing)
        if choice is None:
            return None
        self.choice = choice
        if choice in (Choice.REPEAT, Choice.HOLD):
            return self._replies.head(points.at(choice), False)
        return self._replies.head_for(choice)

    def note_answered(self, telegram: Telegram, orders: Orders, now_ns: int) -> None:
        """Update the state as `answer` does, after the prepared reply has been sent."""
        self._axes_deg, self._currents = telegram.axes_deg, telegram.currents
        self._previous_ns, self._received_ns = self._received_ns, now_ns
        self.senders.foreign_sent_last = False
        self.device_clock = int(telegram.ipoc)
        self._missing = self._losses.count(self.device_clock, telegram.delay) or 0
        if self.ready is not None:
            self.choice = self.ready.choice
        self._check_heartbeat(orders.heartbeat, now_ns)

    def is_expected(self, telegram: Telegram) -> bool:
        """Return whether a telegram may open the stream."""
        self._axes_deg = telegram.axes_deg
        self._measure()
        return self.senders.matches_expected(telegram.axes_deg)

    def _open(self, opened: OpenStream) -> bool:
        self.senders = SenderCheck(opened.axes_rad)
        self._losses = Losses(self._cycle_ms)
        return True

    def _silence_fault(self) -> Fault:
        # A controller that restarts its program sends from another port.
        return Fault.RESTARTED if self.senders.foreign_sent_last else Fault.SILENCE

    def _forget_reply(self) -> None:
        self.ready = None

    def _measure(self) -> None:
        a, b, c, d, e, f = self._axes_deg
        self._measured = (radians(a), radians(b), radians(c), radians(d), radians(e), radians(f))

    def _carries_loads(self) -> bool:
        return bool(self._currents)

    def _measured_loads(self) -> Signals | None:
        currents = read_currents(self._currents)
        return None if currents is None else currents + NOTHING_ELSE

    def _begin_run(self, axes_deg: JointVector, limits: MotionLimits) -> bytes:
        """Start a run from these joint angles; returns its first reply, a zero correction."""
        lower, upper = self._kinematics.lower_rad, self._kinematics.upper_rad
        for low, angle, high in zip(lower, axes_deg, upper, strict=True):
            if not degrees(low) - RANGE_TOLERANCE_DEG <= angle <= degrees(high) + RANGE_TOLERANCE_DEG:
                self._latch(Fault.BASE)
        self._measure()
        self._replies.begin(axes_deg)
        points = self._begin(self._measured, limits)
        self._replies.prepare(points, ending=self.phase is Phase.ENDING)
        return self._replies.head_for(Choice.GO)

    def _prepare_reply(self, points: SetPoints) -> None:
        """Prepare the complete next reply, if nothing but new information can change it."""
        self._replies.prepare(points, ending=self.phase is Phase.ENDING)
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
            last_ipoc=self.device_clock,
            reported_late=self._losses.reported_late,
            stop_word=self._stop_word,
        )
