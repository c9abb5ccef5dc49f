"""Signs of a plan's coordinates: LPS as stated, or read off in RAS or from a mirrored picture.

A head is nearly symmetric, so a plan with wrong signs may lead into it all the same. The surface, on which
entries are planned, and the table, through which nobody operates, tell them apart. A plan that is refused
anyway and fits with other signs is said to be in them; one that passes and would fit better is asked about.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from procedures.planning.errors import WrongSigns
from procedures.planning.head_in_ct import AIR_BELOW_HU, BONE_HU, find_entry_problems
from procedures.planning.plan_model import UP_LPS, Plan
from ronna_hw.arrays import Array, Mask
from ronna_hw.errors import RonnaError

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
    """Another meaning of the same numbers."""

    name: str
    signs: tuple[float, float, float]
    action: str


READINGS = (  # the first that fits counts: RAS is how 3D Slicer shows points
    _Reading(
        "RAS",
        (-1.0, -1.0, 1.0),
        "If they were read off in RAS, as 3D Slicer shows them, change the sign of the first two numbers of "
        "every point in the plan, and compare the side of each trajectory with the CT. Otherwise find the "
        "point that is wrong.",
    ),
    *(
        _Reading(
            f"those of a picture mirrored {ends}",
            signs,
            f"Find out whether the plan was made on a mirrored picture: compare {ends} of the patient with "
            "the CT. Plan again on this CT; do not change signs unless you know why they are wrong.",
        )
        for ends, signs in (("left and right", (-1.0, 1.0, 1.0)), ("front and back", (1.0, -1.0, 1.0)))
    ),
)


def find_wrong_signs(plan: Plan, volume: Volume, problem: RonnaError) -> WrongSigns | None:
    """Return a finding if every trajectory of a plan with this `problem` fits the CT with other signs."""
    ways = _ways(plan)
    if _off_surface_mm(volume, ways) <= OFF_SURFACE_MM:
        return None
    for reading in READINGS:
        other = ways * reading.signs
        if _leads_into_head(volume, other) and _off_surface_mm(volume, other) <= ON_SURFACE_MM:
            return WrongSigns(
                f"the coordinates of the plan look like {reading.name}: {problem.what}, but with the signs "
                f"of {_axes(reading.signs)} changed every trajectory leads from the surface into the head",
                expected=LPS,
                action=reading.action,
            )
    return None


def doubt_signs(plan: Plan, volume: Volume) -> str:
    """Return why a plan that fits the CT may have wrong signs, or an empty string."""
    ways = _ways(plan)
    up = np.array(UP_LPS[plan.table_orientation.value[2:]])
    written_mm = _off_surface_mm(volume, ways)
    for reading in READINGS:
        other = ways * reading.signs
        if not _leads_into_head(volume, other):
            continue
        if _is_from_below(ways, up) and not _is_from_below(other, up):
            why = "the trajectories enter from the side on which the patient lies"
        elif written_mm > OFF_SURFACE_MM and _off_surface_mm(volume, other) <= ON_SURFACE_MM:
            why = (
                f"an entry is more than {OFF_SURFACE_MM:g} mm off skin and bone, and read so all lie on them"
            )
        else:
            continue
        return f"the coordinates may be {reading.name}, not LPS: {why}; compare each trajectory with the CT"
    return ""


def _ways(plan: Plan) -> Array:
    """Return entries and targets (n, 2, 3), LPS mm as written."""
    return np.array([(one.entry_mm, one.target_mm) for one in plan.trajectories])


def _axes(signs: Sequence[float]) -> str:
    return " and ".join(axis for axis, sign in zip("xyz", signs, strict=True) if sign < 0.0)


def _leads_into_head(volume: Volume, ways: Array) -> bool:
    return bool(volume.geometry.contains(ways).all()) and not any(
        find_entry_problems(volume, entry, target)[0] for entry, target in ways
    )


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
