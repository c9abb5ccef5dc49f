"""GenICam description of a camera: download, strict parsing, registers; `feature_map` interprets nodes."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal
from xml.etree import ElementTree

from drivers.basler_stereo.control_channel import CameraControl
from drivers.basler_stereo.errors import BAD_DESCRIPTION
from ronna_hw.bounded_input import InputRefused, parse_xml, unzip
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap

LARGEST_FILE_BYTES = 8 * 1024 * 1024  # descriptions are 20 kB to 1 MB
ADDRESS_LIMIT = 1 << 32  # the address range of GigE Vision
LONGEST_SHOWN = 64  # characters of a text in a message
ROOT = "RegisterDescription"
MOST_FIELDS = 1000  # of one node
MOST_SHARED_FIELDS = 32  # of a register shared by several nodes: each of them inherits all
LARGEST_NUMBER = 1 << 64  # registers hold 64 bits
Number = int | float
CONDITIONS = ("pIsImplemented", "pIsAvailable")  # nodes that determine whether this one is available
_FLOATS = {4: "f", 8: "d"}


@dataclass(frozen=True)
class Field:
    """XML child element of a node."""

    tag: str
    text: str
    attributes: dict[str, str]


@dataclass(frozen=True)
class Node:
    """GenICam node: kind (the XML tag, such as IntReg), name and ordered fields."""

    kind: str
    name: str
    fields: tuple[Field, ...]
    entries: dict[str, int] = field(default_factory=dict)  # of an Enumeration: name -> value
    conditions: dict[str, tuple[str, ...]] = field(default_factory=dict)  # entry -> nodes it depends on

    def text(self, tag: str) -> str | None:
        """Return the text of the first field with this tag, if any."""
        return next((each.text for each in self.fields if each.tag == tag), None)

    def all(self, tag: str) -> Iterator[Field]:
        """Iterate over all fields with this tag."""
        return (each for each in self.fields if each.tag == tag)


def fetch_description(control: CameraControl, deadline_s: float) -> bytes:
    """Download the XML description stored on the camera.

    Raises GEV-009 if there is none, GEV-006 to GEV-008 if it cannot be read.
    """
    for register in (Bootstrap.FIRST_URL, Bootstrap.SECOND_URL):
        block = control.read_memory(register, gev.TEXT_BYTES[register], deadline_s)
        url = block.split(b"\0", 1)[0].decode("ascii", errors="replace").strip()
        if url.lower().startswith(gev.URL_LOCAL.lower()):
            name, address, length = parse_url(url)
            data = control.read_memory(address, length, deadline_s)
            return unzip_description(data) if name.lower().endswith(".zip") else data.rstrip(b"\0")
    raise BAD_DESCRIPTION(f"{control.address} has no description on board", got=url or "an empty address")


def parse_url(url: str) -> tuple[str, int, int]:
    """Parse `Local:name;address;length` into name, address and length; raises GEV-009."""
    try:
        name, address, length = url[len(gev.URL_LOCAL) :].split("?", 1)[0].split(";")
        place = int(address, 16), int(length, 16)
    except ValueError as error:
        raise BAD_DESCRIPTION("the address of the description cannot be read", got=url) from error
    if not 0 < place[1] <= LARGEST_FILE_BYTES:
        raise BAD_DESCRIPTION("the description has an invalid length", got=length[:LONGEST_SHOWN])
    if not 0 <= place[0] < ADDRESS_LIMIT - place[1]:
        raise BAD_DESCRIPTION("the description is at an impossible address", got=address[:LONGEST_SHOWN])
    return name.lstrip("/"), *place


def unzip_description(data: bytes) -> bytes:
    """Return the single member of a ZIP file; raises GEV-009."""
    try:
        return unzip(data, LARGEST_FILE_BYTES)
    except InputRefused as error:
        raise BAD_DESCRIPTION(f"the packed description is refused: {error.summary}") from error


def parse_description(data: bytes) -> dict[str, Node]:
    """Parse a description into nodes by name; raises GEV-009 for invalid XML or with a DTD."""
    try:
        root = parse_xml(data, LARGEST_FILE_BYTES)
    except InputRefused as error:
        raise BAD_DESCRIPTION(f"the description is refused: {error.summary}", wire=data[:32]) from error
    if _local_name(root.tag) != ROOT:
        raise BAD_DESCRIPTION("the description has the wrong root", expected=ROOT, got=_local_name(root.tag))
    return {node.name: node for node in _iterate_nodes(root)}


def _iterate_nodes(group: ElementTree.Element) -> Iterator[Node]:
    """Yield all named nodes, descending into groups and splitting shared registers."""
    for element in group:
        kind = _local_name(element.tag)
        if kind == "Group":
            yield from _iterate_nodes(element)
        elif kind == "StructReg":
            yield from _struct_entries(element)
        elif "Name" in element.attrib:
            yield _parse_node(element)


def _struct_entries(shared: ElementTree.Element) -> Iterator[Node]:
    """Yield the entries of a shared register, which inherit the fields that they lack."""
    common = tuple(_parse_field(child) for child in shared if _local_name(child.tag) != "StructEntry")
    if len(common) > MOST_SHARED_FIELDS:
        raise BAD_DESCRIPTION("a shared register has too many fields", limit=f"{MOST_SHARED_FIELDS} fields")
    for child in shared:
        if _local_name(child.tag) == "StructEntry" and "Name" in child.attrib:
            node = _parse_node(child)
            yield Node("MaskedIntReg", node.name, node.fields + common)


def _parse_node(element: ElementTree.Element) -> Node:
    fields: list[Field] = []
    entries: dict[str, int] = {}
    conditions: dict[str, tuple[str, ...]] = {}
    name = element.attrib["Name"]
    for child in element:
        if _local_name(child.tag) != "EnumEntry":
            fields.append(_parse_field(child))
            continue
        entry = child.attrib.get("Name", "")
        parts = [_parse_field(part) for part in child]
        value = next((part.text for part in parts if part.tag == "Value"), None)
        entries[entry] = parse_whole_number(value, f"entry of {name}")
        conditions[entry] = tuple(part.text for part in parts if part.tag in CONDITIONS)
    if len(fields) > MOST_FIELDS:
        raise BAD_DESCRIPTION(f"{name} has too many fields", limit=f"{MOST_FIELDS} fields")
    return Node(_local_name(element.tag), name, tuple(fields), entries, conditions)


def _parse_field(element: ElementTree.Element) -> Field:
    return Field(_local_name(element.tag), (element.text or "").strip(), dict(element.attrib))


def parse_whole_number(text: str | None, what: str) -> int:
    """Parse an integer of up to 64 bits, decimal or 0x hexadecimal; raises GEV-009."""
    try:
        number = int((text or "").strip(), 0)
    except ValueError as error:
        raise BAD_DESCRIPTION(f"{what} is not a whole number", got=str(text)[:LONGEST_SHOWN]) from error
    if abs(number) >= LARGEST_NUMBER:
        raise BAD_DESCRIPTION(f"{what} is too large", limit="64 bits")
    return number


def parse_real_number(text: str, what: str) -> float:
    """Parse a finite number; raises GEV-009."""
    try:
        number = float(text)
    except ValueError as error:
        raise BAD_DESCRIPTION(f"{what} is not a number", got=text[:LONGEST_SHOWN]) from error
    if not math.isfinite(number):
        raise BAD_DESCRIPTION(f"{what} is not finite", got=text[:LONGEST_SHOWN])
    return number


def _local_name(tag: str) -> str:
    return tag.rsplit("}", 1)[-1]


def register_length(node: Node) -> int:
    """Return the length of a register in bytes; raises GEV-009."""
    length = parse_whole_number(node.text("Length"), f"length of {node.name}")
    if length not in (_FLOATS if node.kind == "FloatReg" else (1, 2, 4, 8)):
        raise BAD_DESCRIPTION(f"{node.name} has a length of {length} bytes")
    return length


def shares_register(node: Node) -> bool:
    """Return whether a node uses only some bits of its register, so that writes must preserve the rest."""
    length = register_length(node)
    return register_bits(node, length)[1] < 8 * length


def decode_register(node: Node, data: bytes) -> Number:
    """Decode a node's value from its register bytes."""
    if node.kind == "FloatReg":
        number = float(struct.unpack(_float_layout(node, len(data)), data)[0])
        if not math.isfinite(number):
            raise BAD_DESCRIPTION(f"{node.name} reads {number}", expected="a finite number")
        return number
    low, width = register_bits(node, len(data))
    value = int.from_bytes(data, _byte_order(node)) >> low & (1 << width) - 1
    return value - (1 << width) if _is_signed(node) and value >> (width - 1) else value


