"""Tool definitions: parsing, writing, and checking for unique geometry.

Layout in `ronna_hw.wire.polaris_rom`. Positions in mm and unit normals, both in the tool's own frame. Segment
lengths distinguish a tool from its mirror image and from other tools.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, pairwise

import numpy as np

from ronna_hw.wire import polaris_rom as rom
from sim.polaris.unit.behaviour import UnitBehaviour
from sim.polaris.unit.refusal import WarningCode
from sim.world.rigid import Vectors
from sim.world.scene.model import TrackerTool

MAXIMUM_ANGLE_DEG = 90
MAXIMUM_ERROR_MM = 2.0  # distance of one marker from the fitted definition
MANUFACTURER = "RONNA"
LEAST_NORMAL_LENGTH = 0.5  # a unit vector in single precision is far longer
SUBTYPE_BELOW_TYPE = 1  # in real files the subtype is the main type minus 1
TOOL_GROUP = 1
FIRST_FACE = 1
MOST_GROUPS = 20
TEST_MARKERS_MM = ((0.0, 0.0, 0.0), (0.0, 50.0, 0.0), (70.0, 0.0, 0.0))
CONSTANT_TEN = 10.0
CONSTANT_NINE = 9
# Serial number of written definitions: sequence 1, day 0, month 0, year 2024. Some clients reject zero.
SERIAL = 1 << rom.SERIAL_SEQUENCE_BITS[0] | (2024 - rom.SERIAL_FIRST_YEAR) << rom.SERIAL_YEAR_BITS[0]

_u16 = struct.Struct("<H")
_u32 = struct.Struct("<I")
_f32 = struct.Struct("<f")
_positions = struct.Struct("<60f")
_spreads = struct.Struct("<3f")


WAVELENGTH_BITS = 0x07  # in the marker type


class BadDefinition(Exception):
    """The tool definition is invalid, for its count of markers, faces or groups if `limits` is set."""

    def __init__(self, what: str, *, limits: bool = False) -> None:
        super().__init__(what)
        self.limits = limits


@dataclass(frozen=True)
class ToolDefinition:
    """A parsed tool definition."""

    main_type: int
    subtype: int
    revision: int
    serial: int
    maximum_angle_deg: float
    minimum_markers: int
    maximum_error_mm: float
    markers_mm: Vectors  # (n, 3)
    normals: Vectors  # (n, 3), unit
    manufacturer: str
    part_number: str
    marker_type: int
    flags: int = 0
    faces: tuple[int, ...] = ()  # face of each marker, from 1; empty if there is only one
    # along the principal axes of the markers; 0: any
    minimum_spread_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lit: tuple[bool, bool, bool] = (False, False, False)  # presence of visible LEDs 1 to 3
    switches: tuple[bool, bool, bool] = (False, False, False)
    in_port: bool = False  # presence of a tool-in-port diode
    tracking_led: bool = False

    @cached_property
    def different_faces(self) -> tuple[int, ...]:
        """Face numbers in ascending order, or none if there is only one face."""
        return tuple(sorted(set(self.faces)))


def parse_definition(content: bytes) -> ToolDefinition:
    """Parse a port handle's memory; raises BadDefinition with the first error."""
    if len(content) < rom.ROM_BYTES:
        raise BadDefinition(f"{len(content)} bytes, a definition has {rom.ROM_BYTES}")
    if content[: len(rom.ROM_MAGIC)] != rom.ROM_MAGIC:
        raise BadDefinition("the signature NDI is missing")
    if _u16.unpack_from(content, rom.CHECKSUM_OFFSET)[0] != checksum(content):
        raise BadDefinition("wrong checksum")
    count = content[rom.MARKER_COUNT_OFFSET]
    minimum = content[rom.MINIMUM_MARKER_COUNT_OFFSET]
    if not rom.ROM_MINIMUM_MARKERS <= count <= rom.ROM_MARKERS:
        raise BadDefinition(f"{count} markers", limits=True)
    if not rom.ROM_MINIMUM_MARKERS <= minimum <= count:
        raise BadDefinition(f"a minimum of {minimum} of {count} markers", limits=True)
    maximum_error_mm = _f32.unpack_from(content, rom.MAXIMUM_ERROR_OFFSET)[0]
    if not 0.0 < maximum_error_mm < np.inf:
        raise BadDefinition("the maximum 3D error is not positive")
    faces = tuple(content[rom.MARKER_FACES_OFFSET : rom.MARKER_FACES_OFFSET + count])
    if not all(FIRST_FACE <= face <= rom.ROM_FACES for face in faces):
        raise BadDefinition(f"a face number is not {FIRST_FACE} to {rom.ROM_FACES}", limits=True)
    if max(content[rom.MARKER_GROUPS_OFFSET : rom.MARKER_GROUPS_OFFSET + count]) > MOST_GROUPS:
        raise BadDefinition("a group number is above 20", limits=True)
    leds = [index < count for index in content[rom.LEDS_OFFSET : rom.LEDS_OFFSET + 4]]
    entry = rom.TOOL_IN_PORT_OFFSET
    entries = [value == rom.TOOL_IN_PORT_PRESENT for value in content[entry : entry + 4]]
    return ToolDefinition(
        main_type=content[rom.MAIN_TYPE_OFFSET],
        subtype=content[rom.SUBTYPE_OFFSET],
        revision=_u16.unpack_from(content, rom.REVISION_OFFSET)[0],
        serial=_u32.unpack_from(content, rom.SERIAL_OFFSET)[0],
        maximum_angle_deg=float(content[rom.MAXIMUM_ANGLE_OFFSET]),
        minimum_markers=minimum,
        maximum_error_mm=maximum_error_mm,
        markers_mm=_read_vectors(content, rom.MARKER_POSITIONS_OFFSET, count, "marker positions"),
        normals=_normalize(_read_vectors(content, rom.MARKER_NORMALS_OFFSET, count, "marker normals")),
        manufacturer=_read_text(content, rom.MANUFACTURER_OFFSET, rom.MANUFACTURER_BYTES),
        part_number=_read_text(content, rom.PART_NUMBER_OFFSET, rom.PART_NUMBER_BYTES),
        marker_type=content[rom.MARKER_TYPE_OFFSET],
        flags=content[rom.FLAGS_OFFSET],
        faces=faces,
        minimum_spread_mm=_spreads.unpack_from(content, rom.MINIMUM_SPREAD_OFFSET),
        lit=(leds[1], leds[2], leds[3]),
        switches=(entries[1], entries[2], entries[3]),
        in_port=entries[0],
        tracking_led=leds[0],
    )


