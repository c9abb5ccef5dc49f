"""Fixtures for Polaris cases: requirements, tool definitions, volumes and tracking frames.

A case's number is P (the unit) or D (its driver) and a line of the checklist, with a letter if a line has
several cases. Every case leaves the unit initialised, idle and without tools.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from conformance.case import Need, check, require_present
from conformance.device_under_test import DeviceUnderTest
from conformance.polaris.client import BxReply, PolarisLink, Vector3, idle_unit, read_body
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import Validity
from ronna_hw.wire import polaris_rom as layout
from ronna_hw.wire.polaris import PARAMETER_SELECTED_VOLUME, SFLIST_VOLUME_CHARACTERS

POLARIS_BYTES = Need("polaris bytes", "the tracker has no single endpoint to which bytes could be sent")
TOOL_DEFINITION = Need("tool definition", "no tool definition is configured")
SERIAL_LINE = Need("serial line", "the endpoint is not a serial line: it has neither baud rate nor break")

NEEDS = (POLARIS_BYTES,)
WITH_TOOL = (*NEEDS, TOOL_DEFINITION)
SERIAL = (*NEEDS, SERIAL_LINE)

FRAMES_LOOKED_AT = 5  # for a tool in view


@runtime_checkable
class ReportsDefinitions(Protocol):
    """Tracker that reports the tool definitions that it loads."""

    @property
    def definition_blocks(self) -> dict[str, bytes]:
        """Tool definitions by tool name."""
        ...


@runtime_checkable
class ReportsBaud(Protocol):
    """Tracker that reports its baud rate."""

    @property
    def baud(self) -> int | None:
        """Current baud rate, or None if the line is not serial."""
        ...


def definition(dut: DeviceUnderTest) -> bytes:
    """Return the definition of a tool in view, or the first one if none is."""
    if dut.tool_in_view is None:
        dut.tool_in_view = _find_tool_in_view(dut)
    tracker = dut.make()
    assert isinstance(tracker, ReportsDefinitions), "the case needs a tool definition"
    blocks = tracker.definition_blocks
    return blocks.get(dut.tool_in_view) or next(iter(blocks.values()))


def _find_tool_in_view(dut: DeviceUnderTest) -> str:
    """Return the name of the first tool that a few frames show, or ''. Closes the driver's connection."""
    tracker = dut.at(Lifecycle.ACTIVE)
    frames = [tracker.read_frame() for _ in range(FRAMES_LOOKED_AT)]
    dut.release()
    seen = (tool.tool for frame in frames for tool in frame.tools if tool.validity is Validity.OK)
    return next(seen, "")


@contextmanager
def unit_with_tool(dut: DeviceUnderTest) -> Iterator[PolarisLink]:
    """Yield an idle unit whose `definition` is the driver's first tool definition."""
    block = definition(dut)
    with idle_unit(dut) as unit:
        unit.definition = block
        yield unit


def read_frame(unit: PolarisLink, options: int = 0x0001) -> BxReply:
    """Read a frame with BX."""
    return read_body(unit.ask_binary(f"BX:{options:04X}"), options)


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


def read_markers(block: bytes) -> tuple[Vector3, ...]:
    """Read the marker positions from a tool definition, mm."""
    count = block[layout.MARKER_COUNT_OFFSET]
    flat = struct.unpack_from(f"<{3 * count}f", block, layout.MARKER_POSITIONS_OFFSET)
    return tuple((flat[k], flat[k + 1], flat[k + 2]) for k in range(0, 3 * count, 3))


def shift_origin(block: bytes, shift_mm: Vector3 = (0.0, 0.0, 0.0)) -> bytes:
    """Move every marker of a tool definition by `shift_mm` in the tool frame.

    It has its own part number, so that a simulated unit does not know where its spheres really are.
    """
    changed = bytearray(block)
    number = slice(layout.PART_NUMBER_OFFSET, layout.PART_NUMBER_OFFSET + layout.PART_NUMBER_BYTES)
    changed[number] = SHIFTED_PART.ljust(layout.PART_NUMBER_BYTES, b"\0")
    for slot, marker in enumerate(read_markers(block)):
        values = (value + offset_mm for value, offset_mm in zip(marker, shift_mm, strict=True))
        struct.pack_into("<3f", changed, layout.MARKER_POSITIONS_OFFSET + 12 * slot, *values)
    return _seal(changed)


