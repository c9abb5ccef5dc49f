"""Tool definitions and .rom files; lengths in mm, in the tool frame.

A property is written only where it differs from the bytes already there, so that unpublished content and the
padding and rounding of foreign files survive reading and writing.
"""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import date, timedelta
from pathlib import Path
from typing import Any

from drivers.ndi_polaris.errors import BAD_TOOL_FILE
from ronna_hw.bounded_input import InputRefused, read_bounded
from ronna_hw.vectors import Vector3
from ronna_hw.wire import polaris_rom as layout

Bits = tuple[int, int]  # lowest bit, number of bits
LARGEST_ANGLE_DEG = 180
LARGEST_FILE_BYTES = 65_536  # far more than a definition; a file of another length is rejected by it
_F3 = struct.Struct("<3f")
_MARKER_VECTORS_BYTES = layout.ROM_MARKERS * _F3.size
_SERIAL = ((layout.SERIAL_OFFSET, 4),)


def blank_block() -> bytes:
    """Return an empty definition, with the bytes common to all real files."""
    block = bytearray(layout.ROM_BYTES)
    block[: len(layout.ROM_MAGIC)] = layout.ROM_MAGIC
    block[layout.CONSTANT_ONE_OFFSET] = 1
    struct.pack_into("<f", block, layout.CONSTANT_TEN_OFFSET, 10.0)
    block[layout.LEDS_OFFSET : layout.LEDS_OFFSET + 4] = bytes([layout.LED_NONE] * 4)
    block[layout.TOOL_IN_PORT_OFFSET] = layout.TOOL_IN_PORT_PRESENT
    block[layout.CONSTANT_NINE_OFFSET] = 9
    return bytes(block)


@dataclass(frozen=True)
class ToolDefinition:
    """Passive rigid body with one or more faces of retro-reflective markers."""

    part_number: str
    markers_mm: tuple[Vector3, ...]
    normals: tuple[Vector3, ...]  # one per marker, unit
    faces: tuple[int, ...]  # face of each marker, from 1
    face_normals: tuple[Vector3, ...]
    manufacturer: str
    made_on: date
    main_type: int = layout.MAIN_TYPE_REFERENCE
    subtype: int = layout.MAIN_TYPE_REFERENCE - layout.SUBTYPE_BELOW_TYPE
    revision: int = 0
    sequence: int = 1  # with the date, the serial number; some clients do not accept 0
    maximum_angle_deg: int = 90
    minimum_markers: int = 3
    maximum_error_mm: float = 1.0
    minimum_spread_mm: Vector3 = (0.0, 0.0, 0.0)
    unique_geometry: bool = True
    marker_type: int = layout.MARKER_PASSIVE_SPHERE
    # The bytes it was read from: unknown content is written back unchanged.
    origin: bytes = field(default_factory=blank_block, compare=False, repr=False)


def make_planar_tool(
    part_number: str,
    markers_mm: tuple[Vector3, ...],
    normal: Vector3 = (0.0, 0.0, 1.0),
    *,
    manufacturer: str,
    made_on: date,
) -> ToolDefinition:
    """Build a tool with a single face, all of whose markers point along `normal`."""
    return ToolDefinition(
        part_number=part_number,
        markers_mm=markers_mm,
        normals=(normal,) * len(markers_mm),
        faces=(1,) * len(markers_mm),
        face_normals=(face_normal_of(normal),),
        manufacturer=manufacturer,
        made_on=made_on,
    )


def face_normal_of(normal: Vector3) -> Vector3:
    """Return the face normal for a marker normal; real files store the opposite vector."""
    return -normal[0] or 0.0, -normal[1] or 0.0, -normal[2] or 0.0


def read_definition(path: Path) -> ToolDefinition:
    """Read a .rom file; raises NDI-011 if it is missing or invalid."""
    try:
        block = read_bounded(path, LARGEST_FILE_BYTES)
    except InputRefused as error:
        raise BAD_TOOL_FILE(error.summary) from error
    except OSError as error:
        beside = sorted(one.name for one in path.parent.glob("*.rom"))
        raise BAD_TOOL_FILE(
            f"cannot read {path}: {error.strerror}", expected=" or ".join(beside) or "a .rom file"
        ) from error
    return decode_definition(block, path.name)


