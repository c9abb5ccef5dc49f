"""Tool definitions: reading and writing .rom files. Lengths in mm, in the tool's own frame."""

from __future__ import annotations

import hashlib
import math
import struct
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path

from drivers.ndi_polaris.errors import BadToolFile
from drivers.ndi_polaris.rom.fields import FIELDS, blank_block, checksum
from ronna_hw.bounded_input import InputRefused, read_bounded
from ronna_hw.devices.readings import Vector3
from ronna_hw.wire import polaris_rom as layout

LARGEST_ANGLE_DEG = 180
LARGEST_FILE_BYTES = 65_536  # far more than a definition; a file of another length is rejected by it


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


def planar_tool(
    part_number: str,
    markers_mm: tuple[Vector3, ...],
    normal: Vector3 = (0.0, 0.0, 1.0),
    *,
    manufacturer: str,
    made_on: date,
) -> ToolDefinition:
    """A tool with one face whose markers all face along `normal`, like most passive rigid bodies."""
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
    """Normal of a face whose markers face along `normal`: real files use the opposite direction."""
    return -normal[0] or 0.0, -normal[1] or 0.0, -normal[2] or 0.0


def encode_definition(tool: ToolDefinition) -> bytes:
    """The 752 bytes of a .rom; raises NDI-011 for an impossible definition.

    An unchanged definition yields exactly the bytes that were read.
    """
    _check(tool)
    block = bytearray(tool.origin)
    for property_ in FIELDS:
        value = getattr(tool, property_.name)
        if property_.read(bytes(block)) != value:
            property_.write(block, value)
    struct.pack_into("<H", block, layout.CHECKSUM_OFFSET, checksum(block))
    return bytes(block)


def decode_definition(block: bytes, name: str = "definition") -> ToolDefinition:
    """Parse the bytes of a .rom, zero padding allowed; raises NDI-011."""
    if not layout.ROM_BYTES <= len(block) <= layout.ROM_FILE_LIMIT_BYTES or any(block[layout.ROM_BYTES :]):
        raise BadToolFile(f"{name} has {len(block)} bytes", expected=f"{layout.ROM_BYTES} bytes")
    if block[: len(layout.ROM_MAGIC)] != layout.ROM_MAGIC:
        raise BadToolFile(f"{name} is not a tool definition", expected="a file that starts with NDI")
    (claimed,) = struct.unpack_from("<H", block, layout.CHECKSUM_OFFSET)
    if claimed != checksum(block):
        raise BadToolFile(
            f"{name} has a wrong checksum", expected=f"{checksum(block):04X}", got=f"{claimed:04X}"
        )
    count = block[layout.MARKER_COUNT_OFFSET]
    if count > layout.ROM_MARKERS:
        raise BadToolFile(f"{name} has {count} markers", limit=str(layout.ROM_MARKERS))
    origin = bytes(block[: layout.ROM_BYTES])
    values = {property_.name: property_.read(origin) for property_ in FIELDS}
    tool = ToolDefinition(**values, origin=origin)
    _check(tool, name)
    return tool


def read_definition(path: Path) -> ToolDefinition:
    """Read a .rom file; raises NDI-011 if it is missing or invalid."""
    try:
        block = read_bounded(path, LARGEST_FILE_BYTES)
    except InputRefused as error:
        raise BadToolFile(error.summary) from error
    except OSError as error:
        raise BadToolFile(f"cannot read {path.name}: {error.strerror}") from error
    return decode_definition(block, path.name)


def definition_hash(tool: ToolDefinition) -> str:
    """SHA-256 of the 752 bytes, in hex."""
    return hashlib.sha256(encode_definition(tool)).hexdigest()


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
        raise BadToolFile(f"{where} has a face number out of range", limit=f"1 to {layout.ROM_FACES}")
    if not layout.ROM_MINIMUM_MARKERS <= tool.minimum_markers <= count:
        raise BadToolFile(
            f"{where} has a minimum of {tool.minimum_markers} of {count} markers", limit=f"3 to {count}"
        )
    numbers = [value for vector in (*tool.markers_mm, *tool.normals, *tool.face_normals) for value in vector]
    if not all(math.isfinite(value) for value in (*numbers, tool.maximum_error_mm, *tool.minimum_spread_mm)):
        raise BadToolFile(f"{where} contains numbers that are not finite")
    if tool.maximum_error_mm <= 0 or not 0 <= tool.maximum_angle_deg <= LARGEST_ANGLE_DEG:
        raise BadToolFile(f"{where} has an impossible maximum error or angle")