def reverse_normals(block: bytes) -> bytes:
    changed = bytearray(block)
    count = block[layout.MARKER_COUNT_OFFSET]
    for slot in range(count):
        at = layout.MARKER_NORMALS_OFFSET + 12 * slot
        normal = struct.unpack_from("<3f", block, at)
        struct.pack_into("<3f", changed, at, *(-value for value in normal))
    return _seal(changed)


def build_published_definition() -> bytes:
    """Build a definition in the published layout with the numbers of a real tool."""
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
    return _seal(block)


def _seal(block: bytearray) -> bytes:
    total = sum(block[layout.CHECKSUM_FROM :]) & 0xFFFF
    struct.pack_into("<H", block, layout.CHECKSUM_OFFSET, total)
    return bytes(block)


_RECORD = re.compile(r"([0-9A-F])((?:[+-][0-9]{6}){10}).*", re.DOTALL)
# As described by two real units: far, knee and near z, half extents y and x at the knee, slopes of |y| in
# front of and behind it, of |x|, caps of |y| and |x|.
SPECTRA_VOLUMES = (
    (-240000, -153200, -95000, 57200, 39800, 56946, 24303, 29773, 999999, 999999),
    (-300000, -153200, -95000, 57200, 39800, 56946, 24303, 29773, 999999, 73500),
)
SPECTRA_SHAPE, VICRA_SHAPE = "5", "7"


@dataclass(frozen=True)
class StatedVolume:
    """Measuring volume: shape and ten numbers, in hundredths of a mm and of a slope per 1000."""

    shape: str
    numbers: tuple[int, ...]

    @property
    def knee_mm(self) -> float:
        """Depth z at which the slope of the |y| limit changes, mm."""
        return self.numbers[1] / 100

    @property
    def depths_mm(self) -> tuple[float, float]:
        """Depths z of the far and the near face, mm."""
        return self.numbers[0] / 100, self.numbers[2] / 100

    @property
    def middle_mm(self) -> float:
        """Depth z well inside the volume, mm: the knee, or the midpoint if the knee is at a face."""
        far_mm, near_mm = self.depths_mm
        return self.knee_mm if far_mm < self.knee_mm < near_mm else (far_mm + near_mm) / 2

    def half_extents_mm(self, z_mm: float) -> tuple[float, float]:
        """Return the |x| and |y| limits of the volume at a depth, mm."""
        _, knee, _, y_knee, x_knee, y_front, y_behind, x_slope, y_cap, x_cap = self.numbers
        behind_mm = knee / 100 - z_mm  # negative in front of the knee
        y_mm = y_knee / 100 + behind_mm * (y_behind if behind_mm > 0 else y_front) / 1e5
        x_mm = x_knee / 100 + behind_mm * x_slope / 1e5
        return min(x_mm, x_cap / 100), min(y_mm, y_cap / 100)

    def clearance_mm(self, point_mm: Vector3) -> float:
        """Return the axis-parallel distance of a point to the nearest face, mm; negative outside."""
        x, y, z = point_mm
        far_mm, near_mm = self.depths_mm
        x_mm, y_mm = self.half_extents_mm(z)
        return min(x_mm - abs(x), y_mm - abs(y), z - far_mm, near_mm - z)


def measuring_volumes(unit: PolarisLink) -> tuple[StatedVolume, ...]:
    """Read the measuring volumes with SFLIST 03; every record must have the exact length."""
    text = unit.ask("SFLIST:03")
    records = text[1:].splitlines(keepends=True)
    check(text[:1].isdigit() and int(text[:1]) == len(records), "as many volumes as announced", text[:1])
    volumes = []
    for record in records:
        check(len(record) == SFLIST_VOLUME_CHARACTERS, "74 characters with the line feed", len(record))
        match = require_present(_RECORD.fullmatch(record), "a shape and ten numbers", record)
        numbers = tuple(int(match[2][at : at + 7]) for at in range(0, 70, 7))
        volumes.append(StatedVolume(match[1], numbers))
    return tuple(volumes)


def volume_in_use(unit: PolarisLink) -> StatedVolume:
    """Return the selected volume, or the first if the unit does not report its selection."""
    volumes = measuring_volumes(unit)
    value = unit.ask(f"GET:{PARAMETER_SELECTED_VOLUME}").partition("=")[2].strip()
    return volumes[int(value)] if value.isdecimal() and int(value) < len(volumes) else volumes[0]
