"""Takes telegrams from the socket, awake when one is due.

A processor that has nothing to do is halted, and its caches grow cold: both would be paid for in the
turnaround, several times what the reply itself costs. So the process sleeps until shortly before the next
telegram is due, then asks the socket again and again, and goes to sleep when none has come for as long after.

It does so only while the controller keeps a pace. When it is in vain too often it leaves off for a while,
each time for longer: whoever sends, or other work, may be waiting for this very processor.
"""

from __future__ import annotations

import select
import socket
import struct
import termios
import time
from collections.abc import Callable
from fcntl import ioctl

from drivers.kuka_rsi.pace import Pace
from drivers.kuka_rsi.telegram import LONGEST_TELEGRAM

IDLE_LOOK_S = 0.01  # how long to wait for a telegram before looking at orders, silence and parent
VAIN_COST = 4  # telegrams awaited with success that make up for one in vain
MOST_COST = 6 * VAIN_COST
COST_ON_TRIAL = MOST_COST // 2  # at first and after a rest: half as many in vain are enough
REST_TELEGRAMS = 1_000  # slept for at first (4 s at 4 ms), then twice as many, ...
LONGEST_REST = 32_000
GOOD_TELEGRAMS = 1_000  # awaited without a rest: the next one is short again
_NS = 1e9
_NO_BYTES = struct.pack("i", 0)
_TIMEVAL = struct.Struct("ll")

Address = tuple[str, int]
Received = tuple[bytes, Address]


def bind(host: str, port: int) -> socket.socket:
    """The socket that the controller sends to. No address reuse: a second listener would take telegrams."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        link.bind((host, port))
    except OSError:
        link.close()
        raise
    seconds, rest = divmod(IDLE_LOOK_S, 1.0)
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEVAL.pack(int(seconds), int(rest * 1e6)))
    return link


def readable(link: socket.socket, limit_s: float) -> bool:
    """Sleep until something lies in the socket; False when nothing has come in time."""
    return bool(select.select((link,), (), (), limit_s)[0])


def something_in(link: socket.socket) -> bool:
    """Whether a datagram lies in the socket. Cheaper than the exception of an empty one."""
    return ioctl(link, termios.FIONREAD, _NO_BYTES) != _NO_BYTES


class Reception:
    """Waits for one telegram after the other."""

    def __init__(
        self,
        link: socket.socket,
        *,
        lead_ns: int,
        rehearse: Callable[[], None],
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[socket.socket, float], bool] = readable,
        lies_there: Callable[[socket.socket], bool] = something_in,
    ) -> None:
        """Awake from `lead_ns` before a telegram is due until as long after; 0 is never.

        `rehearse` is called once before that: it runs through the reply without any effect.
        """
        self._link = link
        self._lead_ns = lead_ns
        self._rehearse = rehearse
        self._now_ns = now_ns
        self._sleep = sleep
        self._lies_there = lies_there
        self._pace = Pace()
        self._cost = COST_ON_TRIAL
        self._good = 0  # telegrams awaited since the last rest
        self._rest = REST_TELEGRAMS
        self._resting = 0  # telegrams still to be slept for
        self.received_ns = 0  # when the last telegram was there
        self.waited_ns = 0  # for it
        self.queued = False  # whether it was there before anybody waited: others may be behind it

    def next(self) -> Received | None:
        """The next datagram, from whomever, or None when none came for a while."""
        begun_ns = self._now_ns()
        try:
            self.queued = self._lies_there(self._link)
            received = self._awake(begun_ns) if self._lead_ns and not self.queued else None
            if received is None:
                received = self._link.recvfrom(LONGEST_TELEGRAM)
        except OSError:  # the time ran out, or the network said something about an earlier reply
            return None
        self.received_ns = received_ns = self._now_ns()
        self.waited_ns = received_ns - begun_ns
        return received

    def paced(self) -> None:
        """The last datagram was a telegram of the session, a whole cycle after the one before."""
        self._pace.arrived(self.received_ns)
        if self._resting:
            self._resting -= 1

    def hurried(self) -> None:
        """It was one that followed as soon as the reply was out: nobody keeps a pace."""
        self._pace.forget()

    def _awake(self, now_ns: int) -> Received | None:
        """What comes while the process stays awake for it, or None."""
        due_ns = self._pace.due_ns
        until_due_ns = due_ns - now_ns
        lead_ns = self._lead_ns
        if self._resting or not -lead_ns < until_due_ns < IDLE_LOOK_S * _NS:
            return None
        if until_due_ns > lead_ns and self._sleep(self._link, (until_due_ns - lead_ns) / _NS):
            return None  # it has come early: it is taken as usual
        self._rehearse()
        end_ns = due_ns + lead_ns
        link, clock, at_once = self._link, self._now_ns, socket.MSG_DONTWAIT
        while True:
            try:
                received: Received = link.recvfrom(LONGEST_TELEGRAM, at_once)
            except BlockingIOError:
                if clock() < end_ns:
                    continue
                break
            self._came_in_time()
            return received
        self._came_not()
        return None

    def _came_in_time(self) -> None:
        if self._cost:
            self._cost -= 1
        self._good += 1
        if self._good == GOOD_TELEGRAMS:
            self._rest = REST_TELEGRAMS

    def _came_not(self) -> None:
        self._cost += VAIN_COST
        if self._cost >= MOST_COST:
            self._resting, self._rest = self._rest, min(2 * self._rest, LONGEST_REST)
            self._cost, self._good = COST_ON_TRIAL, 0
