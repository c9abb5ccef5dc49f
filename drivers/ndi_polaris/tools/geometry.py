"""Unique geometry: tools are identified only by the distances between their markers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

from drivers.ndi_polaris.errors import SameGeometry
from drivers.ndi_polaris.rom.definition import ToolDefinition
from ronna_hw.devices.readings import Vector3

# Segments closer in length than this may be confused: "a few mm" by the guide; NDI's own tools keep 5 mm.
SEGMENT_TOLERANCE_MM = 3.5
TRIANGLE_TOLERANCE_MM = 2.0  # triangles within this are the same to the unit: such tools are refused
TRIANGLE_CORNERS = 3


@dataclass(frozen=True)
class AlikeSegments:
    """Two marker distances that are too similar; `second_tool` equals `first_tool` within one tool."""

    first_tool: str
    second_tool: str
    first_mm: float
    second_mm: float

    def __str__(self) -> str:
        lengths = f"{self.first_mm:.1f} and {self.second_mm:.1f} mm"
        if self.first_tool == self.second_tool:
            return f"{self.first_tool}: marker distances {lengths} are too similar"
        return f"{self.first_tool} and {self.second_tool} share a marker distance: {lengths}"


def segment_lengths_mm(markers_mm: tuple[Vector3, ...]) -> tuple[float, ...]:
    """Distances between all pairs of markers in mm, ascending."""
    return tuple(sorted(math.dist(a, b) for a, b in itertools.combinations(markers_mm, 2)))


def alike_segments_mm(
    tool: ToolDefinition, tolerance_mm: float = SEGMENT_TOLERANCE_MM
) -> tuple[tuple[float, float], ...]:
    """Segment lengths of one tool that are too similar; empty for a unique geometry."""
    lengths = segment_lengths_mm(tool.markers_mm)
    return tuple((a, b) for a, b in itertools.pairwise(lengths) if b - a < tolerance_mm)


def shared_segments_mm(
    first: ToolDefinition, second: ToolDefinition, tolerance_mm: float = SEGMENT_TOLERANCE_MM
) -> tuple[tuple[float, float], ...]:
    """Segment lengths of two tools that are too similar, as (first, second)."""
    theirs = segment_lengths_mm(second.markers_mm)
    return tuple(
        (a, b) for a in segment_lengths_mm(first.markers_mm) for b in theirs if abs(a - b) < tolerance_mm
    )


def find_alike(
    tools: Mapping[str, ToolDefinition], tolerance_mm: float = SEGMENT_TOLERANCE_MM
) -> tuple[AlikeSegments, ...]:
    """All segments that break the unique-geometry rules, within each tool and between every two."""
    within = [
        AlikeSegments(name, name, *pair)
        for name, tool in tools.items()
        for pair in alike_segments_mm(tool, tolerance_mm)
    ]
    between = [
        AlikeSegments(name, other_name, *pair)
        for (name, tool), (other_name, other) in itertools.combinations(tools.items(), 2)
        for pair in shared_segments_mm(tool, other, tolerance_mm)
    ]
    return (*within, *between)


def shared_triangle(
    first: ToolDefinition, second: ToolDefinition, tolerance_mm: float = TRIANGLE_TOLERANCE_MM
) -> bool:
    """Whether three markers of one tool are congruent with three of the other."""
    triangles = [
        segment_lengths_mm(corners) for corners in itertools.combinations(second.markers_mm, TRIANGLE_CORNERS)
    ]
    return any(
        all(abs(a - b) < tolerance_mm for a, b in zip(lengths, other, strict=True))
        for corners in itertools.combinations(first.markers_mm, TRIANGLE_CORNERS)
        for lengths in [segment_lengths_mm(corners)]
        for other in triangles
    )


def check_distinct(tools: Mapping[str, ToolDefinition]) -> None:
    """Raise NDI-012 when two of the named tools share a triangle of markers."""
    for (name, tool), (other_name, other) in itertools.combinations(tools.items(), 2):
        if shared_triangle(tool, other):
            raise SameGeometry(
                f"tools {name} and {other_name} share a triangle of markers",
                limit=f"{TRIANGLE_TOLERANCE_MM} mm between distances",
            )
