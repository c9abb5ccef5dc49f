"""Fault-injecting line for the Polaris protocol that can change replies to given commands."""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable

from conformance.device_under_test import DeviceUnderTest
from conformance.disturbed_line import DisturbedLine
from conformance.polaris.client import with_crc
from ronna_hw.endpoints import Endpoint
from ronna_hw.wire.polaris import ASCII_CRC_DIGITS, BX_CRC_BYTES, BX_HEADER_BYTES, BX_START, CR, crc16

Change = Callable[[bytes], bytes]  # a complete reply -> what the driver gets instead
_BX_START = struct.pack("<H", BX_START)
_u16 = struct.Struct("<H")


class PolarisTap(DisturbedLine):
    """Tap that logs the driver's `commands` as `NAME:argument`, and each command's latest reply."""

    def __init__(self, device: Endpoint) -> None:
        super().__init__(device)
        self.commands: list[str] = []
        self.replies: dict[str, bytes] = {}
        self._changes: list[tuple[str, Change, float]] = []
        self._lock = threading.Lock()
        self._pending_data = b""
        self._name = ""
        self._reply = b""

    def change(self, name: str, change: Change, delay_s: float = 0.0) -> None:
        """Change and delay the next reply to a command, once; may be called in advance."""
        with self._lock:
            self._changes.append((name, change, delay_s))

    def answer(self, name: str, text: str) -> None:
        """Replace the next reply to a command, which the unit still executes, by text with a valid CRC."""
        self.change(name, lambda _reply: with_crc(text))

    def count(self, beginning: str) -> int:
        """Count the logged commands that start with `beginning`."""
        return sum(command.startswith(beginning) for command in self.commands)

    def _note_command(self, data: bytes) -> None:
        *lines, self._pending_data = (self._pending_data + data).split(CR)
        for line in lines:
            text = line.decode("latin-1")
            name, separator, argument = text.partition(":")
            if separator:
                argument = argument[:-ASCII_CRC_DIGITS]
            else:
                name, _, argument = text.partition(" ")
            self._name, self._reply = name, b""
            self.commands.append(f"{name}:{argument}")

    def _disturb(self, data: bytes) -> list[tuple[float, bytes]]:
        self._reply += data
        with self._lock:
            wanted_change = next((item for item in self._changes if item[0] == self._name), None)
            whole = _is_whole(self._reply)
            if whole:
                self.replies[self._name] = self._reply
            if wanted_change is None:
                return super()._disturb(data)
            if not whole:
                return []  # held until it is complete and can be changed
            self._changes.remove(wanted_change)
        _, change, delay_s = wanted_change
        return [(delay_s, change(self._reply))]


def polaris_tap(dut: DeviceUnderTest) -> PolarisTap:
    """Create a tap between driver and unit; pass the tap's endpoint to `make`."""
    dut.release()
    return PolarisTap(dut.endpoint)


def body_of(reply: bytes) -> bytes:
    return reply[BX_HEADER_BYTES:-BX_CRC_BYTES]


def with_body(body: bytes) -> bytes:
    header = _BX_START + _u16.pack(len(body))
    return header + _u16.pack(crc16(header)) + body + _u16.pack(crc16(body))


def with_system_status(reply: bytes, status: int) -> bytes:
    if reply.startswith(_BX_START):
        return with_body(body_of(reply)[:-2] + _u16.pack(status))
    return with_crc(reply[: -1 - ASCII_CRC_DIGITS - 4].decode() + f"{status:04X}")


def _is_whole(reply: bytes) -> bool:
    if reply.startswith(_BX_START[: len(reply)]) and len(reply) < BX_HEADER_BYTES:
        return False
    if reply.startswith(_BX_START):
        length: int = _u16.unpack_from(reply, 2)[0]
        return len(reply) >= BX_HEADER_BYTES + length + BX_CRC_BYTES
    return reply.endswith(CR)
