"""Signs of a plan's coordinates: LPS as stated, or read off in RAS or from a mirrored picture.

A head is nearly symmetric, so a plan with wrong signs may lead into it all the same. The surface, on which
entries are planned, and the table, through which nobody operates, tell front from back; hardly anything tells
left from right. Other readings are named as a possibility beside what is wrong with the plan as written.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from procedures.planning.errors import WrongSigns
from procedures.planning.head_in_ct import AIR_BELOW_HU, BONE_HU, find_entry_problems
from procedures.planning.plan_model import UP_LPS, Plan
from ronna_hw.arrays import Array, Mask

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume

AROUND_MM = 40.0  # along a trajectory, before and behind its entry: the range searched for skin and bone
STEP_MM = 0.5
SURFACE_RUN_MM = 3.0  # solid behind a surface: a hair, a thread or noise is thinner
ON_SURFACE_MM = 3.0  # of an entry from skin or bone: a click on a slice of 1 mm, on an oblique surface
# An entry as written that is farther from both was planned neither on the skin nor on bone or cortex.
OFF_SURFACE_MM = 10.0
FROM_BELOW = -0.3  # upward part of the way out of the head, a unit vector: 17 degrees below the horizontal
LPS = "LPS mm: x to the patient's left, y to the back, z to the crown"


@dataclass(frozen=True)
class _Reading:
    """Another meaning of the same numbers: axes mirrored about the origin, or the middle of the CT."""

    name: str
    signs: tuple[float, float, float]
    is_picture: bool = False  # mirrored as a picture is: about the middle of the volume

    def applied(self, ways: Array, volume: Volume) -> Array:
        """Return entries and targets (n, 2, 3) as this reading means them, LPS mm."""
        if not self.is_picture:
            return ways * self.signs
        geometry = volume.geometry
        middle_mm = geometry.to_patient_mm((np.array([geometry.shape], dtype=float) - 1.0) / 2.0)[0]
        return np.asarray(middle_mm + (ways - middle_mm) * self.signs)


MIRRORED = "a picture mirrored left and right"
READINGS = (
    _Reading("RAS, as 3D Slicer shows points (x and y with the other sign)", (-1.0, -1.0, 1.0)),
    _Reading("a picture mirrored front and back", (1.0, -1.0, 1.0), is_picture=True),
    _Reading(MIRRORED, (-1.0, 1.0, 1.0), is_picture=True),
)


def find_wrong_signs(plan: Plan, volume: Volume) -> WrongSigns | None:
    """Return a finding if every trajectory of a plan that does not fit the CT would fit it in other signs."""
    ways = _ways(plan)
    if _off_surface_mm(volume, ways) <= OFF_SURFACE_MM:
        return None
    names = [one.name for one in READINGS if _is_planned(volume, one.applied(ways, volume))]
    if not names:
        return None
    return WrongSigns(
        f"a second possibility: read as {' or as '.join(names)}, every trajectory of the plan would lead "
        "from the surface into the head",
        expected=LPS,
    )


def doubt_signs(plan: Plan, volume: Volume) -> str:
    """Return why a plan that fits the CT may have wrong signs, or an empty string."""
    ways = _ways(plan)
    up = np.array(UP_LPS[plan.table_orientation.value[2:]])
    is_off, is_below = _off_surface_mm(volume, ways) > OFF_SURFACE_MM, _is_from_below(ways, up)
    if not is_off and not is_below:
        return ""
    below, off = [], []
    for reading in READINGS:
        other = reading.applied(ways, volume)
        if is_below and _leads_into_head(volume, other) and not _is_from_below(other, up):
            below.append(reading.name)
        elif is_off and _is_planned(volume, other):
            off.append(reading.name)
    if not below and not off:
        return ""
    why = (
        "the trajectories enter from the side on which the patient lies"
        if below
        else f"an entry is more than {OFF_SURFACE_MM:g} mm off skin and bone, and read so all lie on them"
    )
    return (
        f"the coordinates may not be LPS, but {' or '.join(below or off)}: {why}; compare the side of each "
        "trajectory with the CT"
    )


def fits_mirrored(plan: Plan, volume: Volume) -> bool:
    """Return whether the plan mirrored left and right fits the CT too, so that only its sides tell."""
    (reading,) = (one for one in READINGS if one.name == MIRRORED)
    return _leads_into_head(volume, reading.applied(_ways(plan), volume))


def _ways(plan: Plan) -> Array:
    """Return entries and targets (n, 2, 3), LPS mm as written."""
    return np.array([(one.entry_mm, one.target_mm) for one in plan.trajectories])


def _leads_into_head(volume: Volume, ways: Array) -> bool:
    return bool(volume.geometry.contains(ways).all()) and not any(
        find_entry_problems(volume, entry, target)[0] for entry, target in ways
    )


def _is_planned(volume: Volume, ways: Array) -> bool:
    """Return whether every trajectory leads into the head from skin or bone."""
    return _leads_into_head(volume, ways) and _off_surface_mm(volume, ways) <= ON_SURFACE_MM


def _is_from_below(ways: Array, up: Array) -> bool:
    """Return whether the trajectories come from below the horizontal, in the mean."""
    outwards = ways[:, 0] - ways[:, 1]
    outwards /= np.linalg.norm(outwards, axis=1)[:, None]
    return float((outwards @ up).mean()) < FROM_BELOW


def _off_surface_mm(volume: Volume, ways: Array) -> float:
    """Return the largest distance of an entry from the nearer of skin and bone, along its trajectory."""
    steps = np.arange(-AROUND_MM, AROUND_MM + STEP_MM, STEP_MM)
    off_mm = []
    for entry, target in ways:
        places = entry + np.outer(steps, (target - entry) / np.linalg.norm(target - entry))
        is_known = volume.geometry.contains(places)
        index = np.rint(volume.geometry.to_index(places[is_known])).astype(np.intp)
        index = np.clip(index, 0, np.array(volume.geometry.shape) - 1)
        hu = np.full(len(steps), np.nan)
        hu[is_known] = volume.voxels[tuple(index.T)]
        surfaces = [_surface_mm(steps, is_known, hu >= limit_hu) for limit_hu in (AIR_BELOW_HU, BONE_HU)]
        off_mm.append(min(surfaces))
    return max(off_mm)


def _surface_mm(steps_mm: Array, is_known: Mask, is_solid: Mask) -> float:
    """Return the distance from the entry to where a run of solid begins, or infinity."""
    run = round(SURFACE_RUN_MM / STEP_MM)
    return next(
        (
            abs(float(steps_mm[k]))
            for k in range(1, len(steps_mm) - run + 1)
            if is_solid[k : k + run].all() and is_known[k - 1] and not is_solid[k - 1]
        ),
        float("inf"),
    )
