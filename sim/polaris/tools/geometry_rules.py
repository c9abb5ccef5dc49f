"""Unique-geometry rules: segment lengths distinguish a tool from its mirror image and from other tools."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np

from ronna_hw.wire import polaris_rom
from sim.polaris.tools.definition import ToolDefinition
from sim.polaris.unit.behaviour import UnitBehaviour
from sim.polaris.unit.refusal import WarningCode

WAVELENGTH_BITS = 0x07  # of the marker type


def warning_of(
    tool: ToolDefinition, others: list[ToolDefinition], behaviour: UnitBehaviour
) -> WarningCode | None:
    """The warning of PINIT for `tool` in the presence of `others`; None for a valid tool."""
    unique = _has_unique_segments(tool, behaviour)
    conflicts = any(_conflict(tool, other, behaviour) for other in others)
    if not unique:
        return WarningCode.NOT_UNIQUE_AND_CONFLICTS if conflicts else WarningCode.GEOMETRY_NOT_UNIQUE
    if conflicts:
        return WarningCode.CONFLICTS_WITH_TOOL
    return None if tool.marker_type else WarningCode.DEFAULT_WAVELENGTH


def wavelength_of(tool: ToolDefinition) -> int:
    """Wavelength code of the tool's markers."""
    return tool.marker_type & WAVELENGTH_BITS


def _judged(tool: ToolDefinition, behaviour: UnitBehaviour) -> bool:
    return bool(tool.flags & polaris_rom.FLAG_UNIQUE_GEOMETRY) or not behaviour.judges_only_flagged


def _has_unique_segments(tool: ToolDefinition, behaviour: UnitBehaviour) -> bool:
    if not _judged(tool, behaviour):
        return True
    lengths = sorted(_segments_mm(tool).values())
    return all(b - a >= behaviour.segment_tolerance_mm for a, b in pairwise(lengths))


def _conflict(tool: ToolDefinition, other: ToolDefinition, behaviour: UnitBehaviour) -> bool:
    if not (_judged(tool, behaviour) and _judged(other, behaviour)):
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
    """Side lengths of every triangle of markers, shortest first."""
    return [
        sorted((segments_mm[a, b], segments_mm[a, c], segments_mm[b, c]))
        for a, b, c in combinations(range(markers), 3)
    ]
