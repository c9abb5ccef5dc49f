"""Stands on the wire between a robot controller and the arm's driver, passes everything on and looks."""

from __future__ import annotations

import re
import select
import socket
import threading
from collections.abc import Callable, Sequence

from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.network import own_udp_endpoint

LOOK_S = 0.05  # between two looks whether to end
DATAGRAM_BYTES = 4096
LOOPBACK = "127.0.0.1"
BEHIND_THE_TAP = 1  # the controller sends to number 0 of this process
DELAY = re.compile(rb'<Delay D="(\d+)"/>')
CORRECTIONS = re.compile(
    rb'<AK A1="([^"]+)" A2="([^"]+)" A3="([^"]+)" A4="([^"]+)" A5="([^"]+)" A6="([^"]+)"'
)


class RsiTap:
    """Give the driver `endpoint` to listen on. In lock-step the world stands still at each look."""

    def __init__(
        self,
        controller_sends_to: str,
        look: Callable[[], Sequence[float]],
        *,
        late: bool = False,
        never: bool = False,
    ) -> None:
        """`look` is called with each telegram.

        `late`: the count of lost replies is told a telegram late. `never`: it is told as none.
        """
        self._front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._front.bind(_address(controller_sends_to))
        self._back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._back.bind((LOOPBACK, 0))
        self.endpoint = own_udp_endpoint(BEHIND_THE_TAP)
        self._driver = _address(self.endpoint)
        self._look = look
        self._late, self._never = late, never
        self.seen: list[Sequence[float]] = []  # what `look` gave, one per cycle
        self.acting_deg: list[Sequence[float]] = []  # the corrections that acted in each cycle
        self._sent_deg: Sequence[float] = (0.0,) * 6
        self.lost = 0  # replies, by the controller's count
        self.on_cycle: Callable[[], None] | None = None  # called with each telegram, after looking
        self._controller: tuple[str, int] | None = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._pass_on)
        self._thread.start()

    def close(self) -> None:
        self._ending.set()
        self._thread.join()
        self._front.close()
        self._back.close()

    def _pass_on(self) -> None:
        while not self._ending.is_set():
            for ready in select.select((self._front, self._back), (), (), LOOK_S)[0]:
                data, sender = ready.recvfrom(DATAGRAM_BYTES)
                if ready is self._front:
                    self._controller = sender
                    self._back.sendto(self._telegram(data), self._driver)
                elif self._controller is not None:
                    found = CORRECTIONS.search(data)
                    assert found is not None
                    self._sent_deg = tuple(float(value) for value in found.groups())
                    self._front.sendto(data, self._controller)

    def _telegram(self, data: bytes) -> bytes:
        found = DELAY.search(data)
        assert found is not None
        before, self.lost = self.lost, int(found[1])
        taken = self.lost == before or not self.acting_deg
        self.acting_deg.append(self._sent_deg if taken else self.acting_deg[-1])
        self.seen.append(self._look())
        if self.on_cycle is not None:
            self.on_cycle()
        said = 0 if self._never else before if self._late else self.lost
        return data[: found.start(1)] + str(said).encode() + data[found.end(1) :]


def _address(endpoint: str) -> tuple[str, int]:
    parsed = parse_endpoint(endpoint)
    return parsed.host, parsed.port
