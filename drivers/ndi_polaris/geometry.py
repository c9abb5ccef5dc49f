"""Can tools be told apart? By the distances between their markers, which is all that the unit sees."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping

from drivers.ndi_polaris.errors import SameGeometry
from drivers.ndi_polaris.rom import ToolDefinition
from ronna_hw.devices.readings import Vector3

SEGMENT_TOLERANCE_MM = 2.0  # segments closer than this are alike; the vendor's own tools keep about 5 mm
SAME_TOOL_SEGMENTS = 3  # three segments shared between two tools are one triangle seen as either


def segment_lengths_mm(markers_mm: tuple[Vector3, ...]) -> tuple[float, ...]:
    """Distances between all pairs of markers, ascending, mm."""
    return tuple(sorted(math.dist(a, b) for a, b in itertools.combinations(markers_mm, 2)))


def alike_segments_mm(tool: ToolDefinition) -> tuple[tuple[float, float], ...]:
    """Neighbouring segment lengths of one tool that are too alike; empty for a unique geometry."""
    lengths = segment_lengths_mm(tool.markers_mm)
    return tuple((a, b) for a, b in itertools.pairwise(lengths) if b - a < SEGMENT_TOLERANCE_MM)


def shared_triangle(first: ToolDefinition, second: ToolDefinition) -> bool:
    """True when some three markers of one tool lie like some three of the other."""
    triangles = [
        segment_lengths_mm(corners)
        for corners in itertools.combinations(second.markers_mm, SAME_TOOL_SEGMENTS)
    ]
    return any(
        all(abs(a - b) < SEGMENT_TOLERANCE_MM for a, b in zip(lengths, other, strict=True))
        for corners in itertools.combinations(first.markers_mm, SAME_TOOL_SEGMENTS)
        for lengths in [segment_lengths_mm(corners)]
        for other in triangles
    )


def check_distinct(tools: Mapping[str, ToolDefinition]) -> None:
    """Raise NDI-012 when two of the named tools share a triangle of markers."""
    for (name, tool), (other_name, other) in itertools.combinations(tools.items(), 2):
        if shared_triangle(tool, other):
            raise SameGeometry(
                f"tools {name} and {other_name} share a triangle of markers",
                limit=f"{SEGMENT_TOLERANCE_MM} mm between distances",
            )