def decode_definition(block: bytes, name: str = "definition") -> ToolDefinition:
    """Decode .rom bytes with optional zero padding; raises NDI-011."""
    if not layout.ROM_BYTES <= len(block) <= layout.ROM_FILE_LIMIT_BYTES or any(block[layout.ROM_BYTES :]):
        raise BAD_TOOL_FILE(f"{name} has {len(block)} bytes", expected=f"{layout.ROM_BYTES} bytes")
    if block[: len(layout.ROM_MAGIC)] != layout.ROM_MAGIC:
        raise BAD_TOOL_FILE(f"{name} is not a tool definition", expected="a file that starts with NDI")
    (claimed,) = struct.unpack_from("<H", block, layout.CHECKSUM_OFFSET)
    if claimed != checksum(block):
        raise BAD_TOOL_FILE(
            f"{name} has a wrong checksum", expected=f"{checksum(block):04X}", got=f"{claimed:04X}"
        )
    if (count := block[layout.MARKER_COUNT_OFFSET]) > layout.ROM_MARKERS:
        raise BAD_TOOL_FILE(f"{name} has {count} markers", limit=f"{layout.ROM_MARKERS} markers")
    origin = bytes(block[: layout.ROM_BYTES])
    values = {property_.name: property_.read(origin) for property_ in FIELDS}
    tool = ToolDefinition(**values, origin=origin)
    _check_definition(tool, name)
    return tool


def encode_definition(tool: ToolDefinition) -> bytes:
    """Encode a definition as 752 .rom bytes; raises NDI-011 if it is invalid.

    An unchanged definition yields exactly the bytes that were read.
    """
    _check_definition(tool)
    block = bytearray(tool.origin)
    for property_ in FIELDS:
        value = getattr(tool, property_.name)
        if property_.read(bytes(block)) != value:
            property_.write(block, value)
    struct.pack_into("<H", block, layout.CHECKSUM_OFFSET, checksum(block))
    return bytes(block)


def definition_hash(tool: ToolDefinition) -> str:
    """Return the SHA-256 of the encoded definition, in hex."""
    return hashlib.sha256(encode_definition(tool)).hexdigest()


def _check_definition(tool: ToolDefinition, name: str = "") -> None:
    subject = name or tool.part_number
    count = len(tool.markers_mm)
    if not layout.ROM_MINIMUM_MARKERS <= count <= layout.ROM_MARKERS:
        raise BAD_TOOL_FILE(
            f"{subject} has {count} markers", limit=f"{layout.ROM_MINIMUM_MARKERS} to {layout.ROM_MARKERS}"
        )
    if len(tool.normals) != count or len(tool.faces) != count:
        raise BAD_TOOL_FILE(f"{subject} needs one normal and one face per marker")
    if not 1 <= len(tool.face_normals) <= layout.ROM_FACES or not all(
        1 <= face <= len(tool.face_normals) for face in tool.faces
    ):
        raise BAD_TOOL_FILE(f"{subject} has a face number out of range", limit=f"1 to {layout.ROM_FACES}")
    if not layout.ROM_MINIMUM_MARKERS <= tool.minimum_markers <= count:
        raise BAD_TOOL_FILE(
            f"{subject} has a minimum of {tool.minimum_markers} of {count} markers",
            limit=f"3 to {count} markers",
        )
    numbers = [value for vector in (*tool.markers_mm, *tool.normals, *tool.face_normals) for value in vector]
    if not all(math.isfinite(value) for value in (*numbers, tool.maximum_error_mm, *tool.minimum_spread_mm)):
        raise BAD_TOOL_FILE(f"{subject} contains numbers that are not finite")
    if tool.maximum_error_mm <= 0 or not 0 <= tool.maximum_angle_deg <= LARGEST_ANGLE_DEG:
        raise BAD_TOOL_FILE(f"{subject} has an impossible maximum error or angle")


def checksum(block: bytes | bytearray) -> int:
    """Return the 16-bit sum of all bytes after the checksum field."""
    return sum(block[layout.CHECKSUM_FROM :]) & 0xFFFF


