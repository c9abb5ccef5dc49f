"""Line faults between host and unit, and hosts that keep the line from others."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import pytest

from ronna_hw.wire.polaris import crc16
from sim.polaris.faults import LineFaults
from sim.polaris.line import server
from sim.polaris.line.server import EndSignal, Server

if TYPE_CHECKING:
    from conftest import Bench

OKAY = b"OKAYA896\r"
NO_HANDLES = b"001414\r"
SILENT_HOST_S = 0.2
HANG_GUARD_S = 30.0


def happen(bench: Bench, *lines: str) -> LineFaults:
    bench.world.set_fault_script("\n".join(f"at 0 s: tracker {line}" for line in lines))
    return LineFaults(bench.unit)


def with_crc(text: str) -> bytes:
    return f"{text}{crc16(text.encode()):04X}".encode()


def conversation(bench: Bench, faults: LineFaults, line: bytes) -> bytes:
    """What a host hears when it sends one line."""
    heard = faults.to_unit(line)
    return faults.to_host(heard, bench.interpreter.reply(heard))


def test_a_good_line_changes_nothing(bench: Bench) -> None:
    assert conversation(bench, LineFaults(bench.unit), b"INIT ") == OKAY


def test_a_bit_error_in_a_command_with_crc_is_refused_and_has_no_effect(bench: Bench) -> None:
    faults = happen(bench, "garble commands 100 %")
    line = with_crc("TSTART:")  # its CRC 5423 has no letters, whose case would not matter
    answers = {conversation(bench, faults, line)[:7] for _ in range(200)}
    # a hit colon is no separator any more, and the name is unknown
    assert answers == {b"ERROR04", b"ERROR01"}
    happen(bench)
    assert bench.send("TX ") == "ERROR0C"


def test_a_bit_error_in_a_command_without_crc_gives_an_unknown_name_or_a_bad_argument(bench: Bench) -> None:
    faults = happen(bench, "garble commands 100 %")
    answers = {conversation(bench, faults, b"PHSR 00")[:7] for _ in range(300)}
    assert {b"ERROR01", b"ERROR23"} <= answers


def test_a_garbled_reply_differs_in_exactly_one_bit(bench: Bench) -> None:
    faults = happen(bench, "garble replies 100 %")
    for _ in range(200):
        heard = conversation(bench, faults, b"PHSR 00")
        assert len(heard) == len(NO_HANDLES)
        differing = [
            sent ^ received for sent, received in zip(NO_HANDLES, heard, strict=True) if sent != received
        ]
        assert len(differing) == 1
        assert differing[0].bit_count() == 1


@pytest.mark.parametrize(("fault", "change"), [("drop bytes", -1), ("double bytes", 1)])
def test_a_byte_of_a_reply_is_lost_or_doubled(bench: Bench, fault: str, change: int) -> None:
    faults = happen(bench, f"{fault} 100 %")
    for _ in range(50):
        assert len(conversation(bench, faults, b"INIT ")) == len(OKAY) + change


def test_a_reply_is_truncated_or_lost(bench: Bench) -> None:
    faults = happen(bench, "cut replies 100 %")
    heard = {conversation(bench, faults, b"INIT ") for _ in range(100)}
    assert heard == {OKAY[:count] for count in range(len(OKAY))}
    faults = happen(bench, "lose replies 100 %")
    assert conversation(bench, faults, b"INIT ") == b""


def test_a_fault_affects_its_share_of_replies_reproducibly(bench: Bench) -> None:
    def broken() -> list[bool]:
        faults = happen(bench, "garble replies 20 %")
        return [conversation(bench, faults, b"INIT ") != OKAY for _ in range(500)]

    first = broken()
    assert 0.15 < sum(first) / len(first) < 0.25
    assert broken() == first


def test_theatre_time_passes_while_a_host_waits_for_a_lost_reply(bench: Bench) -> None:
    bench.world.set_fault_script("at 0 s: tracker lose replies 100 % for 5 s")
    faults = LineFaults(bench.unit)
    heard = []
    for _ in range(5):
        heard.append(conversation(bench, faults, b"PHSR 00"))  # a host gives it 2 s
    assert heard == [b"", b"", b"", NO_HANDLES, NO_HANDLES]


def test_a_delayed_reply_still_arrives(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    slept: list[float] = []
    monkeypatch.setattr("sim.polaris.faults.time.sleep", slept.append)
    faults = happen(bench, "delay replies 3 s")
    began_s = bench.world.clock.now_s()
    assert conversation(bench, faults, b"INIT ") == OKAY
    assert slept == [3.0]
    assert bench.world.clock.now_s() - began_s == pytest.approx(3.0)


@pytest.fixture
def host(make_bench: Callable[..., Bench]) -> Iterator[tuple[Bench, socket.socket]]:
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
    happen(bench, "double bytes 100 %")
    connection.sendall(b"INIT \r")
    assert len(read_until(connection, b"\r")) >= len(OKAY)
    happen(bench)
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
