"""A network host that reads no replies is disconnected, and its pending commands are dropped."""

from __future__ import annotations

import socket

import pytest

from sim.polaris.line.server import Connection
from sim.polaris.unit.framing import DEFAULT_LINE

READY = ((0, 0),)
MUCH = bytes(1 << 24)  # more than both sides keep for each other


@pytest.mark.hazard(34)
def test_pending_commands_of_a_host_that_reads_no_replies_are_not_executed() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as listener,
        socket.create_connection(listener.getsockname()) as host,
    ):
        unit = Connection(listener.accept()[0], patience_s=0.05)
        host.sendall(b"INIT \r" * 1000)
        assert unit.receive(READY)
        unit.send(MUCH, DEFAULT_LINE)
        assert unit.receive(READY) is None
        unit.close()
