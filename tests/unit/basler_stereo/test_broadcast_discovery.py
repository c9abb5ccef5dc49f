"""Broadcast discovery ends by the clock, whatever arrives."""

from __future__ import annotations

import itertools
import select
import socket
import time
from typing import Any

import pytest

from drivers.basler_stereo.control.broadcast_discovery import discover_cameras
from ronna_hw.host.network import Interface

LIMIT_S = 0.5
A_DATAGRAM_S = 0.1  # what each takes by this test's clock
MOST_READ = 10


class FloodedSocket(socket.socket):
    """From which there is always a datagram to read that is no camera's reply."""

    read = 0

    def sendto(self, *_: Any) -> int:
        return 0

    def recvfrom(self, *_: Any) -> tuple[bytes, tuple[str, int]]:
        FloodedSocket.read += 1
        assert FloodedSocket.read <= MOST_READ, "discovery goes on after its time"
        return b"flood", ("127.0.0.1", 9)


def test_a_flood_of_datagrams_does_not_prolong_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = itertools.count(0.0, A_DATAGRAM_S)
    monkeypatch.setattr(socket, "socket", FloodedSocket)
    monkeypatch.setattr(select, "select", lambda readers, *_: (readers, [], []))
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    assert discover_cameras(Interface("lo", "127.0.0.1", 8, 0), LIMIT_S) == ()
    assert FloodedSocket.read < LIMIT_S / A_DATAGRAM_S
