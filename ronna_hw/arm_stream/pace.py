"""Reception with warm caches: the controller's schedule is learnt, and each reply rehearsed before it is due.

A process that has slept for a cycle finds cold caches, which would show as turnaround. So while the
controller keeps a pace, the process wakes up some time before the next telegram is due, runs through the
reply without any effect, and goes back to sleep. Not immediately before: the sender may need this processor.

In lock-step the next telegram follows within tens of microseconds. Falling asleep and being woken costs both
processes more than that: while the arm moves, the process stays awake for it.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

IDLE_POLL_S = 0.02  # longest wait for a telegram between checks of orders, silence and parent
AWAKE_NS = 80_000  # host time: longer than a simulated controller takes from a reply to its next telegram
STEADY_ARRIVALS = 8  # consecutive arrivals near their predictions before the next prediction is trusted
NEAR_SHARE = 0.25  # of the interval: a larger deviation means another schedule
MOST_MISSING = 25  # consecutive telegrams over which the schedule is kept
# Shares of a deviation applied to the schedule's phase and interval: two clocks never run alike.
EARLY_GAINS = (1.0, 1.0 / 32.0)
LATE_GAINS = (1.0 / 16.0, 1.0 / 256.0)
_NS = 1e9
_TIMEVAL = struct.Struct("ll")
R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)


class Line(Protocol[R_co]):
    """Connection on which telegrams arrive."""

    @property
    def is_connected(self) -> bool:
        """Whether only the stream's controller is received."""

    def has_datagram(self) -> bool:
        """Return whether something is pending, without the cost of an exception."""

    def sleep(self, limit_s: float) -> bool:
        """Sleep until something arrives; returns False on time-out."""

    def receive(self) -> R_co:
        """Receive a telegram within `IDLE_POLL_S`; raises OSError on time-out."""

    def processor(self) -> int:
        """Return the processor that received the last telegram, or -1 if unknown."""


def limit_receiving(link: socket.socket) -> None:
    """Let receiving end after `IDLE_POLL_S` without data."""
    seconds, fraction_s = divmod(IDLE_POLL_S, 1.0)
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEVAL.pack(int(seconds), int(fraction_s * 1e6)))


class PacedReceiver(Generic[R]):
    """Receiver that keeps caches warm between telegrams."""

    def __init__(
        self,
        line: Line[R],
        *,
        lead_ns: int,
        rehearse: Callable[[], None],
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Create a receiver; `rehearse` runs `lead_ns` before each telegram is due, or never if 0."""
        self._line = line
        self._lead_ns = lead_ns
        self._rehearse = rehearse
        self._now_ns = now_ns
        self._pace = Pace()
        self.keeps_pace = False  # the controller's schedule is known, or was until now
        self._lock_steps = 0  # consecutive
        self._stays_awake = False  # for the next telegram
        self.received_ns = 0  # arrival of the last telegram
        self.was_queued = False  # whether it was there before the wait began: others may be queued behind it

    def next(self) -> R | None:
        """Receive the next telegram, or return None on time-out."""
        try:
            # A controller that waits for each reply has sent nothing else: that saves a system call.
            alone = self._lock_steps > STEADY_ARRIVALS and self._line.is_connected
            self.was_queued = not alone and self._line.has_datagram()
            if alone and self._stays_awake:
                self._stay_awake()
            elif self._lead_ns and not self.was_queued:
                self._sleep_until_rehearsal()
            received = self._line.receive()
        except OSError:  # timed out, or the network reported something about an earlier reply
            return None
        self.received_ns = self._now_ns()
        return received

    def note_paced(self) -> bool:
        """Record a telegram sent at the controller's pace; returns whether the pace is known.

        Once the controller's schedule is known this stays true through a pause, until it hurries.
        """
        self._lock_steps = 0
        self._stays_awake = False
        self._pace.note_arrival(self.received_ns)
        self.keeps_pace = self.keeps_pace or self._pace.due_ns > 0
        return self.keeps_pace

    def note_lock_step(self, *, stays_awake: bool = False) -> None:
        """Record a telegram sent in immediate response to a reply, and discard the schedule.

        `stays_awake`: the next one follows at once, and its sender has another processor.
        """
        self._lock_steps += 1
        self._stays_awake = stays_awake
        self._pace.forget()
        self.keeps_pace = False

    def _stay_awake(self) -> None:
        end_ns = self._now_ns() + AWAKE_NS
        while not self._line.has_datagram() and self._now_ns() < end_ns:
            pass

    def _sleep_until_rehearsal(self) -> None:
        pause_s = (self._pace.due_ns - self._lead_ns - self._now_ns()) / _NS
        if 0.0 < pause_s < IDLE_POLL_S and not self._line.sleep(pause_s):
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
