"""The replies of one stream, prepared before their telegrams arrive."""

from __future__ import annotations

from math import degrees
from typing import NamedTuple

from drivers.kuka_rsi.realtime.link_state import Choice
from drivers.kuka_rsi.realtime.set_points import SetPoints
from drivers.kuka_rsi.realtime.settings import LinkSettings
from drivers.kuka_rsi.realtime.telegram import REPLY_TAIL, ReplyWriter
from ronna_hw.devices.readings import JointVector

NO_AXES: JointVector = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class PreparedReply(NamedTuple):
    """The complete reply to the next expected telegram, valid if that telegram contains nothing new."""

    delay_and_ipoc: tuple[bytes, bytes]  # the controller's count unchanged, the next cycle
    stop_word: int  # no new stop
    choice: Choice
    reply: bytes


class Replies:
    """Corrections are relative to `begin`'s axes; a head is everything before the IPOC."""

    def __init__(self, settings: LinkSettings) -> None:
        self._writer = ReplyWriter(
            settings.sentype, settings.receive_tags, settings.axis_tags, settings.stop_tag
        )
        self._cycle_ms = settings.cycle_ms
        self._base_deg = NO_AXES
        self.heads = (b"", b"")  # to continue and to stop

    def begin(self, base_deg: JointVector) -> None:
        """Start a run: the controller adds corrections to these axes."""
        self._base_deg = base_deg

    def prepare(self, points: SetPoints, *, ending: bool) -> None:
        """Write the heads for the prepared points; `ending`: Stop is sent at rest."""
        if points.moving:
            self.heads = (self.head(points.go_rad, False), self.head(points.stop_rad, False))
        else:
            hold = self.head(points.last_rad, ending)
            self.heads = (hold, hold)

    def whole(self, choice: Choice, *, last_ipoc: int, reported_late: int, stop_word: int) -> PreparedReply:
        """The complete reply to the next telegram."""
        ipoc = str(last_ipoc + self._cycle_ms).encode()
        delay = str(reported_late).encode() if reported_late >= 0 else b""
        return PreparedReply((delay, ipoc), stop_word, choice, self.heads[choice] + ipoc + REPLY_TAIL)

    def head(self, joints_rad: JointVector, stop: bool) -> bytes:
        """Everything before the IPOC; corrections in deg with six decimals."""
        base = self._base_deg
        a, b, c, d, e, f = joints_rad
        return self._writer.head(
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
