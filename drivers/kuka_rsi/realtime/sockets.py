"""Link sockets and telegram reception with warm caches.

A process that has slept for a cycle finds cold caches, which would show as turnaround. So while the
controller keeps a pace, the process wakes up some time before the next telegram is due, runs through the
reply without any effect, and goes back to sleep. Not immediately before: the sender may need this processor.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import termios
import time
from collections.abc import Callable
from fcntl import ioctl

from drivers.kuka_rsi.realtime.telegram import LONGEST_TELEGRAM

IDLE_POLL_S = 0.01  # longest wait for a telegram between checks of orders, silence and parent
ANY_HOST = "0.0.0.0"
Address = tuple[str, int]
Received = tuple[bytes, Address]
STEADY_ARRIVALS = 8  # consecutive arrivals near their predictions before the next prediction is trusted
NEAR_SHARE = 0.25  # of the interval: a larger deviation means another schedule
MOST_MISSING = 25  # consecutive telegrams over which the schedule is kept
# Shares of a deviation applied to the schedule's phase and interval: two clocks never run alike.
EARLY_GAINS = (1.0, 1.0 / 32.0)
LATE_GAINS = (1.0 / 16.0, 1.0 / 256.0)
_NO_BYTES = struct.pack("i", 0)
_TIMEVAL = struct.Struct("ll")
_NS = 1e9


def bind(host: str, port: int) -> socket.socket:
    """Open the receiving socket without address reuse; a second listener would steal telegrams."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        link.bind((host, port))
    except OSError:
        link.close()
        raise
    _set_receive_timeout(link)
    return link


class LinkSockets:
    """Unconnected link socket, plus one connected to the controller during a stream.

    A connected socket receives only what its peer sends: no foreign datagram gets between a telegram and its
    reply. The kernel also records which processor received the last one.
    """

    def __init__(self, listening: socket.socket) -> None:
        self._listening = listening
        self._line = listening  # the socket that telegrams arrive on now
        self._peer: Address | None = None  # only while the stream has its own socket

    @property
    def is_connected(self) -> bool:
        """Whether only the stream's controller is received."""
        return self._peer is not None

    def connect_to(self, peer: Address) -> None:
        """Open the stream socket connected to this controller."""
        self.disconnect()
        own: Address = self._listening.getsockname()
        if own[0] == ANY_HOST:
            return  # the controller may send to another of our addresses than the kernel would choose
        line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        # Both must permit it now, and neither afterwards: no one else can bind.
        try:
            for each in (self._listening, line):
                each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            line.bind(own)
            line.connect(peer)
            _set_receive_timeout(line)
        except OSError:
            line.close()
        else:
            line.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
            self._line, self._peer = line, peer
        finally:
            self._listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)

    def disconnect(self) -> None:
        """Close the stream socket, so that any sender is received again."""
        if self._peer is not None:
            self._line.close()
            self._line, self._peer = self._listening, None

    def receive(self, flags: int = 0) -> Received:
        """Receive a datagram; raises OSError on time-out or if a reply was refused."""
        if self._peer is not None:  # cheaper than receiving the address each time
            return self._line.recv(LONGEST_TELEGRAM, flags), self._peer
        received: Received = self._line.recvfrom(LONGEST_TELEGRAM, flags)
        return received

    def send(self, reply: bytes, address: Address) -> None:
        """Send a reply; raises OSError."""
        if self._peer is not None:
            self._line.send(reply)
        else:
            self._line.sendto(reply, address)

    def sleep(self, limit_s: float) -> bool:
        """Sleep until a datagram arrives; returns False on time-out."""
        return bool(select.select((self._line,), (), (), limit_s)[0])

    def has_datagram(self) -> bool:
        """Return whether a datagram is pending, without the cost of an exception."""
        return ioctl(self._line, termios.FIONREAD, _NO_BYTES) != _NO_BYTES

    def foreign_sender(self) -> Address | None:
        """Discard a datagram from outside the stream and return its sender, if there is one."""
        if self._peer is None or ioctl(self._listening, termios.FIONREAD, _NO_BYTES) == _NO_BYTES:
            return None
        try:
            address: Address = self._listening.recvfrom(1, socket.MSG_DONTWAIT)[1]
        except OSError:
            return None
        return address

    def processor(self) -> int:
        """Return the processor that received the last telegram, or -1 if unknown."""
        return self._line.getsockopt(socket.SOL_SOCKET, socket.SO_INCOMING_CPU) if self._peer else -1


