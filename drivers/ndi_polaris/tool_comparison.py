"""Comparison of tool definitions, by field and by the marker distances that identify a tool."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from drivers.ndi_polaris.errors import SAME_GEOMETRY
from drivers.ndi_polaris.tool_definition import FIELDS, ToolDefinition, decode_definition, encode_definition
from ronna_hw.vectors import Vector3
from ronna_hw.wire import polaris_rom as layout

# Segments closer in length than this may be confused: "a few mm" by the guide; NDI's own tools keep 5 mm.
SEGMENT_TOLERANCE_MM = 3.5
TRIANGLE_TOLERANCE_MM = 2.0  # triangles within this are the same to the unit: such tools are refused
TRIANGLE_CORNERS = 3
NO_FILES: Mapping[str, str] = {}
PER_MARKER = ("markers_mm", "normals", "faces", "face_normals")
CHECKSUM_BYTES = 2


@dataclass(frozen=True)
class Difference:
    """Difference in one property; `distance_mm` is the distance between differing marker positions."""

    field: str
    first: str
    second: str
    distance_mm: float | None = None


def compare_definitions(first: ToolDefinition, second: ToolDefinition) -> tuple[Difference, ...]:
    """List all differences in field order, followed by differing bytes that no field explains.

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
            found += _find_marker_differences(property_.name, mine, theirs)
        else:
            found.append(Difference(property_.name, _format_value(mine), _format_value(theirs)))
    return (
        *found,
        *_find_unexplained_differences(encode_definition(first), encode_definition(second), found),
    )


def _find_marker_differences(name: str, mine: tuple[Any, ...], theirs: tuple[Any, ...]) -> list[Difference]:
    found = []
    if len(mine) != len(theirs):
        found.append(Difference(f"number of {name}", str(len(mine)), str(len(theirs))))
    for number, (a, b) in enumerate(itertools.zip_longest(mine, theirs), start=1):
        if a != b:
            moved = math.dist(a, b) if name == "markers_mm" and a is not None and b is not None else None
            found.append(Difference(f"{name}[{number}]", _format_value(a), _format_value(b), moved))
    return found


def _find_unexplained_differences(mine: bytes, theirs: bytes, named: list[Difference]) -> list[Difference]:
    """Find runs of differing bytes that differences in named fields do not explain."""
    named_fields = {difference.field.removeprefix("number of ").partition("[")[0] for difference in named}
    explained = set(range(layout.CHECKSUM_OFFSET, layout.CHECKSUM_OFFSET + CHECKSUM_BYTES))
    for property_ in FIELDS:
        if property_.name in named_fields:
            for offset, size in property_.spans:
                explained.update(range(offset, offset + size))

    def is_unexplained(at: int) -> bool:
        return mine[at] != theirs[at] and at not in explained

    found = []
    for differs, run in itertools.groupby(range(layout.ROM_BYTES), is_unexplained):
        if differs:
            first, *others = run
            span = slice(first, first + 1 + len(others))
            span_text = f"bytes {first} to {others[-1]}" if others else f"byte {first}"
            found.append(Difference(span_text, mine[span].hex(" "), theirs[span].hex(" ")))
    return found


def _format_value(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, tuple):
        return " ".join(_format_value(item) for item in value)
    return f"{value:.7g}" if isinstance(value, float) else str(value)


def largest_segment_difference_mm(first: ToolDefinition, second: ToolDefinition) -> float | None:
    """Return the largest difference in segment length, mm, independent of the tools' origins.

    Segments are paired in order of length. None for unequal numbers of markers.
    """
    if len(first.markers_mm) != len(second.markers_mm):
        return None
    pairs = zip(segment_lengths_mm(first.markers_mm), segment_lengths_mm(second.markers_mm), strict=True)
    return max(abs(a - b) for a, b in pairs)


@dataclass(frozen=True)
class AlikeSegments:
    """Two indistinguishable marker distances, in two tools or within one."""

    first_tool: str
    second_tool: str
    first_mm: float
    second_mm: float

    def __str__(self) -> str:
        lengths = f"{self.first_mm:.1f} and {self.second_mm:.1f} mm"
        if self.first_tool == self.second_tool:
            return f"{self.first_tool}: marker distances {lengths} are too similar"
        return f"{self.first_tool} and {self.second_tool} share a marker distance: {lengths}"


def find_alike(
    tools: Mapping[str, ToolDefinition], tolerance_mm: float = SEGMENT_TOLERANCE_MM
) -> tuple[AlikeSegments, ...]:
    """Find all pairs of segments too similar for unique geometry, within each tool and between tools."""
    lengths_mm = {name: segment_lengths_mm(tool.markers_mm) for name, tool in tools.items()}
    within = [
        AlikeSegments(name, name, a, b)
        for name, lengths in lengths_mm.items()
        for a, b in itertools.pairwise(lengths)
        if b - a < tolerance_mm
    ]
    between = [
        AlikeSegments(name, other_name, a, b)
        for (name, lengths), (other_name, others) in itertools.combinations(lengths_mm.items(), 2)
        for a, b in itertools.product(lengths, others)
        if abs(a - b) < tolerance_mm
    ]
    return (*within, *between)


def check_distinct(tools: Mapping[str, ToolDefinition], files: Mapping[str, str] = NO_FILES) -> None:
    """Raise NDI-012 if any two tools share a triangle of markers; `files` are their definitions by name."""
    for (name, tool), (other_name, other) in itertools.combinations(tools.items(), 2):
        if shares_triangle(tool, other):
            raise SAME_GEOMETRY(
                f"tools {_with_file(name, files)} and {_with_file(other_name, files)} share a triangle of "
                "markers",
                limit=f"{TRIANGLE_TOLERANCE_MM} mm between distances",
            )


def _with_file(name: str, files: Mapping[str, str]) -> str:
    return f"{name} ({files[name]})" if name in files else name


def shares_triangle(first: ToolDefinition, second: ToolDefinition) -> bool:
    """Return whether any three markers of one tool are congruent with three of the other."""
    triangles = [
        segment_lengths_mm(corners) for corners in itertools.combinations(second.markers_mm, TRIANGLE_CORNERS)
    ]
    return any(
        all(abs(a - b) < TRIANGLE_TOLERANCE_MM for a, b in zip(lengths, other, strict=True))
        for corners in itertools.combinations(first.markers_mm, TRIANGLE_CORNERS)
        for lengths in [segment_lengths_mm(corners)]
        for other in triangles
    )


def segment_lengths_mm(markers_mm: tuple[Vector3, ...]) -> tuple[float, ...]:
    """Return all distances between pairs of markers, mm, in ascending order."""
    return tuple(sorted(math.dist(a, b) for a, b in itertools.combinations(markers_mm, 2)))