def write_definition(tool: TrackerTool) -> bytes:
    """Write the 752-byte definition file of a passive tool with one face."""
    count = len(tool.markers_mm)
    content = bytearray(rom.ROM_BYTES)
    content[: len(rom.ROM_MAGIC)] = rom.ROM_MAGIC
    content[rom.CONSTANT_ONE_OFFSET] = 1
    content[rom.MAIN_TYPE_OFFSET] = rom.MAIN_TYPE_REFERENCE
    content[rom.SUBTYPE_OFFSET] = rom.MAIN_TYPE_REFERENCE - SUBTYPE_BELOW_TYPE
    _u32.pack_into(content, rom.SERIAL_OFFSET, SERIAL)
    content[rom.MAXIMUM_ANGLE_OFFSET] = MAXIMUM_ANGLE_DEG
    content[rom.MARKER_COUNT_OFFSET] = count
    content[rom.MINIMUM_MARKER_COUNT_OFFSET] = rom.ROM_MINIMUM_MARKERS
    _f32.pack_into(content, rom.MAXIMUM_ERROR_OFFSET, MAXIMUM_ERROR_MM)
    _f32.pack_into(content, rom.CONSTANT_TEN_OFFSET, CONSTANT_TEN)
    for slot, marker in enumerate(tool.markers_mm):
        struct.pack_into("<3f", content, rom.MARKER_POSITIONS_OFFSET + 12 * slot, *marker)
        struct.pack_into("<3f", content, rom.MARKER_NORMALS_OFFSET + 12 * slot, *tool.normal)
        content[rom.MARKER_FACES_OFFSET + slot] = FIRST_FACE
        content[rom.MARKER_GROUPS_OFFSET + slot] = TOOL_GROUP
    for slot in range(rom.ROM_MARKERS):
        content[rom.FIRING_SEQUENCE_OFFSET + slot] = slot
    content[rom.LEDS_OFFSET : rom.LEDS_OFFSET + 4] = bytes([rom.LED_NONE] * 4)
    content[rom.TOOL_IN_PORT_OFFSET] = rom.TOOL_IN_PORT_PRESENT
    _put_text(content, rom.MANUFACTURER_OFFSET, rom.MANUFACTURER_BYTES, MANUFACTURER)
    _put_text(content, rom.PART_NUMBER_OFFSET, rom.PART_NUMBER_BYTES, tool.part_number)
    content[rom.CONSTANT_NINE_OFFSET] = CONSTANT_NINE
    content[rom.FLAGS_OFFSET] = rom.FLAG_UNIQUE_GEOMETRY
    content[rom.MARKER_TYPE_OFFSET] = rom.MARKER_PASSIVE_SPHERE
    # In real files the face normal points against the marker normals.
    struct.pack_into("<3f", content, rom.FACE_NORMALS_OFFSET, *(-value + 0.0 for value in tool.normal))
    _u16.pack_into(content, rom.CHECKSUM_OFFSET, checksum(bytes(content)))
    return bytes(content)