def _set_receive_timeout(link: socket.socket) -> None:
    seconds, fraction_s = divmod(IDLE_POLL_S, 1.0)
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEVAL.pack(int(seconds), int(fraction_s * 1e6)))


class TelegramReceiver:
    """Receiver that keeps caches warm between telegrams."""

    def __init__(
        self,
        sockets: LinkSockets,
        *,
        lead_ns: int,
        rehearse: Callable[[], None],
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Create a receiver; `rehearse` runs `lead_ns` before each telegram is due, or never if 0."""
        self._sockets = sockets
        self._lead_ns = lead_ns
        self._rehearse = rehearse
        self._now_ns = now_ns
        self._pace = Pace()
        self._keeps_pace = False
        self._lock_steps = 0  # consecutive
        self.received_ns = 0  # arrival of the last telegram
        self.was_queued = False  # whether it was there before the wait began: others may be queued behind it

    def next(self) -> Received | None:
        """Receive the next datagram from any sender, or return None on time-out."""
        try:
            # A controller that waits for each reply has sent nothing else: that saves a system call.
            alone = self._lock_steps > STEADY_ARRIVALS and self._sockets.is_connected
            self.was_queued = not alone and self._sockets.has_datagram()
            if self._lead_ns and not self.was_queued:
                self._sleep_until_rehearsal()
            received = self._sockets.receive()
        except OSError:  # timed out, or the network reported something about an earlier reply
            return None
        self.received_ns = self._now_ns()
        return received

    def note_paced(self) -> bool:
        """Record a datagram sent at the controller's pace; returns whether the pace is known.

        Once the controller's schedule is known this stays true through a pause, until it hurries.
        """
        self._lock_steps = 0
        self._pace.note_arrival(self.received_ns)
        self._keeps_pace = self._keeps_pace or self._pace.due_ns > 0
        return self._keeps_pace

    def note_lock_step(self) -> None:
        """Record a datagram sent in immediate response to a reply, and discard the schedule."""
        self._lock_steps += 1
        self._pace.forget()
        self._keeps_pace = False

    def _sleep_until_rehearsal(self) -> None:
        pause_s = (self._pace.due_ns - self._lead_ns - self._now_ns()) / _NS
        if 0.0 < pause_s < IDLE_POLL_S and not self._sockets.sleep(pause_s):
            self._rehearse()


class Pace:
    """Estimator of the controller's sending schedule; host times in ns.

    The pace is learnt from arrivals alone. A telegram may be delayed on its way, but never arrives before it
    was sent: an early one corrects the schedule at once, a late one only slightly.
    """

    def __init__(self) -> None:
        self._scheduled_ns = 0.0  # scheduled time of the last arrival
        self._interval_ns = 0.0
        self._steady = 0

    @property
    def due_ns(self) -> int:
        """Expected time of the next telegram if not delayed, ns; 0 without a known schedule."""
        return int(self._scheduled_ns + self._interval_ns) if self._steady >= STEADY_ARRIVALS else 0

    def note_arrival(self, now_ns: int) -> None:
        """Record the arrival of a telegram."""
        gap_ns, interval_ns = now_ns - self._scheduled_ns, self._interval_ns
        steps = round(gap_ns / interval_ns) if interval_ns else 0
        off_ns = gap_ns - steps * interval_ns
        if not 1 <= steps <= MOST_MISSING + 1 or abs(off_ns) > NEAR_SHARE * interval_ns:
            self._steady, self._scheduled_ns, self._interval_ns = 0, float(now_ns), float(gap_ns)
            return
        self._steady += 1
        phase_gain, interval_gain = LATE_GAINS if off_ns > 0.0 else EARLY_GAINS
        self._scheduled_ns = now_ns - (1.0 - phase_gain) * off_ns
        self._interval_ns += interval_gain * off_ns / steps

    def forget(self) -> None:
        """Discard the schedule."""
        self._steady, self._interval_ns = 0, 0.0


class Rehearsal:
    """Dry run of sending and receiving on a loopback socket connected to itself."""

    def __init__(self) -> None:
        self._own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._own.bind(("127.0.0.1", 0))
        self._own.connect(self._own.getsockname())

    def exchange(self, data: bytes) -> None:
        """Send and receive a datagram through the same calls as a real exchange."""
        with contextlib.suppress(OSError):  # nothing depends on it
            self._own.send(data)
            self._own.recv(LONGEST_TELEGRAM, socket.MSG_DONTWAIT)

    def close(self) -> None:
        """Close the socket."""
        self._own.close()
