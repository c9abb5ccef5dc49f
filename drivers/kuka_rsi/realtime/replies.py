"""Replies to the controller: corrections relative to the joint angles of the stream's first telegram."""

from __future__ import annotations

from math import degrees
from typing import NamedTuple

from drivers.kuka_rsi.realtime.settings import LinkSettings
from drivers.kuka_rsi.realtime.telegram import REPLY_TAIL, ReplyWriter
from ronna_hw.arm_stream.records import Choice
from ronna_hw.arm_stream.set_points import SetPoints
from ronna_hw.vectors import JointVector

NO_AXES: JointVector = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class PreparedReply(NamedTuple):
    """Complete reply to the next telegram, valid if the telegram contains nothing unexpected."""

    delay_and_ipoc: tuple[bytes, bytes]  # the controller's count unchanged, the next cycle
    stop_word: int  # no new stop
    choice: Choice
    reply: bytes


class Replies:
    """Reply encoder for one stream, with corrections relative to the joint angles of `begin`."""

    def __init__(self, settings: LinkSettings) -> None:
        self._writer = ReplyWriter(
            settings.sentype, settings.receive_tags, settings.axis_tags, settings.stop_tag
        )
        self._cycle_ms = settings.cycle_ms
        self._base_deg = NO_AXES
        self._points = (NO_AXES, NO_AXES)  # to continue and to stop
        self._ending = False
        self._last_head: tuple[JointVector, bool, bytes] | None = None

    def begin(self, base_deg: JointVector) -> None:
        """Start a run with these joint angles as the origin of corrections."""
        self._base_deg = base_deg
        self._last_head = None

    def prepare(self, points: SetPoints, *, ending: bool) -> None:
        """Take over the prepared points; with `ending`, also Stop once at rest."""
        moving = points.moving
        self._points = (points.go_rad, points.stop_rad) if moving else (points.last_rad, points.last_rad)
        self._ending = ending and not moving

    def head_for(self, choice: Choice) -> bytes:
        """Encode a reply up to its IPOC for the prepared point to continue or to stop."""
        return self.head(self._points[choice], self._ending)

    def complete(
        self, choice: Choice, *, last_ipoc: int, reported_late: int, stop_word: int
    ) -> PreparedReply:
        """Build the complete reply to the next expected telegram."""
        ipoc = str(last_ipoc + self._cycle_ms).encode()
        delay = str(reported_late).encode() if reported_late >= 0 else b""
        return PreparedReply((delay, ipoc), stop_word, choice, self.head_for(choice) + ipoc + REPLY_TAIL)

    def head(self, joints_rad: JointVector, stop: bool) -> bytes:
        """Encode a reply up to its IPOC; corrections in deg with six decimals."""
        last = self._last_head
        if last is not None and last[0] is joints_rad and last[1] is stop:
            return last[2]
        base = self._base_deg
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
