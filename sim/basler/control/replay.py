"""Keeps the last acknowledges, so that a repeated command is acknowledged again but not executed again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from sim.basler.control.privilege import Peer

PEERS_KEPT = 16
KEPT_S = 3.0  # clients retry after 0.2 to 0.5 s, up to five times


@dataclass(frozen=True)
class Answered:
    """A command and its answer; None if it required none."""

    datagram: bytes
    answer: bytes | None
    at_s: float


class ReplayCache:
    """The last modifying command of each application. `now_s` is the host's monotonic clock."""

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._last: OrderedDict[Peer, Answered] = OrderedDict()

    def find(self, peer: Peer, datagram: bytes) -> Answered | None:
        """The answer given to this very command (including request id), if it was the last one."""
        last = self._last.get(peer)
        if last is None or last.datagram != datagram or self._now_s() - last.at_s > KEPT_S:
            return None
        return last

    def keep(self, peer: Peer, datagram: bytes, answer: bytes | None) -> None:
        """Store an answer."""
        self._last[peer] = Answered(datagram, answer, self._now_s())
        self._last.move_to_end(peer)
        while len(self._last) > PEERS_KEPT:
            self._last.popitem(last=False)
