"""Tool definitions: what a .rom says, read and written by this code. Lengths mm, in the tool's own frame."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path

from drivers.ndi_polaris.errors import BadToolFile
from ronna_hw.devices.readings import Vector3
from ronna_hw.wire import polaris_rom as layout

_F3 = struct.Struct("<3f")


@dataclass(frozen=True)
class ToolDefinition:
    """A passive rigid body with one or more faces of retro-reflective markers."""

    part_number: str
    markers_mm: tuple[Vector3, ...]
    normals: tuple[Vector3, ...]  # one per marker, unit
    faces: tuple[int, ...]  # face of each marker, from 1
    face_normals: tuple[Vector3, ...]
    manufacturer: str
    made_on: date
    main_type: int = layout.MAIN_TYPE_REFERENCE
    revision: int = 0
    sequence: int = 1  # with the date, the serial number; some clients never accept serial number 0
    maximum_angle_deg: int = 90
    minimum_markers: int = 3
    maximum_error_mm: float = 1.0
    minimum_spread_mm: Vector3 = (0.0, 0.0, 0.0)
    unique_geometry: bool = True
    marker_type: int = layout.MARKER_PASSIVE_SPHERE


def planar_tool(
    part_number: str,
    markers_mm: tuple[Vector3, ...],
    normal: Vector3 = (0.0, 0.0, 1.0),
    *,
    manufacturer: str,
    made_on: date,
) -> ToolDefinition:
    """A tool with one face whose markers all look along `normal`, as most passive rigid bodies are."""
    return ToolDefinition(
        part_number=part_number,
        markers_mm=markers_mm,
        normals=(normal,) * len(markers_mm),
        faces=(1,) * len(markers_mm),
        # the vendor's own files give the face the opposite sense of its markers
        face_normals=((-normal[0] or 0.0, -normal[1] or 0.0, -normal[2] or 0.0),),
        manufacturer=manufacturer,
        made_on=made_on,
    )


def encode_definition(tool: ToolDefinition) -> bytes:
    """The 752 bytes of a .rom; raises NDI-011 when the definition is not possible."""
    _check(tool)
    block = bytearray(layout.ROM_BYTES)
    block[: len(layout.ROM_MAGIC)] = layout.ROM_MAGIC
    block[layout.CONSTANT_ONE_OFFSET] = 1
    block[layout.SUBTYPE_OFFSET] = max(0, tool.main_type - 1)
    block[layout.MAIN_TYPE_OFFSET] = tool.main_type
    struct.pack_into("<H", block, layout.REVISION_OFFSET, tool.revision)
    struct.pack_into("<I", block, layout.SERIAL_OFFSET, _serial(tool))
    block[layout.MAXIMUM_ANGLE_OFFSET] = tool.maximum_angle_deg
    block[layout.MARKER_COUNT_OFFSET] = len(tool.markers_mm)
    block[layout.MINIMUM_MARKER_COUNT_OFFSET] = tool.minimum_markers
    struct.pack_into("<f", block, layout.MAXIMUM_ERROR_OFFSET, tool.maximum_error_mm)
    _F3.pack_into(block, layout.MINIMUM_SPREAD_OFFSET, *tool.minimum_spread_mm)
    struct.pack_into("<f", block, layout.CONSTANT_TEN_OFFSET, 10.0)
    _put_vectors(block, layout.MARKER_POSITIONS_OFFSET, tool.markers_mm)
    _put_vectors(block, layout.MARKER_NORMALS_OFFSET, tool.normals)
    for index, face in enumerate(tool.faces):
        block[layout.FIRING_SEQUENCE_OFFSET + index] = index
        block[layout.MARKER_FACES_OFFSET + index] = face
        block[layout.MARKER_GROUPS_OFFSET + index] = 1
    block[layout.LEDS_OFFSET : layout.LEDS_OFFSET + 4] = bytes([layout.LED_NONE] * 4)
    block[layout.TOOL_IN_PORT_OFFSET] = layout.TOOL_IN_PORT_PRESENT
    _put_text(block, layout.MANUFACTURER_OFFSET, layout.MANUFACTURER_BYTES, tool.manufacturer)
    _put_text(block, layout.PART_NUMBER_OFFSET, layout.PART_NUMBER_BYTES, tool.part_number)
    block[layout.CONSTANT_NINE_OFFSET] = 9
    block[layout.FLAGS_OFFSET] = layout.FLAG_UNIQUE_GEOMETRY if tool.unique_geometry else 0
    block[layout.MARKER_TYPE_OFFSET] = tool.marker_type
    _put_vectors(block, layout.FACE_NORMALS_OFFSET, tool.face_normals)
    struct.pack_into("<H", block, layout.CHECKSUM_OFFSET, _checksum(block))
    return bytes(block)


def decode_definition(block: bytes, name: str = "definition") -> ToolDefinition:
    """Read a .rom, zero padding allowed; raises NDI-011 with what is wrong with it."""
    if not layout.ROM_BYTES <= len(block) <= layout.ROM_FILE_LIMIT_BYTES or any(block[layout.ROM_BYTES :]):
        raise BadToolFile(f"{name} has {len(block)} bytes", awaited=f"{layout.ROM_BYTES} bytes")
    if block[: len(layout.ROM_MAGIC)] != layout.ROM_MAGIC:
        raise BadToolFile(f"{name} is not a tool definition", awaited="a file that begins with NDI")
    (claimed,) = struct.unpack_from("<H", block, layout.CHECKSUM_OFFSET)
    if claimed != _checksum(block):
        raise BadToolFile(
            f"{name} has a wrong checksum", awaited=f"{_checksum(block):04X}", last=f"{claimed:04X}"
        )
    count = block[layout.MARKER_COUNT_OFFSET]
    if count > layout.ROM_MARKERS:
        raise BadToolFile(f"{name} has {count} markers", limit=str(layout.ROM_MARKERS))
    (revision,) = struct.unpack_from("<H", block, layout.REVISION_OFFSET)
    (serial,) = struct.unpack_from("<I", block, layout.SERIAL_OFFSET)
    (maximum_error_mm,) = struct.unpack_from("<f", block, layout.MAXIMUM_ERROR_OFFSET)
    faces = tuple(block[layout.MARKER_FACES_OFFSET : layout.MARKER_FACES_OFFSET + count])
    tool = ToolDefinition(
        part_number=_text(block, layout.PART_NUMBER_OFFSET, layout.PART_NUMBER_BYTES),
        markers_mm=_vectors(block, layout.MARKER_POSITIONS_OFFSET, count),
        normals=_vectors(block, layout.MARKER_NORMALS_OFFSET, count),
        faces=faces,
        face_normals=_vectors(
            block, layout.FACE_NORMALS_OFFSET, min(layout.ROM_FACES, max(faces, default=0))
        ),
        manufacturer=_text(block, layout.MANUFACTURER_OFFSET, layout.MANUFACTURER_BYTES),
        main_type=block[layout.MAIN_TYPE_OFFSET],
        revision=revision,
        sequence=_bits(serial, layout.SERIAL_SEQUENCE_BITS),
        made_on=_date(serial),
        maximum_angle_deg=block[layout.MAXIMUM_ANGLE_OFFSET],
        minimum_markers=block[layout.MINIMUM_MARKER_COUNT_OFFSET],
        maximum_error_mm=maximum_error_mm,
        minimum_spread_mm=_vectors(block, layout.MINIMUM_SPREAD_OFFSET, 1)[0],
        unique_geometry=bool(block[layout.FLAGS_OFFSET] & layout.FLAG_UNIQUE_GEOMETRY),
        marker_type=block[layout.MARKER_TYPE_OFFSET],
    )
    _check(tool, name)
    return tool


def read_definition(path: Path) -> ToolDefinition:
    """Read a .rom file; raises NDI-011 when it is missing or wrong."""
    try:
        block = path.read_bytes()
    except OSError as error:
        raise BadToolFile(f"cannot read {path.name}: {error.strerror}") from error
    return decode_definition(block, path.name)


def _check(tool: ToolDefinition, name: str = "") -> None:
    where = name or tool.part_number
    count = len(tool.markers_mm)
    if not layout.ROM_MINIMUM_MARKERS <= count <= layout.ROM_MARKERS:
        raise BadToolFile(
            f"{where} has {count} markers", limit=f"{layout.ROM_MINIMUM_MARKERS} to {layout.ROM_MARKERS}"
        )
    if len(tool.normals) != count or len(tool.faces) != count:
        raise BadToolFile(f"{where} needs one normal and one face per marker")
    if not 1 <= len(tool.face_normals) <= layout.ROM_FACES or not all(
        1 <= face <= len(tool.face_normals) for face in tool.faces
    ):
        raise BadToolFile(f"{where} names a face that it does not have", limit=f"1 to {layout.ROM_FACES}")
    if not layout.ROM_MINIMUM_MARKERS <= tool.minimum_markers <= count:
        raise BadToolFile(f"{where} needs {tool.minimum_markers} of {count} markers", limit=f"3 to {count}")
    numbers = [value for vector in (*tool.markers_mm, *tool.normals, *tool.face_normals) for value in vector]
    if not all(math.isfinite(value) for value in (*numbers, tool.maximum_error_mm, *tool.minimum_spread_mm)):
        raise BadToolFile(f"{where} holds numbers that are not finite")
    if tool.maximum_error_mm <= 0 or not 0 <= tool.maximum_angle_deg <= 180:
        raise BadToolFile(f"{where} has an impossible maximum error or angle")


def _checksum(block: bytes | bytearray) -> int:
    return sum(block[layout.CHECKSUM_FROM :]) & 0xFFFF


def _serial(tool: ToolDefinition) -> int:
    day_of_year = tool.made_on.timetuple().tm_yday - 1
    return (
        _placed(tool.sequence, layout.SERIAL_SEQUENCE_BITS)
        | _placed(day_of_year, layout.SERIAL_DAY_BITS)
        | _placed(tool.made_on.month - 1, layout.SERIAL_MONTH_BITS)
        | _placed(tool.made_on.year - layout.SERIAL_FIRST_YEAR, layout.SERIAL_YEAR_BITS)
    )


def _date(serial: int) -> date:
    # The day of the year decides; the month field repeats it and is not needed.
    first = date(layout.SERIAL_FIRST_YEAR + _bits(serial, layout.SERIAL_YEAR_BITS), 1, 1)
    return first + timedelta(days=_bits(serial, layout.SERIAL_DAY_BITS))


def _placed(value: int, bits: tuple[int, int]) -> int:
    return (value & ((1 << bits[1]) - 1)) << bits[0]


def _bits(value: int, bits: tuple[int, int]) -> int:
    return value >> bits[0] & ((1 << bits[1]) - 1)


def _put_vectors(block: bytearray, offset: int, vectors: tuple[Vector3, ...]) -> None:
    for index, vector in enumerate(vectors):
        _F3.pack_into(block, offset + index * _F3.size, *vector)


def _vectors(block: bytes, offset: int, count: int) -> tuple[Vector3, ...]:
    triples = (_F3.unpack_from(block, offset + index * _F3.size) for index in range(count))
    return tuple((x, y, z) for x, y, z in triples)


def _put_text(block: bytearray, offset: int, size: int, text: str) -> None:
    try:
        encoded = text.encode("ascii")
    except UnicodeEncodeError as error:
        raise BadToolFile(f"{text!r} is not plain ASCII") from error
    if len(encoded) > size:
        raise BadToolFile(f"{text!r} is too long", limit=f"{size} characters")
    block[offset : offset + len(encoded)] = encoded


def _text(block: bytes, offset: int, size: int) -> str:
    return block[offset : offset + size].split(b"\0", 1)[0].decode("ascii", "replace").strip()
