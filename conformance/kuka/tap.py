"""Tap between a KUKA controller and its driver that logs all traffic and can hold back telegrams.

It modifies and invents nothing; a stalled computer or network also delays telegrams.
"""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from conformance.disturbed_line import DisturbedLine, LineThread
from ronna_hw.endpoints import Endpoint

MOST_BYTES = 65536
POLL_S = 0.02
LOOPBACK = "127.0.0.1"


@dataclass
class Traffic:
    """Telegrams received by the driver and its replies, each in order."""

    telegrams: list[bytes] = field(default_factory=list)
    replies: list[bytes] = field(default_factory=list)


class RsiTap(LineThread):
    """Tap that receives in the driver's place and forwards to the driver's port."""

    def __init__(self, controller_sends_to: Endpoint, driver: Endpoint) -> None:
        super().__init__("RSI tap")
        self._driver = (driver.host, driver.port)
        self._outside = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._outside.bind((controller_sends_to.host, controller_sends_to.port))
        self._inside = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._inside.bind((LOOPBACK, 0))
        self._controller: tuple[str, int] | None = None
        self._held: list[bytes] = []
        self._holding = False
        self._lock = threading.Lock()
        self._traffic = Traffic()

    def take_traffic(self) -> Traffic:
        with self._lock:
            passed, self._traffic = self._traffic, Traffic()
        return passed

    @property
    def replies(self) -> int:
        """Number of replies since the last `take_traffic`."""
        return len(self._traffic.replies)

    @property
    def held_count(self) -> int:
        return len(self._held)

    def hold(self) -> None:
        self._holding = True

    def release(self) -> None:
        """Forward all held telegrams in one burst."""
        with self._lock:
            held, self._held = self._held, []
            self._holding = False
            self._traffic = Traffic(telegrams=held)
            for telegram in held:
                self._inside.sendto(telegram, self._driver)

    def discard(self) -> None:
        with self._lock:
            self._held.clear()
            self._holding = False

    def _close(self) -> None:
        self._outside.close()
        self._inside.close()

    def _serve(self) -> None:
        while not self._ended:
            ready, _, _ = select.select([self._outside, self._inside], [], [], POLL_S)
            for end in ready:
                try:
                    data, sender = end.recvfrom(MOST_BYTES)
                except OSError:  # the driver's socket is not open yet, or has been closed
                    continue
                with self._lock:
                    if end is self._outside:
                        self._from_controller(data, sender)
                    else:
                        self._from_driver(data)

    def _from_controller(self, telegram: bytes, sender: tuple[str, int]) -> None:
        self._controller = sender
        if self._holding:
            self._held.append(telegram)
            return
        self._traffic.telegrams.append(telegram)
        self._inside.sendto(telegram, self._driver)

    def _from_driver(self, reply: bytes) -> None:
        self._traffic.replies.append(reply)
        if self._controller is not None:
            self._outside.sendto(reply, self._controller)


class PiecewiseLine(DisturbedLine):
    """Line that delivers the device's bytes one by one, or several elements at once."""

    gather_s = 0.0  # bytes within this time arrive together

    def __init__(self, device: Endpoint) -> None:
        super().__init__(device)
        self.sent_data: list[bytes] = []  # data from the driver, read by read

    def _note_command(self, data: bytes) -> None:
        self.sent_data.append(data)

    def _disturb(self, data: bytes) -> list[tuple[float, bytes]]:
        if self.gather_s:
            return [(self.gather_s, data)]
        return [(0.0, data[at : at + 1]) for at in range(len(data))]


def wait_for(condition: Callable[[], bool], limit_s: float) -> bool:
    """Return whether a condition becomes true within the time limit."""
    until_s = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > until_s:
            return False
        time.sleep(POLL_S / 4)
    return True
