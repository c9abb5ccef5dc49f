"""The rehearsal of the RTDE process, which acts on nobody."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from drivers.universal_robots.realtime.line import Rehearsal
from drivers.universal_robots.realtime.packages import HEAD, OUTPUT
from ronna_hw.wire.universal_robots import PackageType

PACKAGE = HEAD.pack(OUTPUT.size, PackageType.DATA, 1).ljust(OUTPUT.size, b"\0")


@pytest.fixture
def rehearsal() -> Iterator[Rehearsal]:
    rehearsal = Rehearsal()
    yield rehearsal
    rehearsal.close()


def test_a_rehearsal_leaves_nothing_in_its_socket(rehearsal: Rehearsal) -> None:
    for _ in range(100):
        rehearsal.exchange(PACKAGE)
    assert rehearsal.line.is_connected
    assert not rehearsal.line.has_datagram()


def test_nobody_can_connect_to_a_rehearsal(rehearsal: Rehearsal) -> None:
    own = rehearsal.line._socket
    assert own is not None
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(own.getsockname())


def test_without_a_connection_to_itself_nothing_is_rehearsed(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise ConnectionRefusedError

    monkeypatch.setattr("socket.socket.connect", refuse)
    rehearsal = Rehearsal()
    rehearsal.exchange(PACKAGE)
    rehearsal.close()
