"""The skull along a trajectory in the CT: where a drill meets bone, and where it leaves it."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from procedures.planning.head_in_ct import BONE_HU, STEP_MM, ring_around
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arrays import Array

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume

INSIDE_MM = 40.0  # from the entry on the skin inwards: the range searched for bone
BIT_RADIUS_MM = 1.6  # of the drill, over whose width the HU are averaged
AIR_CELL_MM = 3.0  # of air within a bone: it goes on behind
AIR_HU = -200.0  # what lies in a gap with less somewhere: soft tissue and dura have more
NEAR_MM = 10.0  # behind the inside: bone there is told
TABLE_MM = 3.0  # from a face inwards: the largest HU of its table is within


class SkullSection(NamedTuple):
    """Depths of the skull's faces behind the entry, along a trajectory."""

    outside_mm: float
    inside_mm: float
    doubt: str = ""  # what else the CT shows on the way


def measure_skull(volume: Volume, trajectory: Trajectory) -> SkullSection | None:
    """Measure the skull along a trajectory, at half the largest HU of each table.

    Its inside is the nearest one: bone behind soft tissue, as a calcified dura, is not joined to it. None if
    no bone with an inside is met within `INSIDE_MM` of the entry, if bone or metal is at the entry itself, or
    the CT ends before.
    """
    steps_mm = np.arange(0.0, min(INSIDE_MM, trajectory.depth_mm), STEP_MM)
    hu = _mean_hu(volume, trajectory, steps_mm)
    bone = np.flatnonzero(hu > BONE_HU)
    if not len(bone) or bone[0] == 0:
        return None
    first, last, doubts = int(bone[0]), int(bone[-1]), list[str]()
    for end, again in pairwise(bone.tolist()):
        if again == end + 1:
            continue
        gap = f"behind a gap of {(again - end) * STEP_MM:.1f} mm at {steps_mm[end]:.1f} mm"
        if hu[end:again].min() < AIR_HU and (again - end) * STEP_MM <= AIR_CELL_MM:
            doubts.append(f"an air cell is in it, the bone goes on {gap}")
            continue
        last = end
        if steps_mm[again] - steps_mm[end] <= NEAR_MM:
            doubts.append(f"bone goes on {gap}, which counts as its inside")
        break
    if last + 1 == len(steps_mm):
        return None
    outside_mm = _face_mm(steps_mm[: last + 1], hu[: last + 1], first)
    inside_mm = _face_mm(steps_mm[:first:-1], hu[:first:-1], len(steps_mm) - 1 - last)
    return SkullSection(outside_mm, inside_mm, "; ".join(doubts))


def _mean_hu(volume: Volume, trajectory: Trajectory, steps_mm: Array) -> Array:
    """Return the HU (n,) over the width of the drill, as air outside the CT."""
    from scipy import ndimage

    axis = np.asarray(trajectory.axis_ct, dtype=float)
    ring, _ = ring_around(axis)
    offsets = np.concatenate([np.zeros((1, 3)), BIT_RADIUS_MM * ring])
    places = np.asarray(trajectory.entry_mm) + steps_mm[:, None, None] * axis + offsets
    index = volume.geometry.to_index(places.reshape(-1, 3))
    sampled = ndimage.map_coordinates(volume.voxels, index.T, output=float, order=1, cval=-1000.0)
    return np.asarray(sampled.reshape(len(steps_mm), -1).mean(axis=1))


def _face_mm(steps_mm: Array, hu: Array, first: int) -> float:
    """Return where the HU, going inwards, reach half of the largest in the table that begins at `first`."""
    half = hu[first : first + round(TABLE_MM / STEP_MM)].max() / 2.0
    at = first + int(np.argmax(hu[first:] >= half))
    if at == 0 or hu[at - 1] >= half:  # back to where they fall below
        below = np.flatnonzero(hu[:at] < half)
        at = int(below[-1]) + 1 if len(below) else at
    share = (half - hu[at - 1]) / (hu[at] - hu[at - 1]) if at else 1.0
    return float(steps_mm[at - 1] + share * (steps_mm[at] - steps_mm[at - 1])) if at else float(steps_mm[0])