@dataclass(frozen=True)
class ByteField:
    """Field of a .rom file: attribute name, byte spans (offset, length), reader and writer."""

    name: str
    spans: tuple[tuple[int, int], ...]
    read: Callable[[bytes], Any]
    write: Callable[[bytearray, Any], None]


def _number_field(name: str, form: str, offset: int) -> ByteField:
    code = struct.Struct(form)

    def write(block: bytearray, value: Any) -> None:
        try:
            code.pack_into(block, offset, value)
        except (struct.error, OverflowError) as error:
            raise BAD_TOOL_FILE(f"{name} does not fit into a definition", got=str(value)) from error

    return ByteField(name, ((offset, code.size),), lambda block: code.unpack_from(block, offset)[0], write)


def _text_field(name: str, offset: int, size: int) -> ByteField:
    def read(block: bytes) -> str:
        return block[offset : offset + size].split(b"\0", 1)[0].decode("ascii", "replace").strip()

    def write(block: bytearray, value: str) -> None:
        try:
            encoded = value.encode("ascii")
        except UnicodeEncodeError as error:
            raise BAD_TOOL_FILE(f"{value!r} is not ASCII") from error
        if len(encoded) > size:
            raise BAD_TOOL_FILE(f"{value!r} is too long", limit=f"{size} characters")
        block[offset : offset + size] = encoded.ljust(size, b"\0")

    return ByteField(name, ((offset, size),), read, write)


def _read_vectors(block: bytes, offset: int, count: int) -> tuple[Vector3, ...]:
    triples = (_F3.unpack_from(block, offset + index * _F3.size) for index in range(count))
    return tuple((x, y, z) for x, y, z in triples)


def _write_vectors(block: bytearray, offset: int, vectors: tuple[Vector3, ...]) -> None:
    for index, vector in enumerate(vectors):
        _F3.pack_into(block, offset + index * _F3.size, *vector)


def _vectors_field(name: str, offset: int, most: int, count: Callable[[bytes], int]) -> ByteField:
    return ByteField(
        name,
        ((offset, most * _F3.size),),
        lambda block: _read_vectors(block, offset, count(block)),
        lambda block, value: _write_vectors(block, offset, value),
    )


def _read_count(block: bytes | bytearray) -> int:
    return block[layout.MARKER_COUNT_OFFSET]


def _write_markers(block: bytearray, markers_mm: tuple[Vector3, ...]) -> None:
    count = len(markers_mm)
    if count != _read_count(block):
        # Slots come into use or become free: clear the remains of a previous marker.
        block[layout.MARKER_COUNT_OFFSET] = count
        for offset in (layout.MARKER_POSITIONS_OFFSET, layout.MARKER_NORMALS_OFFSET):
            block[offset : offset + _MARKER_VECTORS_BYTES] = bytes(_MARKER_VECTORS_BYTES)
        for slot in range(layout.ROM_MARKERS):
            is_used = slot < count
            block[layout.FIRING_SEQUENCE_OFFSET + slot] = slot if is_used else 0
            block[layout.MARKER_FACES_OFFSET + slot] = 0
            block[layout.MARKER_GROUPS_OFFSET + slot] = 1 if is_used else 0
    _write_vectors(block, layout.MARKER_POSITIONS_OFFSET, markers_mm)


def _read_faces(block: bytes) -> tuple[int, ...]:
    return tuple(block[layout.MARKER_FACES_OFFSET : layout.MARKER_FACES_OFFSET + _read_count(block)])


def _write_faces(block: bytearray, faces: tuple[int, ...]) -> None:
    block[layout.MARKER_FACES_OFFSET : layout.MARKER_FACES_OFFSET + len(faces)] = bytes(faces)


def _count_faces(block: bytes) -> int:
    return min(layout.ROM_FACES, max(_read_faces(block), default=0))


def _read_bits(block: bytes, bits: Bits) -> int:
    (serial,) = struct.unpack_from("<I", block, layout.SERIAL_OFFSET)
    return int(serial) >> bits[0] & ((1 << bits[1]) - 1)


