"""Receives telegrams from the socket, with warm caches when one is due.

A process that has slept for a cycle finds cold caches, which would show as turnaround. So while the
controller keeps a pace, it wakes up once some time before the next telegram is due, runs through the reply
without any effect, and goes back to sleep. Not immediately before: the sender may need this very processor.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from drivers.kuka_rsi.realtime.pace import Pace
from drivers.kuka_rsi.realtime.sockets import IDLE_LOOK_S, LinkSockets, Received

_NS = 1e9


class TelegramReceiver:
    """Waits for one telegram after another."""

    def __init__(
        self,
        sockets: LinkSockets,
        *,
        lead_ns: int,
        rehearse: Callable[[], None],
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """`rehearse` is called `lead_ns` before a telegram is due; 0 is never."""
        self._sockets = sockets
        self._lead_ns = lead_ns
        self._rehearse = rehearse
        self._now_ns = now_ns
        self._pace = Pace()
        self._keeps_pace = False
        self.received_ns = 0  # arrival of the last telegram
        self.queued = False  # whether it was there before the wait began: others may be queued behind it

    def next(self) -> Received | None:
        """The next datagram, from any sender, or None if none arrived for a while."""
        try:
            self.queued = self._sockets.something_there()
            if self._lead_ns and not self.queued:
                self._await_the_moment()
            received = self._sockets.receive()
        except OSError:  # timed out, or the network reported something about an earlier reply
            return None
        self.received_ns = self._now_ns()
        return received

    def paced(self) -> bool:
        """The last datagram was a telegram of the stream, a whole cycle after the previous one.

        Once the controller's schedule is known this stays true through a pause, until it hurries.
        """
        self._pace.arrived(self.received_ns)
        self._keeps_pace = self._keeps_pace or self._pace.due_ns > 0
        return self._keeps_pace

    def hurried(self) -> None:
        """It followed as soon as the reply was out: lock-step, so there is no schedule."""
        self._pace.forget()
        self._keeps_pace = False

    def _await_the_moment(self) -> None:
        pause_s = (self._pace.due_ns - self._lead_ns - self._now_ns()) / _NS
        if 0.0 < pause_s < IDLE_LOOK_S and not self._sockets.sleep(pause_s):
            self._rehearse()
