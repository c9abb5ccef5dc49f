"""Features of a camera by name, if the description maps them to one fixed register.

Independent of any driver, and much smaller: nodes with formulas are not supported.
"""

from __future__ import annotations

import struct
from functools import cached_property
from xml.etree.ElementTree import Element

from conformance.case import NotShown, check, read_as
from conformance.gige.link import GigeLink
from ronna_hw.bounded_input import parse_xml, unzip
from ronna_hw.wire.gige_vision import TEXT_BYTES, URL_LOCAL, Bootstrap, GevStatus

PIECE_BYTES = 512
LARGEST_FILE_BYTES = 8 << 20  # descriptions are 20 kB to 1 MB
DEPTH_LIMIT = 8


class GigeFeatures:
    """The features of the camera at the other end of a link."""

    def __init__(self, link: GigeLink) -> None:
        self._link = link

    @cached_property
    @read_as("XML at the address that its URL says")
    def description(self) -> Element:
        """The camera's description, plain or zipped XML; raises Nonconformity if it is neither."""
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
        return parse_xml(_unpacked(name, data[:count]), LARGEST_FILE_BYTES)

    @cached_property
    def nodes(self) -> dict[str, Element]:
        """Nodes by name."""
        return {
            name: node
            for node in self.description.iter()
            if (name := node.get("Name")) and _kind(node) not in ("EnumEntry", "pVariable")
        }

    def has(self, name: str) -> bool:
        """True when the description has a node of that name."""
        return name in self.nodes

    @read_as("an entry with an integer value")
    def entry(self, name: str, entry: str) -> int:
        """Value of an enumeration's entry."""
        for child in self._node(name):
            if _kind(child) == "EnumEntry" and child.get("Name") == entry:
                return int(_text(child, "Value") or "0", 0)
        raise NotShown(f"{name} has no entry {entry}")

    @read_as("a register of a number")
    def get(self, name: str) -> int | float:
        """Value of a feature."""
        register = self._register(name)
        data = self._link.memory(self._address(register), self._length(register))
        if _kind(register) == "FloatReg":
            return float(struct.unpack(">f" if len(data) == 4 else ">d", data)[0])
        return int.from_bytes(data, "big")

    def whole(self, name: str) -> int:
        """Value of an integer feature."""
        return int(self.get(name))

    @read_as("an integer limit")
    def limit(self, name: str, which: str) -> int:
        """Present `Min`, `Max` or `Inc` of a feature."""
        node = self._node(name)
        if (own := _text(node, which)) is not None:
            return int(float(own))
        other = _text(node, f"p{which}")
        if other is None:
            raise NotShown(f"{name} has no {which}")
        return self.whole(other)

    @read_as("a register that has room for the value")
    def write(self, name: str, value: int | float) -> int:
        """Set a feature; returns the status."""
        register = self._register(name)
        length = self._length(register)
        if _kind(register) == "FloatReg":
            data = struct.pack(">f" if length == 4 else ">d", value)
        else:
            data = int(value).to_bytes(length, "big", signed=value < 0)
        return self._link.write_memory(self._address(register), data)

    def set(self, name: str, value: int | float | str) -> None:
        """Set a feature, an enumeration by its entry; raises Nonconformity when the camera refuses."""
        number = self.entry(name, value) if isinstance(value, str) else value
        status = self.write(name, number)
        check(status == GevStatus.SUCCESS, f"{name} = {value} accepted", f"status 0x{status:04X}")

    @read_as("the register of a command")
    def execute(self, name: str) -> None:
        """Execute a command; raises Nonconformity when the camera refuses."""
        status = self._link.write(*self.command(name))
        check(status == GevStatus.SUCCESS, f"{name} executed", f"status 0x{status:04X}")

    @read_as("a register and an integer command value")
    def command(self, name: str) -> tuple[int, int]:
        """Register and value that execute a command."""
        value = int(_text(self._node(name), "CommandValue") or "1", 0)
        return self._address(self._register(name)), value

    @read_as("integer addresses")
    def addresses(self) -> list[int]:
        """Every fixed register address in the description.

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

    def _node(self, name: str) -> Element:
        if name not in self.nodes:
            raise NotShown(f"the camera has no feature {name}")
        return self.nodes[name]

    def _register(self, name: str) -> Element:
        node = self._node(name)
        for _ in range(DEPTH_LIMIT):
            if _text(node, "Address") is not None and _text(node, "pIndex") is None:
                return node
            below = _text(node, "pValue")
            if below is None or _kind(node) not in ("Integer", "Float", "Enumeration", "Boolean", "Command"):
                break
            node = self._node(below)
        raise NotShown(f"{name} does not lead to one fixed register")

    def _address(self, register: Element) -> int:
        return int(_text(register, "Address") or "", 0)

    def _length(self, register: Element) -> int:
        length = int(_text(register, "Length") or "4", 0)
        check(0 < length <= PIECE_BYTES, f"a register of 1 to {PIECE_BYTES} bytes", length)
        return length


def _unpacked(name: str, data: bytes) -> bytes:
    if not name.lower().endswith(".zip"):
        return data.rstrip(b"\0")
    return unzip(data, LARGEST_FILE_BYTES)


def _kind(node: Element) -> str:
    return node.tag.rpartition("}")[2]


def _text(node: Element, tag: str) -> str | None:
    for child in node:
        if _kind(child) == tag and child.text:
            return child.text.strip()
    return None