def build_test_definition() -> bytes:
    """Build the test definition loaded by TTCFG for a wired tool without memory."""
    tool = TrackerTool(name="test", part_number="TEST", markers_mm=TEST_MARKERS_MM)
    return write_definition(tool)


def checksum(content: bytes) -> int:
    """Return the checksum of a definition, unaffected by zero padding."""
    return sum(content[rom.CHECKSUM_FROM :]) & 0xFFFF


def _read_vectors(content: bytes, offset: int, count: int, what: str) -> Vectors:
    values = np.array(_positions.unpack_from(content, offset)[: 3 * count]).reshape(count, 3)
    if not np.isfinite(values).all():
        raise BadDefinition(f"{what}: not finite numbers")
    return values


def _normalize(normals: Vectors) -> Vectors:
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    if (lengths < LEAST_NORMAL_LENGTH).any():
        raise BadDefinition("a marker normal has length zero")
    unit: Vectors = normals / lengths
    return unit


def _read_text(content: bytes, offset: int, length: int) -> str:
    raw = content[offset : offset + length].split(b"\0", 1)[0]
    return "".join(chr(byte) if 32 <= byte < 127 else "?" for byte in raw)


def _put_text(content: bytearray, offset: int, length: int, text: str) -> None:
    content[offset : offset + length] = text.encode("ascii")[:length].ljust(length, b"\0")


def warning_of(
    tool: ToolDefinition, others: list[ToolDefinition], behaviour: UnitBehaviour
) -> WarningCode | None:
    """Return the PINIT warning for a tool among others, or None for a valid tool."""
    unique = _has_unique_segments(tool, behaviour)
    conflicts = any(_conflicts(tool, other, behaviour) for other in others)
    if not unique:
        return WarningCode.NOT_UNIQUE_AND_CONFLICTS if conflicts else WarningCode.GEOMETRY_NOT_UNIQUE
    if conflicts:
        return WarningCode.CONFLICTS_WITH_TOOL
    return None if tool.marker_type else WarningCode.DEFAULT_WAVELENGTH


def wavelength_of(tool: ToolDefinition) -> int:
    """Return the wavelength code for a tool's markers."""
    return tool.marker_type & WAVELENGTH_BITS


def _is_judged(tool: ToolDefinition, behaviour: UnitBehaviour) -> bool:
    return bool(tool.flags & rom.FLAG_UNIQUE_GEOMETRY) or not behaviour.judges_only_flagged


def _has_unique_segments(tool: ToolDefinition, behaviour: UnitBehaviour) -> bool:
    if not _is_judged(tool, behaviour):
        return True
    lengths = sorted(_segments_mm(tool).values())
    return all(b - a >= behaviour.segment_tolerance_mm for a, b in pairwise(lengths))


def _conflicts(tool: ToolDefinition, other: ToolDefinition, behaviour: UnitBehaviour) -> bool:
    if not (_is_judged(tool, behaviour) and _is_judged(other, behaviour)):
        return False
    tolerance_mm = behaviour.conflict_tolerance_mm
    ours, theirs = _segments_mm(tool), _segments_mm(other)
    if behaviour.conflict == "segment":
        return any(abs(a - b) < tolerance_mm for a in ours.values() for b in theirs.values())
    triangles = np.array(_triangles_mm(theirs, len(other.markers_mm)))
    return any(
        (np.abs(triangles - triangle).max(axis=1) < tolerance_mm).any()
        for triangle in _triangles_mm(ours, len(tool.markers_mm))
    )


def _segments_mm(tool: ToolDefinition) -> dict[tuple[int, int], float]:
    markers = tool.markers_mm
    pairs = combinations(range(len(markers)), 2)
    return {(a, b): float(np.linalg.norm(markers[a] - markers[b])) for a, b in pairs}


def _triangles_mm(segments_mm: dict[tuple[int, int], float], markers: int) -> list[list[float]]:
    """Return the ascending side lengths of every triangle of markers."""
    return [
        sorted((segments_mm[a, b], segments_mm[a, c], segments_mm[b, c]))
        for a, b, c in combinations(range(markers), 3)
    ]
