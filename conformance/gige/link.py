"""A plain GVCP client of a camera that bypasses every driver.

It decodes answers independently, following the protocol reference, so that a driver's misreading cannot hide.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from conformance.case import check
from conformance.device_under_test import DeviceUnderTest
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.wire.gige_vision import (
    CCP_CONTROL,
    CCP_OPEN,
    GVCP_KEY,
    GVCP_PORT,
    Bootstrap,
    GevStatus,
    GvcpCommand,
)

ANSWER_LIMIT_S = 0.5
TRIES = 3  # a datagram may be lost
SILENCE_S = 0.15  # after this long without a datagram there is no answer


@dataclass(frozen=True)
class Reply:
    """An acknowledge as received."""

    status: int
    code: int
    request_id: int
    payload: bytes


class GigeLink:
    """One socket to one camera; every command gets a new request id."""

    def __init__(self, address: str) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect((address, GVCP_PORT))
        self._request_id = 0
        self._last = b""
        self.address = address

    def __enter__(self) -> GigeLink:
        return self

    def __exit__(self, *reason: object) -> None:
        self._socket.close()

    def exchange(self, command: int, payload: bytes = b"") -> Reply:
        """Send a command and return its answer, whatever its status; raises Nonconformity without one."""
        self._request_id = self._request_id % 0xFFFF + 1
        datagram = struct.pack(">BBHHH", GVCP_KEY, 1, command, len(payload), self._request_id) + payload
        self._last = datagram
        for _ in range(TRIES):
            self._socket.send(datagram)
            if (answer := self._answer(self._request_id)) is not None:
                return answer
        check(False, f"an answer from {self.address} to command 0x{command:04X}", "none")
        raise AssertionError("check has raised")

    def silent_after(self, datagram: bytes) -> bool:
        """Send a datagram; True if nothing comes back."""
        self._socket.send(datagram)
        self._socket.settimeout(SILENCE_S)
        try:
            self._socket.recv(65536)
        except TimeoutError:
            return True
        return False

    def memory(self, address: int, count: int) -> bytes:
        """`count` bytes of memory; at most 536."""
        answer = self.exchange(GvcpCommand.READMEM, struct.pack(">IHH", address, 0, count))
        self.expect(answer, GevStatus.SUCCESS, f"reading memory at 0x{address:X}")
        check(len(answer.payload) == 4 + count, f"{4 + count} bytes of answer", len(answer.payload))
        check(answer.payload[:4] == struct.pack(">I", address), "the address in the answer")
        return answer.payload[4:]

    def registers(self, *addresses: int) -> list[int]:
        """Values of registers, read in one command."""
        answer = self.exchange(GvcpCommand.READREG, struct.pack(f">{len(addresses)}I", *addresses))
        self.expect(answer, GevStatus.SUCCESS, f"reading {len(addresses)} register(s)")
        check(len(answer.payload) == 4 * len(addresses), f"{len(addresses)} values", len(answer.payload))
        return list(struct.unpack(f">{len(addresses)}I", answer.payload))

    def write(self, address: int, value: int) -> int:
        """Write a register; returns the status."""
        return self.exchange(GvcpCommand.WRITEREG, struct.pack(">II", address, value)).status

    def write_memory(self, address: int, data: bytes) -> int:
        """Write bytes; returns the status."""
        return self.exchange(GvcpCommand.WRITEMEM, struct.pack(">I", address) + data).status

    def repeat_last(self) -> bool:
        """Send the last command again, like a client after a lost answer; True if answered."""
        self._socket.send(self._last)
        return self._answer(self._request_id) is not None

    def send(self, command: int, payload: bytes) -> None:
        """Send a command without the acknowledge flag."""
        self._request_id = self._request_id % 0xFFFF + 1
        head = struct.pack(">BBHHH", GVCP_KEY, 0, command, len(payload), self._request_id)
        self._socket.send(head + payload)

    @property
    def local_address(self) -> str:
        """The host's own address on the route to the camera."""
        return str(self._socket.getsockname()[0])

    @staticmethod
    def expect(answer: Reply, status: GevStatus, what: str) -> None:
        """Raise Nonconformity unless the answer has this status."""
        check(answer.status == status, f"{what}: status 0x{status:04X}", f"0x{answer.status:04X}")

    def _answer(self, request_id: int) -> Reply | None:
        deadline_s = time.monotonic() + ANSWER_LIMIT_S
        while (left_s := deadline_s - time.monotonic()) > 0:
            self._socket.settimeout(left_s)
            try:
                datagram = self._socket.recv(65536)
            except (TimeoutError, ConnectionRefusedError):
                return None
            check(len(datagram) >= 8, "a header of 8 bytes", len(datagram))
            status, code, length, came_id = struct.unpack_from(">HHHH", datagram)
            if came_id == request_id and code != GvcpCommand.PENDING_ACK:
                check(len(datagram) == 8 + length, f"{length} bytes, as the header says", len(datagram) - 8)
                return Reply(status, code, came_id, datagram[8:])
        return None


def cameras(dut: DeviceUnderTest) -> Iterator[GigeLink]:
    """A link to each camera in turn; closes every connection of the driver first."""
    dut.release()
    for text in dut.config.endpoints.values():
        with GigeLink(parse_endpoint(text).require("gev").host) as link:
            yield link


@contextmanager
def controlled(link: GigeLink) -> Iterator[GigeLink]:
    """Control of a camera, released after the block."""
    GigeLink.expect(Reply(link.write(Bootstrap.CCP, CCP_CONTROL), 0, 0, b""), GevStatus.SUCCESS, "control")
    try:
        yield link
    finally:
        link.write(Bootstrap.CCP, CCP_OPEN)
