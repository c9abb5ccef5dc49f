"""Problems with the structures of a plan: too close to a trajectory, misplaced, or full of gaps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from procedures.imaging.errors import PicksUnreadable
from procedures.imaging.picks import parse_points
from procedures.planning.errors import NearStructure, OutsideField, StructureUnreadable
from procedures.planning.head.metres import NOT_METRES, in_metres, span
from procedures.planning.head.structures import Structure, StructureDistance, structure_of, widest_gap_mm
from ronna_hw.errors import RonnaError

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume, VoxelGeometry
    from procedures.planning.plan.model import Plan

MOST_OUTSIDE = 0.5  # of the points: with more, it belongs to another CT or its axes differ


def read_structure(
    content: bytes, file_name: str, name: str, margin_mm: float, geometry: VoxelGeometry
) -> Structure:
    """The structure described by the content of a point file. Raises PLAN-006, PLAN-028.

    Also pydantic's ValidationError, for a name that a plan does not accept.
    """
    try:
        points_mm = parse_points(content, file_name)
    except PicksUnreadable as refused:
        raise StructureUnreadable(refused.what, expected=refused.expected, got=refused.got) from refused
    if in_metres(points_mm):
        raise StructureUnreadable(
            f"the points in {file_name} are within {span(points_mm):.3g} mm of each other: {NOT_METRES}"
        )
    if (outside := _outside(points_mm, geometry)) > MOST_OUTSIDE:
        raise OutsideField(f"{outside:.0%} of the points in {file_name} are outside the CT")
    return structure_of(name, margin_mm, points_mm)


def structure_findings(
    plan: Plan, distances: Sequence[StructureDistance], volume: Volume
) -> tuple[list[RonnaError], list[str]]:
    """Findings that refuse the plan, and warnings for the surgeon."""
    findings: list[RonnaError] = [
        NearStructure(
            f"trajectory {one.trajectory} comes too close to {one.structure}",
            expected=f"at least {one.margin_mm:g} mm",
            got=f"{one.distance_mm:.1f} mm",
        )
        for one in distances
        if not one.is_kept
    ]
    warnings = []
    for one in plan.structures or ():
        outside = _outside(one.points_mm, volume.geometry)
        if outside > MOST_OUTSIDE:
            findings.append(OutsideField(f"{outside:.0%} of the points of {one.name} are outside the CT"))
        elif outside:
            warnings.append(f"{outside:.0%} of the points of {one.name} are outside the CT")
        if (gap_mm := widest_gap_mm(one.points_mm)) > one.margin_mm:
            warnings.append(
                f"points of {one.name} are up to {gap_mm:.1f} mm apart: half of that is "
                "subtracted from its distances"
            )
    return findings, warnings


def _outside(points_mm: ArrayLike, geometry: VoxelGeometry) -> float:
    """Fraction of points (n, 3) beyond the outer faces of the outermost voxels."""
    index = geometry.to_index(points_mm)
    return float(np.any((index < -0.5) | (index > np.array(geometry.shape) - 0.5), axis=1).mean())
