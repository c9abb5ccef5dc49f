"""Tool definitions for the cases: variants of a given one, and one made from published numbers."""

from __future__ import annotations

import struct

from conformance.polaris.bx_reply import Vector3
from ronna_hw.wire import polaris_rom as layout

# A real four-sphere rigid body, part 8700339, with the numbers from the manufacturer's file.
PUBLISHED_PART = b"8700339"
PUBLISHED_MAKER = b"NDI"
PUBLISHED_SERIAL = 0x34801403  # sequence 3 of 2005-01-06
PUBLISHED_MARKERS_MM: tuple[Vector3, ...] = (
    (0.0, 0.0, 0.0),
    (28.59, 41.02, 0.0),
    (0.0, 88.0, 0.0),
    (-44.32, 40.45, 0.0),
)
PUBLISHED_ERROR_MM = 0.75
SHIFTED_PART = b"CONFORMANCE"


def markers_of(block: bytes) -> tuple[Vector3, ...]:
    """Marker positions of a definition, mm."""
    count = block[layout.MARKER_COUNT_OFFSET]
    flat = struct.unpack_from(f"<{3 * count}f", block, layout.MARKER_POSITIONS_OFFSET)
    return tuple((flat[k], flat[k + 1], flat[k + 2]) for k in range(0, 3 * count, 3))


def shifted(block: bytes, shift_mm: Vector3 = (0.0, 0.0, 0.0)) -> bytes:
    """The same tool with another origin: every marker moves by `shift_mm` in the tool frame.

    It has its own part number, so that a simulated unit does not know where its spheres really are.
    """
    changed = bytearray(block)
    number = slice(layout.PART_NUMBER_OFFSET, layout.PART_NUMBER_OFFSET + layout.PART_NUMBER_BYTES)
    changed[number] = SHIFTED_PART.ljust(layout.PART_NUMBER_BYTES, b"\0")
    for slot, marker in enumerate(markers_of(block)):
        values = (value + move for value, move in zip(marker, shift_mm, strict=True))
        struct.pack_into("<3f", changed, layout.MARKER_POSITIONS_OFFSET + 12 * slot, *values)
    return _sealed(changed)


def looking_away(block: bytes) -> bytes:
    """The same tool with all marker normals reversed, so that no marker faces the unit."""
    changed = bytearray(block)
    count = block[layout.MARKER_COUNT_OFFSET]
    for slot in range(count):
        at = layout.MARKER_NORMALS_OFFSET + 12 * slot
        normal = struct.unpack_from("<3f", block, at)
        struct.pack_into("<3f", changed, at, *(-value for value in normal))
    return _sealed(changed)


def published() -> bytes:
    """A definition with the numbers of a real one, assembled from the published layout."""
    block = bytearray(layout.ROM_BYTES)
    count = len(PUBLISHED_MARKERS_MM)
    block[:4] = layout.ROM_MAGIC
    block[layout.CONSTANT_ONE_OFFSET] = 1
    block[layout.MAIN_TYPE_OFFSET] = layout.MAIN_TYPE_REFERENCE
    struct.pack_into("<I", block, layout.SERIAL_OFFSET, PUBLISHED_SERIAL)
    block[layout.MAXIMUM_ANGLE_OFFSET] = 90
    block[layout.MARKER_COUNT_OFFSET] = block[layout.MINIMUM_MARKER_COUNT_OFFSET] = count
    struct.pack_into("<f", block, layout.MAXIMUM_ERROR_OFFSET, PUBLISHED_ERROR_MM)
    struct.pack_into("<f", block, layout.CONSTANT_TEN_OFFSET, 10.0)
    for slot, marker in enumerate(PUBLISHED_MARKERS_MM):
        struct.pack_into("<3f", block, layout.MARKER_POSITIONS_OFFSET + 12 * slot, *marker)
        struct.pack_into("<3f", block, layout.MARKER_NORMALS_OFFSET + 12 * slot, 0.0, 0.0, 1.0)
        block[layout.FIRING_SEQUENCE_OFFSET + slot] = slot
        block[layout.MARKER_FACES_OFFSET + slot] = block[layout.MARKER_GROUPS_OFFSET + slot] = 1
    block[layout.LEDS_OFFSET : layout.LEDS_OFFSET + 4] = bytes([layout.LED_NONE] * 4)
    block[layout.TOOL_IN_PORT_OFFSET] = layout.TOOL_IN_PORT_PRESENT
    for offset, text in (
        (layout.MANUFACTURER_OFFSET, PUBLISHED_MAKER),
        (layout.PART_NUMBER_OFFSET, PUBLISHED_PART),
    ):
        block[offset : offset + len(text)] = text
    block[layout.CONSTANT_NINE_OFFSET] = 9
    block[layout.FLAGS_OFFSET] = layout.FLAG_UNIQUE_GEOMETRY
    block[layout.MARKER_TYPE_OFFSET] = layout.MARKER_PASSIVE_SPHERE
    struct.pack_into("<3f", block, layout.FACE_NORMALS_OFFSET, 0.0, 0.0, -1.0)
    return _sealed(block)


def _sealed(block: bytearray) -> bytes:
    total = sum(block[layout.CHECKSUM_FROM :]) & 0xFFFF
    struct.pack_into("<H", block, layout.CHECKSUM_OFFSET, total)
    return bytes(block)
