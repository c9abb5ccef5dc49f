"""Differences between two tool definitions, field by field; markers by their distance in mm."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from drivers.ndi_polaris.rom.definition import ToolDefinition, decode_definition, encode_definition
from drivers.ndi_polaris.rom.fields import FIELDS
from drivers.ndi_polaris.tools.geometry import segment_lengths_mm
from ronna_hw.wire import polaris_rom as layout

PER_MARKER = ("markers_mm", "normals", "faces", "face_normals")
CHECKSUM_BYTES = 2


@dataclass(frozen=True)
class Difference:
    """One property that differs. `distance_mm` is the distance between two marker positions."""

    field: str
    first: str
    second: str
    distance_mm: float | None = None


def compare_definitions(first: ToolDefinition, second: ToolDefinition) -> tuple[Difference, ...]:
    """Every difference, in the order of the fields, then the bytes that no published field explains.

    The checksum is ignored, since it follows from the rest. Empty if and only if all other bytes agree.
    """
    # in single precision, as in files: a tool must not differ from its own file
    first, second = (decode_definition(encode_definition(tool)) for tool in (first, second))
    found: list[Difference] = []
    for property_ in FIELDS:
        mine, theirs = getattr(first, property_.name), getattr(second, property_.name)
        if mine == theirs:
            continue
        if property_.name in PER_MARKER:
            found += _per_marker(property_.name, mine, theirs)
        else:
            found.append(Difference(property_.name, _said(mine), _said(theirs)))
    return (*found, *_unexplained(encode_definition(first), encode_definition(second), found))


def largest_segment_difference_mm(first: ToolDefinition, second: ToolDefinition) -> float | None:
    """Largest difference between segment lengths, independent of the tools' origins.

    Segments are paired in order of length. None for unequal numbers of markers.
    """
    if len(first.markers_mm) != len(second.markers_mm):
        return None
    pairs = zip(segment_lengths_mm(first.markers_mm), segment_lengths_mm(second.markers_mm), strict=True)
    return max(abs(a - b) for a, b in pairs)


def _per_marker(name: str, mine: tuple[Any, ...], theirs: tuple[Any, ...]) -> list[Difference]:
    found = []
    if len(mine) != len(theirs):
        found.append(Difference(f"number of {name}", str(len(mine)), str(len(theirs))))
    for index in range(max(len(mine), len(theirs))):
        a = mine[index] if index < len(mine) else None
        b = theirs[index] if index < len(theirs) else None
        if a == b:
            continue
        moved = math.dist(a, b) if name == "markers_mm" and a is not None and b is not None else None
        found.append(Difference(f"{name}[{index + 1}]", _said(a), _said(b), moved))
    return found


def _unexplained(mine: bytes, theirs: bytes, named: list[Difference]) -> list[Difference]:
    """Runs of differing bytes outside all fields, or inside a field whose value is the same."""
    named_fields = {difference.field.removeprefix("number of ").partition("[")[0] for difference in named}
    explained = set(range(layout.CHECKSUM_OFFSET, layout.CHECKSUM_OFFSET + CHECKSUM_BYTES))
    for property_ in FIELDS:
        if property_.name in named_fields:
            for offset, size in property_.spans:
                explained.update(range(offset, offset + size))
    found = []
    start = None
    for at in range(layout.ROM_BYTES + 1):
        differs = at < layout.ROM_BYTES and mine[at] != theirs[at] and at not in explained
        if differs and start is None:
            start = at
        elif not differs and start is not None:
            where = f"byte {start}" if at == start + 1 else f"bytes {start} to {at - 1}"
            found.append(Difference(where, mine[start:at].hex(" "), theirs[start:at].hex(" ")))
            start = None
    return found


def _said(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, tuple):
        return " ".join(_said(item) for item in value)
    return f"{value:.7g}" if isinstance(value, float) else str(value)