def _write_bits(block: bytearray, bits: Bits, value: int) -> None:
    if not 0 <= value < 1 << bits[1]:
        raise BAD_TOOL_FILE("the serial number of a definition does not fit", got=str(value))
    (serial,) = struct.unpack_from("<I", block, layout.SERIAL_OFFSET)
    mask = ((1 << bits[1]) - 1) << bits[0]
    struct.pack_into("<I", block, layout.SERIAL_OFFSET, serial & ~mask | value << bits[0])


def _read_date(block: bytes) -> date:
    # The month field is redundant: the day of the year decides.
    first = date(layout.SERIAL_FIRST_YEAR + _read_bits(block, layout.SERIAL_YEAR_BITS), 1, 1)
    return first + timedelta(days=_read_bits(block, layout.SERIAL_DAY_BITS))


def _write_date(block: bytearray, made_on: date) -> None:
    _write_bits(block, layout.SERIAL_DAY_BITS, made_on.timetuple().tm_yday - 1)
    _write_bits(block, layout.SERIAL_MONTH_BITS, made_on.month - 1)
    _write_bits(block, layout.SERIAL_YEAR_BITS, made_on.year - layout.SERIAL_FIRST_YEAR)


def _write_flag(block: bytearray, unique: bool) -> None:
    others = block[layout.FLAGS_OFFSET] & ~layout.FLAG_UNIQUE_GEOMETRY
    block[layout.FLAGS_OFFSET] = others | (layout.FLAG_UNIQUE_GEOMETRY if unique else 0)


# Markers first: their number determines the number of normals and faces.
FIELDS: tuple[ByteField, ...] = (
    ByteField(
        "markers_mm",
        ((layout.MARKER_COUNT_OFFSET, 1), (layout.MARKER_POSITIONS_OFFSET, _MARKER_VECTORS_BYTES)),
        lambda block: _read_vectors(block, layout.MARKER_POSITIONS_OFFSET, _read_count(block)),
        _write_markers,
    ),
    _vectors_field("normals", layout.MARKER_NORMALS_OFFSET, layout.ROM_MARKERS, _read_count),
    ByteField("faces", ((layout.MARKER_FACES_OFFSET, layout.ROM_MARKERS),), _read_faces, _write_faces),
    _vectors_field("face_normals", layout.FACE_NORMALS_OFFSET, layout.ROM_FACES, _count_faces),
    _text_field("part_number", layout.PART_NUMBER_OFFSET, layout.PART_NUMBER_BYTES),
    _text_field("manufacturer", layout.MANUFACTURER_OFFSET, layout.MANUFACTURER_BYTES),
    _number_field("main_type", "<B", layout.MAIN_TYPE_OFFSET),
    _number_field("subtype", "<B", layout.SUBTYPE_OFFSET),
    _number_field("revision", "<H", layout.REVISION_OFFSET),
    ByteField(
        "sequence",
        _SERIAL,
        lambda block: _read_bits(block, layout.SERIAL_SEQUENCE_BITS),
        lambda block, value: _write_bits(block, layout.SERIAL_SEQUENCE_BITS, value),
    ),
    ByteField("made_on", _SERIAL, _read_date, _write_date),
    _number_field("maximum_angle_deg", "<B", layout.MAXIMUM_ANGLE_OFFSET),
    _number_field("minimum_markers", "<B", layout.MINIMUM_MARKER_COUNT_OFFSET),
    _number_field("maximum_error_mm", "<f", layout.MAXIMUM_ERROR_OFFSET),
    ByteField(
        "minimum_spread_mm",
        ((layout.MINIMUM_SPREAD_OFFSET, _F3.size),),
        lambda block: _read_vectors(block, layout.MINIMUM_SPREAD_OFFSET, 1)[0],
        lambda block, value: _F3.pack_into(block, layout.MINIMUM_SPREAD_OFFSET, *value),
    ),
    ByteField(
        "unique_geometry",
        ((layout.FLAGS_OFFSET, 1),),
        lambda block: bool(block[layout.FLAGS_OFFSET] & layout.FLAG_UNIQUE_GEOMETRY),
        _write_flag,
    ),
    _number_field("marker_type", "<B", layout.MARKER_TYPE_OFFSET),
)
