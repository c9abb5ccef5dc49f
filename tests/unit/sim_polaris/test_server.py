"""The server: hosts one after another, silent ones yield, faults and resets reach an open connection."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator

import pytest
from polaris_bench import Bench, MakeBench

from sim.polaris.line import server
from sim.polaris.line.server import EndSignal, HostConnection, Server
from sim.polaris.unit.framing import DEFAULT_LINE

OKAY = b"OKAYA896\r"
SILENT_HOST_S = 0.2
HANG_GUARD_S = 30.0


@pytest.fixture
def host(make_bench: MakeBench) -> Iterator[tuple[Bench, socket.socket]]:
    """A unit behind its server, and a host connected to it."""
    bench = make_bench(reset_s=0.0, silent_host_s=SILENT_HOST_S)
    end = EndSignal()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        server = threading.Thread(target=Server(bench.interpreter, end).serve_network, args=(listener,))
        server.start()
        with socket.create_connection(listener.getsockname(), timeout=HANG_GUARD_S) as connection:
            yield bench, connection
        end.give()
        server.join(HANG_GUARD_S)
        assert not server.is_alive()


def read_until(connection: socket.socket, ending: bytes) -> bytes:
    received = b""
    while not received.endswith(ending):
        received += connection.recv(4096)
    return received


@pytest.mark.parametrize("drip", [b"", b"INIT"])
def test_a_host_that_sends_no_command_is_dropped_for_a_waiting_one(
    host: tuple[Bench, socket.socket], drip: bytes
) -> None:
    _, silent = host
    with socket.create_connection(silent.getpeername(), timeout=HANG_GUARD_S) as waiting:
        silent.sendall(drip)
        waiting.sendall(b"INIT \r")
        assert read_until(waiting, b"\r") == OKAY
        assert silent.recv(1) == b""


@pytest.fixture
def no_other_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "SEND_PATIENCE_S", 10 * HANG_GUARD_S)


@pytest.mark.hazard(34)
def test_a_host_that_reads_no_replies_is_dropped_for_a_waiting_one(
    no_other_patience: None, host: tuple[Bench, socket.socket]
) -> None:
    _, deaf = host
    deaf.settimeout(SILENT_HOST_S)
    with contextlib.suppress(TimeoutError):
        deaf.sendall(b"GET *\r" * 3000)  # more is answered than both sides keep
    with socket.create_connection(deaf.getpeername(), timeout=HANG_GUARD_S) as waiting:
        waiting.sendall(b"INIT \r")
        assert read_until(waiting, b"\r") == OKAY


@pytest.mark.hazard(34)
def test_a_host_that_sends_only_refused_commands_is_dropped_for_a_waiting_one(
    host: tuple[Bench, socket.socket],
) -> None:
    _, babbling = host

    def babble() -> None:
        with contextlib.suppress(OSError):
            while True:
                babbling.sendall(b"no command\r" * 10)
                if not babbling.recv(4096):
                    return

    with socket.create_connection(babbling.getpeername(), timeout=HANG_GUARD_S) as waiting:
        thread = threading.Thread(target=babble)
        thread.start()
        try:
            waiting.sendall(b"INIT \r")
            assert read_until(waiting, b"\r") == OKAY
        finally:
            with contextlib.suppress(OSError):  # it was hung up on
                babbling.shutdown(socket.SHUT_RDWR)
            thread.join(HANG_GUARD_S)


def test_a_silent_host_keeps_the_line_while_no_other_host_waits(host: tuple[Bench, socket.socket]) -> None:
    _, silent = host
    silent.settimeout(2 * SILENT_HOST_S)
    with pytest.raises(TimeoutError):
        silent.recv(1)
    silent.settimeout(HANG_GUARD_S)
    silent.sendall(b"INIT \r")
    assert read_until(silent, b"\r") == OKAY


def test_faults_take_effect_on_an_open_connection(host: tuple[Bench, socket.socket]) -> None:
    bench, connection = host
    connection.sendall(b"INIT \r")
    assert read_until(connection, b"\r") == OKAY
    bench.world.set_fault_script("at 0 s: tracker double bytes 100 %")
    connection.sendall(b"INIT \r")
    assert len(read_until(connection, b"\r")) >= len(OKAY)
    bench.world.set_fault_script("")
    connection.sendall(b"INIT \r")
    assert read_until(connection, OKAY).endswith(OKAY)


def test_a_unit_sends_reset_unprompted_when_its_power_returns(host: tuple[Bench, socket.socket]) -> None:
    bench, connection = host
    connection.sendall(b"INIT \r")
    assert read_until(connection, b"\r") == OKAY
    bench.world.set_fault_script("at 0 s: tracker power off for 3 s")
    connection.sendall(b"VER 4\r")  # never answered; in theatre time a host waits 2 s for it
    connection.sendall(b"VER 4\r")
    assert read_until(connection, b"\r") == b"RESETBE6F\r"
    connection.sendall(b"TX \r")
    assert read_until(connection, b"\r").startswith(b"ERROR10")


READY = ((0, 0),)
MUCH = bytes(1 << 24)  # more than both sides keep for each other


@pytest.mark.hazard(34)
def test_pending_commands_of_a_host_that_reads_no_replies_are_not_executed() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as listener,
        socket.create_connection(listener.getsockname()) as host,
    ):
        unit = HostConnection(listener.accept()[0], patience_s=0.05)
        host.sendall(b"INIT \r" * 1000)
        assert unit.receive(READY)
        unit.send(MUCH, DEFAULT_LINE)
        assert unit.receive(READY) is None
        unit.close()
