"""Distances from trajectories to structures to avoid, mainly vessels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from procedures.imaging.errors import PicksUnreadable
from procedures.imaging.picks import parse_points
from procedures.planning.errors import NEAR_STRUCTURE, OUTSIDE_FIELD, STRUCTURE_UNREADABLE
from procedures.planning.plan_model import (
    MOST_POINTS,
    MOST_STRUCTURES,
    NOT_METRES,
    Plan,
    Structure,
    is_in_metres,
    span,
)
from ronna_hw.arrays import Array
from ronna_hw.errors import RonnaError

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume, VoxelGeometry

LEAST_MARGIN_MM = 0.4  # half the thickness of the thinnest depth electrode
DECIMALS = 1  # of a coordinate, mm: finer than any structure is drawn
_THINNING = 1.25  # growth of the cells until few enough points remain
_FINEST_CELL_MM = 0.5
MOST_OUTSIDE = 0.5  # of the points: with more, it belongs to another CT or its axes differ


@dataclass(frozen=True)
class StructureDistance:
    """Smallest distance from a trajectory's axis to a structure, and the structure's nearest point.

    Half the widest gap between points, and the effect of thinning, are subtracted.
    """

    structure: str
    trajectory: str
    distance_mm: float
    margin_mm: float
    nearest_mm: tuple[float, float, float]

    @property
    def is_kept(self) -> bool:
        """Whether the distance respects the margin."""
        return self.distance_mm >= self.margin_mm


def measure_distances(plan: Plan) -> tuple[StructureDistance, ...]:
    """Measure the distance from every trajectory to every structure."""
    return tuple(
        _measure_distance(structure, one.id, one.entry_mm, one.target_mm)
        for structure in plan.structures or ()
        for one in plan.trajectories
    )


def _measure_distance(
    structure: Structure, trajectory: str, entry_mm: ArrayLike, target_mm: ArrayLike
) -> StructureDistance:
    points = np.array(structure.points_mm)
    start = np.asarray(entry_mm, dtype=float)
    along = np.asarray(target_mm, dtype=float) - start
    share = np.clip((points - start) @ along / float(along @ along), 0.0, 1.0)
    distances = np.linalg.norm(points - (start + share[:, None] * along), axis=1)
    nearest = int(distances.argmin())
    unknown_mm = structure.within_mm + widest_gap_mm(structure.points_mm) / 2.0
    distance_mm = max(0.0, float(distances[nearest]) - unknown_mm)
    nearest_mm = structure.points_mm[nearest]
    return StructureDistance(structure.name, trajectory, distance_mm, structure.margin_mm, nearest_mm)


@lru_cache(maxsize=4 * MOST_STRUCTURES)
def widest_gap_mm(points_mm: tuple[tuple[float, float, float], ...]) -> float:
    """Return the widest gap to bridge to connect all points, in mm, or 0 for a single point.

    The longest edge of the minimum spanning tree: also between slices whose own points lie close together.
    """
    from scipy.cluster.hierarchy import linkage

    return float(linkage(np.array(points_mm), "single")[-1, 2]) if len(points_mm) > 1 else 0.0


def build_structure(name: str, margin_mm: float, points_mm: ArrayLike, within_mm: float = 0.0) -> Structure:
    """Build a structure from any number of points (n, 3), thinned to the number that a plan can store.

    All of it is within `within_mm` of these points. Raises pydantic's ValidationError for a name or position
    that a plan does not accept.
    """
    rounded = np.unique(np.round(np.asarray(points_mm, dtype=float).reshape(-1, 3), DECIMALS), axis=0)
    kept, cell_mm = rounded, _FINEST_CELL_MM
    while len(kept) > MOST_POINTS:
        _, first = np.unique(np.floor(rounded / cell_mm), axis=0, return_index=True)
        kept, cell_mm = rounded[np.sort(first)], cell_mm * _THINNING
    points = tuple((x, y, z) for x, y, z in kept.tolist())
    within_mm += _thinning_gap_mm(rounded, kept)
    return Structure(name=name, margin_mm=margin_mm, within_mm=within_mm, points_mm=points)


def _thinning_gap_mm(points: Array, kept: Array) -> float:
    """Return the largest distance from a dropped point to its nearest kept one, rounded up, in mm."""
    from scipy.spatial import cKDTree

    if len(points) == len(kept):
        return 0.0
    distances, _ = cKDTree(kept).query(points)
    return math.ceil(float(distances.max()) * 10.0) / 10.0


def read_structure(
    content: bytes, file_name: str, name: str, margin_mm: float, geometry: VoxelGeometry
) -> Structure:
    """Read a structure from the content of a point file. Raises PLAN-006, PLAN-028.

    Also pydantic's ValidationError, for a name that a plan does not accept.
    """
    try:
        points_mm = parse_points(content, file_name)
    except PicksUnreadable as refused:
        raise STRUCTURE_UNREADABLE(refused.what, expected=refused.expected, got=refused.got) from refused
    if is_in_metres(points_mm):
        raise STRUCTURE_UNREADABLE(
            f"the points in {file_name} are within {span(points_mm):.3g} mm of each other: {NOT_METRES}"
        )
    if (outside := _share_outside(points_mm, geometry)) > MOST_OUTSIDE:
        raise OUTSIDE_FIELD(f"{outside:.0%} of the points in {file_name} are outside the CT")
    return build_structure(name, margin_mm, points_mm)


def check_structures(
    plan: Plan, distances: Sequence[StructureDistance], volume: Volume
) -> tuple[list[RonnaError], list[str]]:
    """Return findings that reject the plan, and warnings for the surgeon."""
    findings: list[RonnaError] = [
        NEAR_STRUCTURE(
            f"trajectory {one.trajectory} comes too close to {one.structure}",
            expected=f"at least {one.margin_mm:g} mm",
            got=f"{one.distance_mm:.1f} mm",
        )
        for one in distances
        if not one.is_kept
    ]
    warnings = []
    for one in plan.structures or ():
        outside = _share_outside(one.points_mm, volume.geometry)
        if outside > MOST_OUTSIDE:
            findings.append(OUTSIDE_FIELD(f"{outside:.0%} of the points of {one.name} are outside the CT"))
        elif outside:
            warnings.append(f"{outside:.0%} of the points of {one.name} are outside the CT")
        if (gap_mm := widest_gap_mm(one.points_mm)) > one.margin_mm:
            warnings.append(
                f"points of {one.name} are up to {gap_mm:.1f} mm apart: half of that is "
                "subtracted from its distances"
            )
    return findings, warnings


def _share_outside(points_mm: ArrayLike, geometry: VoxelGeometry) -> float:
    """Return the fraction of points (n, 3) outside the CT, up to the outer voxel faces."""
    return float((~geometry.contains(points_mm)).mean())
