"""Structures that trajectories must avoid, above all vessels, as points, and how close they come."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from ronna_hw.calibration import Strict

if TYPE_CHECKING:
    from procedures.planning.plan.model import Plan

Array = NDArray[np.float64]

MOST_STRUCTURES = 20
MOST_POINTS = 1000  # of one structure; a denser cloud is thinned, and the loss of accuracy recorded
MOST_POINTS_TOGETHER = 3000  # as many as a plan file has room for
LEAST_MARGIN_MM = 0.4  # half the thickness of the thinnest depth electrode
LARGEST_MARGIN_MM = 30.0
DECIMALS = 1  # of a coordinate, mm: finer than any structure is drawn
NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9 _.-]*$"
_THINNING = 1.25  # growth of the cells until few enough points remain
_FINEST_CELL_MM = 0.5

Coordinate = Annotated[float, Field(allow_inf_nan=False, ge=-10_000.0, le=10_000.0)]


class Structure(Strict):
    """One structure, drawn or imported: points in CT coordinates (LPS, mm) and the margin to keep."""

    name: str = Field(min_length=1, max_length=32, pattern=NAME_PATTERN, description="Its name.")
    margin_mm: float = Field(
        allow_inf_nan=False,
        ge=0.0,
        le=LARGEST_MARGIN_MM,
        description="Minimum distance from a trajectory's axis; includes half the instrument's thickness.",
    )
    within_mm: float = Field(
        default=0.0,
        allow_inf_nan=False,
        ge=0.0,
        le=LARGEST_MARGIN_MM,
        description="Largest gap of its surface from the nearest listed point; subtracted "
        "from every distance.",
    )
    points_mm: Annotated[
        tuple[tuple[Coordinate, Coordinate, Coordinate], ...], Field(min_length=1, max_length=MOST_POINTS)
    ] = Field(description="Its points, LPS.")


@dataclass(frozen=True)
class StructureDistance:
    """How close the axis between entry and target may come to a structure; `nearest_mm` is the point there.

    What may be between the points is subtracted: half the widest gap, and the effect of thinning.
    """

    structure: str
    trajectory: str
    distance_mm: float
    margin_mm: float
    nearest_mm: tuple[float, float, float]

    @property
    def is_kept(self) -> bool:
        """Whether the margin is kept."""
        return self.distance_mm >= self.margin_mm


def structure_distances(plan: Plan) -> tuple[StructureDistance, ...]:
    """From every trajectory to every structure."""
    return tuple(
        _distance(structure, one.id, one.entry_mm, one.target_mm)
        for structure in plan.structures or ()
        for one in plan.trajectories
    )


def _distance(
    structure: Structure, trajectory: str, entry_mm: ArrayLike, target_mm: ArrayLike
) -> StructureDistance:
    points = np.array(structure.points_mm)
    start = np.asarray(entry_mm, dtype=float)
    along = np.asarray(target_mm, dtype=float) - start
    share = np.clip((points - start) @ along / float(along @ along), 0.0, 1.0)
    distances = np.linalg.norm(points - (start + share[:, None] * along), axis=1)
    nearest = int(distances.argmin())
    x, y, z = points[nearest].tolist()
    unknown_mm = structure.within_mm + widest_gap_mm(structure.points_mm) / 2.0
    distance_mm = max(0.0, float(distances[nearest]) - unknown_mm)
    return StructureDistance(structure.name, trajectory, distance_mm, structure.margin_mm, (x, y, z))


@lru_cache(maxsize=4 * MOST_STRUCTURES)
def widest_gap_mm(points_mm: tuple[tuple[float, float, float], ...]) -> float:
    """The widest gap that must be bridged to go from every point to every other; 0 for one point.

    The longest edge of the minimum spanning tree: also between slices whose own points lie close together.
    """
    from scipy.cluster.hierarchy import linkage

    return float(linkage(np.array(points_mm), "single")[-1, 2]) if len(points_mm) > 1 else 0.0


def structure_of(name: str, margin_mm: float, points_mm: ArrayLike, within_mm: float = 0.0) -> Structure:
    """A structure of any number of points (n, 3), thinned to as many as a plan stores.

    All of it is within `within_mm` of these points. Raises pydantic's ValidationError for a name or position
    that a plan does not accept.
    """
    rounded = np.unique(np.round(np.asarray(points_mm, dtype=float).reshape(-1, 3), DECIMALS), axis=0)
    kept, cell_mm = rounded, _FINEST_CELL_MM
    while len(kept) > MOST_POINTS:
        _, first = np.unique(np.floor(rounded / cell_mm), axis=0, return_index=True)
        kept, cell_mm = rounded[np.sort(first)], cell_mm * _THINNING
    points = tuple((x, y, z) for x, y, z in kept.tolist())
    within_mm += _left_out_mm(rounded, kept)
    return Structure(name=name, margin_mm=margin_mm, within_mm=within_mm, points_mm=points)


def _left_out_mm(points: Array, kept: Array) -> float:
    """Largest distance from a dropped point to the nearest kept one, rounded up."""
    from scipy.spatial import cKDTree

    if len(points) == len(kept):
        return 0.0
    distances, _ = cKDTree(kept).query(points)
    return math.ceil(float(distances.max()) * 10.0) / 10.0
