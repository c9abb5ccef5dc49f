"""Session of the RSI stream: corrections relative to the joint angles of its first telegram, without I/O.

A reply that is lost or late shows in the controller's count in the next telegram, or the one after it. Two
prepared steps that then take effect at once are accepted by the controller below an eighth of full speed.
"""

from __future__ import annotations

from math import degrees, nan, radians

from drivers.kuka_rsi.realtime.link_health import Losses, SenderCheck
from drivers.kuka_rsi.realtime.settings import LinkSettings
from drivers.kuka_rsi.realtime.telegram import (
    REPLY_TAIL,
    Found,
    ReplyWriter,
    Telegram,
    read_currents,
    read_forces,
)
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm_stream.load_sums import NO_SIGNALS, Signals
from ronna_hw.arm_stream.records import NO_STATE, LinkFault, OpenStream, StreamPhase
from ronna_hw.arm_stream.session import STREAMING_PHASES, PreparedReply, StreamSession
from ronna_hw.arm_stream.set_points import SetPoints
from ronna_hw.vectors import JointVector, Vector3

NOTHING_ELSE = NO_SIGNALS[6:]  # no currents that it would expect, no force
# Safety against a force sensor that has failed (U).
FROZEN_CYCLES = 25  # with the same six values: the noise of a sensor that lives changes them in each
NOT_KNOWN: Vector3 = (nan, nan, nan)
RANGE_TOLERANCE_DEG = 0.01  # for the first telegram's axes: an arm may be at its end switch

DelayAndIpoc = tuple[bytes, bytes]  # of the next telegram: the controller's count unchanged, the next cycle