def encode_register(node: Node, value: Number, current: bytes = b"") -> bytes:
    """Encode a value as register bytes, preserving the other bits of `current`."""
    length = register_length(node)
    if node.kind == "FloatReg":
        try:
            return struct.pack(_float_layout(node, length), float(value))
        except OverflowError as error:
            raise BAD_DESCRIPTION(f"{node.name} cannot hold {value:g}", limit=f"{length} bytes") from error
    low, width = register_bits(node, length)
    mask = (1 << width) - 1
    number = round(value)
    least = -(1 << width - 1) if _is_signed(node) else 0
    if not least <= number <= least + mask:
        raise BAD_DESCRIPTION(f"{node.name} cannot hold {number}", limit=f"{least} to {least + mask}")
    others = int.from_bytes(current, _byte_order(node)) & ~(mask << low)
    return (others | (number & mask) << low).to_bytes(length, _byte_order(node))


def _is_signed(node: Node) -> bool:
    return (node.text("Sign") or "Unsigned") == "Signed"


def register_bits(node: Node, length: int) -> tuple[int, int]:
    """Return the lowest bit and the width of a node's value in its register.

    In a big-endian register the description counts bits from the most significant one.
    """
    if node.kind != "MaskedIntReg":
        return 0, 8 * length
    single = node.text("Bit")
    ends = [
        parse_whole_number(single if single is not None else node.text(tag), node.name)
        for tag in ("LSB", "MSB")
    ]
    if _byte_order(node) == "big":
        ends = [8 * length - 1 - end for end in ends]
    low, high = min(ends), max(ends)
    if low < 0 or high >= 8 * length:
        raise BAD_DESCRIPTION(f"{node.name} uses bits outside its {length} bytes")
    return low, high - low + 1


def _byte_order(node: Node) -> Literal["big", "little"]:
    return "big" if node.text("Endianess") == "BigEndian" else "little"


def _float_layout(node: Node, length: int) -> str:
    return (">" if _byte_order(node) == "big" else "<") + _FLOATS[length]
