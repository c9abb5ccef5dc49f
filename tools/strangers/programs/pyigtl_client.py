"""pyigtl as a client of messages composed after the standard, each with its right check sum."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Sequence
from typing import Any

import pyigtl  # type: ignore[import-untyped]
from simulated_peer import eventually

LIMIT_S = 3.0
HEADER = struct.Struct(">H12s20sIIQQ")
CRC_POLYNOMIAL, CRC_MASK = 0x42F0E1EBA9EA3693, (1 << 64) - 1  # ECMA-182
IDENTITY = struct.pack(">12f", 1, 0, 0, 0, 1, 0, 0, 0, 1, 10, 20, 30)
ENTRY, TARGET = (0.0, 0.0, 0.0), (1.0, 2.0, 3.0)
TRAJECTORY = struct.pack(
    ">64s32sBB4B3f3ff20s", b"left", b"Plan", 3, 0, 255, 0, 0, 255, *ENTRY, *TARGET, 1.5, b""
)


def message(kind: str, body: bytes, name: str = "Tool", check_sum: int | None = None) -> bytes:
    sum_of_body = crc(body) if check_sum is None else check_sum
    return HEADER.pack(1, kind.encode(), name.encode(), 1_700_000_000, 0, len(body), sum_of_body) + body


def crc(body: bytes) -> int:
    value = 0
    for byte in body:
        value ^= byte << 56
        for _ in range(8):
            value = (value << 1 ^ (CRC_POLYNOMIAL if value >> 63 else 0)) & CRC_MASK
    return value


class Sender:
    """A server of one client: sends the parts one after the other, and keeps the connection until `close`."""

    def __init__(self, *parts: bytes) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._connection: socket.socket | None = None
        threading.Thread(target=self._serve, args=(parts,), daemon=True).start()

    def _serve(self, parts: Sequence[bytes]) -> None:
        self._connection, _ = self._listener.accept()
        self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for part in parts:
            self._connection.sendall(part)
            threading.Event().wait(0.1)  # each part in a packet of its own

    def close(self) -> None:
        self._listener.close()
        if self._connection is not None:
            self._connection.close()


def received(*parts: bytes, name: str = "Tool") -> Any:
    client = pyigtl.OpenIGTLinkClient("127.0.0.1", Sender(*parts).port)
    return client.wait_for_message(name, timeout=LIMIT_S)


def reads_a_transform() -> None:
    assert received(message("TRANSFORM", IDENTITY)).matrix[0, 3] == 10.0


def reads_a_text() -> None:
    assert received(message("STRING", struct.pack(">HH", 3, 4) + b"HOLD")).string == "HOLD"


def reads_points() -> None:
    body = struct.pack(">64s32s4B3ff20s", b"S1", b"Spheres", 255, 0, 0, 255, 1, 2, 3, 5, b"")
    assert received(message("POINT", body)).positions[0] == (1.0, 2.0, 3.0)


def reads_a_status() -> None:
    body = struct.pack(">Hq20s", 13, 0, b"TRK-001") + b"the tracker is not ready\0"
    assert received(message("STATUS", body)) is not None, "it drops STATUS: a tracker that fails looks idle"


def reads_a_trajectory() -> None:
    assert received(message("TRAJ", TRAJECTORY)) is not None, "it drops TRAJ: no plan arrives"


def reads_tracking_data() -> None:
    body = struct.pack(">20sBB", b"Tool", 2, 0) + IDENTITY
    assert received(message("TDATA", body)) is not None, "it drops TDATA, the message of trackers"


def skips_a_message_that_it_does_not_know() -> None:
    assert received(message("OWNKIND", b"12345"), message("TRANSFORM", IDENTITY)) is not None


def refuses_a_wrong_check_sum() -> None:
    assert received(message("TRANSFORM", IDENTITY, check_sum=1)) is None, "a wrong check sum is accepted"


def reads_a_message_that_comes_in_two_packets() -> None:
    whole = message("TRANSFORM", IDENTITY)
    assert received(whole[:30], whole[30:]) is not None, "a header in two packets loses the stream"


def notices_that_the_server_has_gone() -> None:
    server = Sender(message("TRANSFORM", IDENTITY))
    client = pyigtl.OpenIGTLinkClient("127.0.0.1", server.port)
    assert client.wait_for_message("Tool", timeout=LIMIT_S) is not None
    server.close()
    assert eventually(lambda: not client.is_connected(), LIMIT_S), (
        "it stays connected to a server that has gone"
    )
