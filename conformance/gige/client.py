"""Minimal GVCP client for a camera's registers and named features, independent of every driver.

It decodes answers independently, following the protocol reference, so that a driver's misreading cannot hide.
Features need a description that maps them to one fixed register: nodes with formulas are not supported.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from xml.etree.ElementTree import Element

from conformance.case import Nonconformity, NotShown, check, read_as
from conformance.device_under_test import DeviceUnderTest
from ronna_hw.bounded_input import parse_xml, unzip
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.wire.gige_vision import (
    CCP_CONTROL,
    CCP_OPEN,
    GVCP_KEY,
    GVCP_PORT,
    TEXT_BYTES,
    URL_LOCAL,
    Bootstrap,
    GevStatus,
    GvcpCommand,
)

ANSWER_LIMIT_S = 0.5
TRIES = 3  # a datagram may be lost
SILENCE_S = 0.15  # after this long without a datagram there is no answer


@dataclass(frozen=True)
class GvcpReply:
    """GVCP acknowledge: decoded header, raw payload."""

    status: int
    code: int
    request_id: int
    payload: bytes


class GigeLink:
    """GVCP connection to a camera; every command gets a new request id."""

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

    def exchange(self, command: int, payload: bytes = b"") -> GvcpReply:
        """Send a command and return its reply, whatever the status; raises Nonconformity if none arrives."""
        self._request_id = self._request_id % 0xFFFF + 1
        datagram = struct.pack(">BBHHH", GVCP_KEY, 1, command, len(payload), self._request_id) + payload
        self._last = datagram
        for _ in range(TRIES):
            self._socket.send(datagram)
            if (answer := self._receive_reply(self._request_id)) is not None:
                return answer
        raise Nonconformity(f"expected an answer from {self.address} to command 0x{command:04X}, got none")

    def is_silent_after(self, datagram: bytes) -> bool:
        """Send a datagram and return whether there is no reply."""
        self._socket.send(datagram)
        self._socket.settimeout(SILENCE_S)
        try:
            self._socket.recv(65536)
        except TimeoutError:
            return True
        return False

    def memory(self, address: int, count: int) -> bytes:
        """Read `count` bytes of memory, at most 536."""
        answer = self.exchange(GvcpCommand.READMEM, struct.pack(">IHH", address, 0, count))
        self.expect(answer, GevStatus.SUCCESS, f"reading memory at 0x{address:X}")
        check(len(answer.payload) == 4 + count, f"{4 + count} bytes of answer", len(answer.payload))
        check(answer.payload[:4] == struct.pack(">I", address), "the address in the answer")
        return answer.payload[4:]

    def read_registers(self, *addresses: int) -> list[int]:
        answer = self.exchange(GvcpCommand.READREG, struct.pack(f">{len(addresses)}I", *addresses))
        self.expect(answer, GevStatus.SUCCESS, f"reading {len(addresses)} register(s)")
        check(len(answer.payload) == 4 * len(addresses), f"{len(addresses)} values", len(answer.payload))
        return list(struct.unpack(f">{len(addresses)}I", answer.payload))

    def write(self, address: int, value: int) -> int:
        return self.exchange(GvcpCommand.WRITEREG, struct.pack(">II", address, value)).status

    def write_memory(self, address: int, data: bytes) -> int:
        return self.exchange(GvcpCommand.WRITEMEM, struct.pack(">I", address) + data).status

    def repeat_last(self) -> bool:
        """Send the last command again, as after a lost reply; returns whether it is answered."""
        self._socket.send(self._last)
        return self._receive_reply(self._request_id) is not None

    def send(self, command: int, payload: bytes) -> None:
        """Send a command without the acknowledge flag."""
        self._request_id = self._request_id % 0xFFFF + 1
        head = struct.pack(">BBHHH", GVCP_KEY, 0, command, len(payload), self._request_id)
        self._socket.send(head + payload)

    @property
    def local_address(self) -> str:
        return str(self._socket.getsockname()[0])

    @staticmethod
    def expect(answer: GvcpReply, status: GevStatus, what: str) -> None:
        """Raise Nonconformity unless the reply has this status."""
        check(answer.status == status, f"{what}: status 0x{status:04X}", f"0x{answer.status:04X}")

    def _receive_reply(self, request_id: int) -> GvcpReply | None:
        deadline_s = time.monotonic() + ANSWER_LIMIT_S
        while (remaining_s := deadline_s - time.monotonic()) > 0:
            self._socket.settimeout(remaining_s)
            try:
                datagram = self._socket.recv(65536)
            except (TimeoutError, ConnectionRefusedError):
                return None
            check(len(datagram) >= 8, "a header of 8 bytes", len(datagram))
            status, code, length, reply_id = struct.unpack_from(">HHHH", datagram)
            if reply_id == request_id and code != GvcpCommand.PENDING_ACK:
                check(len(datagram) == 8 + length, f"{length} bytes, as the header says", len(datagram) - 8)
                return GvcpReply(status, code, reply_id, datagram[8:])
        return None


def cameras(dut: DeviceUnderTest) -> Iterator[GigeLink]:
    """Yield a link to each camera, closing every driver connection first."""
    dut.release()
    for text in dut.config.endpoints.values():
        with GigeLink(parse_endpoint(text).require("gev").host) as link:
            yield link


@contextmanager
def camera_control(link: GigeLink) -> Iterator[GigeLink]:
    """Control a camera for the duration of the block."""
    GigeLink.expect(
        GvcpReply(link.write(Bootstrap.CCP, CCP_CONTROL), 0, 0, b""), GevStatus.SUCCESS, "control"
    )
    try:
        yield link
    finally:
        link.write(Bootstrap.CCP, CCP_OPEN)


PIECE_BYTES = 512
LARGEST_FILE_BYTES = 8 << 20  # descriptions are 20 kB to 1 MB
DEPTH_LIMIT = 8


class GigeFeatures:
    """GenICam features of the camera on a link."""

    def __init__(self, link: GigeLink) -> None:
        self._link = link

    @cached_property
    @read_as("XML at the address that its URL says")
    def description(self) -> Element:
        """GenICam description of the camera, plain or zipped XML; raises Nonconformity if it is neither."""
        block = self._link.memory(Bootstrap.FIRST_URL, TEXT_BYTES[Bootstrap.FIRST_URL])
        url = block.split(b"\0", 1)[0].decode("ascii", errors="replace")
        if not url.startswith(URL_LOCAL):
            raise NotShown(f"the description is not on the camera: {url}")
        name, address, length = url.removeprefix(URL_LOCAL).split("?")[0].split(";")
        begin, count = int(address, 16), int(length, 16)
        check(0 < count <= LARGEST_FILE_BYTES, f"1 to {LARGEST_FILE_BYTES} bytes of description", length)
        data = b"".join(
            self._link.memory(begin + offset, min(PIECE_BYTES, -(-(count - offset) // 4) * 4))
            for offset in range(0, count, PIECE_BYTES)
        )
        content = data[:count]
        plain = unzip(content, LARGEST_FILE_BYTES) if name.lower().endswith(".zip") else content.rstrip(b"\0")
        return parse_xml(plain, LARGEST_FILE_BYTES)

    @cached_property
    def nodes(self) -> dict[str, Element]:
        return {
            name: node
            for node in self.description.iter()
            if (name := node.get("Name")) and _kind(node) not in ("EnumEntry", "pVariable")
        }

    def has(self, name: str) -> bool:
        return name in self.nodes

    def entries(self, name: str) -> tuple[str, ...]:
        """List the entry names of an enumeration."""
        children = self._find_node(name)
        return tuple(child.get("Name", "") for child in children if _kind(child) == "EnumEntry")

    @read_as("an entry with an integer value")
    def entry(self, name: str, entry: str) -> int:
        """Return the value of an enumeration entry."""
        for child in self._find_node(name):
            if _kind(child) == "EnumEntry" and child.get("Name") == entry:
                return int(_text(child, "Value") or "0", 0)
        raise NotShown(f"{name} has no entry {entry}")

    @read_as("a register of a number")
    def get(self, name: str) -> int | float:
        register = self._find_register(name)
        data = self._link.memory(self._register_address(register), self._register_length(register))
        if _kind(register) == "FloatReg":
            return float(struct.unpack(">f" if len(data) == 4 else ">d", data)[0])
        return int.from_bytes(data, "big")

    def whole(self, name: str) -> int:
        return int(self.get(name))

    @read_as("an integer limit")
    def limit(self, name: str, which: str) -> int:
        """Read the current `Min`, `Max` or `Inc` of a feature."""
        node = self._find_node(name)
        if (own := _text(node, which)) is not None:
            return int(float(own))
        other = _text(node, f"p{which}")
        if other is None:
            raise NotShown(f"{name} has no {which}")
        return self.whole(other)

    @read_as("a register that has room for the value")
    def write(self, name: str, value: int | float) -> int:
        """Write a feature and return the status."""
        register = self._find_register(name)
        length = self._register_length(register)
        if _kind(register) == "FloatReg":
            data = struct.pack(">f" if length == 4 else ">d", value)
        else:
            data = int(value).to_bytes(length, "big", signed=value < 0)
        return self._link.write_memory(self._register_address(register), data)

    def set(self, name: str, value: int | float | str) -> None:
        """Set a feature, an enumeration by entry name; raises Nonconformity if the camera refuses."""
        number = self.entry(name, value) if isinstance(value, str) else value
        status = self.write(name, number)
        check(status == GevStatus.SUCCESS, f"{name} = {value} accepted", f"status 0x{status:04X}")

    @read_as("the register of a command")
    def execute(self, name: str) -> None:
        """Execute a command feature; raises Nonconformity if the camera refuses."""
        status = self._link.write(*self.command(name))
        check(status == GevStatus.SUCCESS, f"{name} executed", f"status 0x{status:04X}")

    @read_as("a register and an integer command value")
    def command(self, name: str) -> tuple[int, int]:
        """Return the register and value that execute a command feature."""
        value = int(_text(self._find_node(name), "CommandValue") or "1", 0)
        return self._register_address(self._find_register(name)), value

    @read_as("integer addresses")
    def addresses(self) -> list[int]:
        """List every fixed register address in the description.

        Nodes on an event's port are skipped: their addresses are offsets in a message.
        """
        events = {name for name, node in self.nodes.items() if _text(node, "EventID") is not None}
        return [
            int(text, 0)
            for node in self.nodes.values()
            if _kind(node).endswith("Reg")
            and (text := _text(node, "Address")) is not None
            and _text(node, "pPort") not in events
        ]

    def _find_node(self, name: str) -> Element:
        if name not in self.nodes:
            raise NotShown(f"the camera has no feature {name}")
        return self.nodes[name]

    def _find_register(self, name: str) -> Element:
        node = self._find_node(name)
        for _ in range(DEPTH_LIMIT):
            if _text(node, "Address") is not None and _text(node, "pIndex") is None:
                return node
            below = _text(node, "pValue")
            if below is None or _kind(node) not in ("Integer", "Float", "Enumeration", "Boolean", "Command"):
                break
            node = self._find_node(below)
        raise NotShown(f"{name} does not lead to one fixed register")

    def _register_address(self, register: Element) -> int:
        return int(_text(register, "Address") or "", 0)

    def _register_length(self, register: Element) -> int:
        length = int(_text(register, "Length") or "4", 0)
        check(0 < length <= PIECE_BYTES, f"a register of 1 to {PIECE_BYTES} bytes", length)
        return length


def _kind(node: Element) -> str:
    return node.tag.rpartition("}")[2]


def _text(node: Element, tag: str) -> str | None:
    for child in node:
        if _kind(child) == tag and child.text:
            return child.text.strip()
    return None
