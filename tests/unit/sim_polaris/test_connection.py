"""A host on the network that reads no replies is gone, and so is what it had asked for."""

from __future__ import annotations

import socket

import pytest

from sim.polaris.line.channel import Connection
from sim.polaris.line.line_settings import DEFAULT_LINE

READY = ((0, 0),)
MUCH = bytes(1 << 24)  # more than both sides keep for each other


@pytest.mark.hazard(34)
def test_what_a_host_had_sent_that_reads_nothing_is_not_carried_out() -> None:
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