class RsiSession(StreamSession[Telegram, DelayAndIpoc]):
    """Protocol state machine: `answer` and `finish_cycle` per telegram, `monitor_silence` without one."""

    senders: SenderCheck
    _losses: Losses

    def __init__(self, settings: LinkSettings) -> None:
        super().__init__(settings, kr6_r900(settings.variant), settings.cycle_ms / 1000.0)
        self._cycle_ms = settings.cycle_ms
        self._writer = ReplyWriter(
            settings.sentype, settings.receive_tags, settings.axis_tags, settings.stop_tag
        )
        self.senders = SenderCheck()
        self._ipoc = b""  # of the last telegram
        self._axes_deg: JointVector = NO_STATE.measured_rad
        self._currents = self._forces = b""  # of the last telegram, as text
        self._frozen: tuple[bytes, int] = b"", 0  # forces as text, and for how many cycles they are the same
        self._losses = Losses(settings.cycle_ms)
        self._start_deg: JointVector = NO_STATE.measured_rad  # origin of the corrections
        self._is_ending = False  # Stop is to be sent
        self._last_head: tuple[JointVector, bool, bytes] | None = None

    def match(self, found: Found, stop_word: int) -> PreparedReply[DelayAndIpoc] | None:
        """Return the prepared reply unless the telegram has something new, or a stop is ordered."""
        ready = self.ready
        if ready is None or stop_word != ready.stop_word or found.group("D", "IPOC") != ready.expected:
            return None
        return ready

    def is_expected(self, telegram: Telegram) -> bool:
        """Return whether a telegram may open the stream."""
        self._axes_deg = telegram.axes_deg
        self._measure()
        return self.senders.matches_expected(telegram.axes_deg)

    def _accept(self, telegram: Telegram) -> bool:
        self._axes_deg, self._ipoc = telegram.axes_deg, telegram.ipoc
        self._currents, self._forces = telegram.currents, telegram.forces
        self.senders.foreign_sent_last = False
        if self._points is None or self.phase not in STREAMING_PHASES:
            self.device_clock = int(telegram.ipoc)
        return True

    def _accept_expected(self, telegram: Telegram) -> None:
        self._axes_deg, self._currents, self._forces = telegram.axes_deg, telegram.currents, telegram.forces
        self.senders.foreign_sent_last = False
        self.device_clock = int(telegram.ipoc)
        self._missing = self._losses.count(self.device_clock, telegram.delay) or 0

    def _answer_before_start(self, telegram: Telegram) -> bytes | None:
        """Start a run from these joint angles: its first reply is a zero correction."""
        if self._limits is None:
            return None
        self._losses.count(self.device_clock, telegram.delay)
        axes_deg, lower, upper = telegram.axes_deg, self._kinematics.lower_rad, self._kinematics.upper_rad
        for low, angle, high in zip(lower, axes_deg, upper, strict=True):
            if not degrees(low) - RANGE_TOLERANCE_DEG <= angle <= degrees(high) + RANGE_TOLERANCE_DEG:
                self._latch(LinkFault.BASE)
        self._measure()
        self._start_deg, self._last_head = axes_deg, None
        points = self._begin(self._measured, self._limits)
        self._is_ending = False
        return self._encode(points.last_rad)

    def _judge_link(self, telegram: Telegram, points: SetPoints) -> bool:
        ipoc = int(telegram.ipoc)
        if (missing := self._losses.count(ipoc, telegram.delay)) == -1:
            return False
        self.device_clock = ipoc
        self._missing = missing or 0
        if missing is None:
            # Our corrections are meaningless for a run that we did not start: it gets no reply at all.
            self._latch(LinkFault.RESTARTED)
            self._stop_replying(points)
            return False
        return True

    def _open(self, opened: OpenStream) -> bool:
        self.senders = SenderCheck(opened.axes_rad)
        self._losses = Losses(self._cycle_ms)
        return True

    def _silence_fault(self) -> LinkFault:
        # A controller that restarts its program sends from another port.
        return LinkFault.RESTARTED if self.senders.foreign_sent_last else LinkFault.SILENCE

    def _measure(self) -> None:
        a, b, c, d, e, f = self._axes_deg
        self._measured = (radians(a), radians(b), radians(c), radians(d), radians(e), radians(f))

    def _measured_force(self) -> Vector3:
        """Return the force of the sensor on the flange in the base; no numbers if it is silent or frozen."""
        text, cycles = self._frozen
        self._frozen = self._forces, cycles + 1 if self._forces == text else 0
        force = read_forces(self._forces)
        if force is None or self._frozen[1] >= FROZEN_CYCLES:
            return NOT_KNOWN
        return self._kinematics.forward(self._measured).rotate(force)

    def _carries_loads(self) -> bool:
        return bool(self._currents)

    def _measured_loads(self) -> Signals | None:
        currents = read_currents(self._currents)
        return None if currents is None else currents + NOTHING_ELSE

    def _prepare_reply(self, points: SetPoints) -> None:
        self._is_ending = self.phase is StreamPhase.ENDING and not points.moving
        super()._prepare_reply(points)

    def _expect(self) -> DelayAndIpoc:
        late = self._losses.reported_late
        return str(late).encode() if late >= 0 else b"", self._next_ipoc()

    def _encode(self, joints_rad: JointVector) -> bytes:
        return self._head(joints_rad) + self._ipoc + REPLY_TAIL

    def _encode_next(self, joints_rad: JointVector) -> bytes:
        return self._head(joints_rad) + self._next_ipoc() + REPLY_TAIL

    def _next_ipoc(self) -> bytes:
        return str(self.device_clock + self._cycle_ms).encode()

    def _head(self, joints_rad: JointVector) -> bytes:
        """Encode a reply up to its IPOC; corrections in deg with six decimals."""
        last, stop = self._last_head, self._is_ending
        if last is not None and last[0] is joints_rad and last[1] is stop:
            return last[2]
        base = self._start_deg
        a, b, c, d, e, f = joints_rad
        head = self._writer.head(
            (
                degrees(a) - base[0],
                degrees(b) - base[1],
                degrees(c) - base[2],
                degrees(d) - base[3],
                degrees(e) - base[4],
                degrees(f) - base[5],
            ),
            stop,
        )
        self._last_head = (joints_rad, stop, head)
        return head
