"""The skull along a trajectory in the CT: where a drill meets bone, and where it leaves it.

Where the profile has two readings, both are told, and the nearer inside counts. Bone that goes on behind a
gap is a calcified dura, or the inner table behind a diploe of marrow. An inner table that does not fall to
soft tissue as sharply as the outer one has contrast or calcified dura against it, or is weak bone. Metal
shines over its faces and saturates, so that none of bone near it is measured.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from procedures.planning.errors import MetalInSkull
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
PROMINENT_HU = 80.0  # of a table over the diploe; a skull has two tables at most
STEEP_FROM, STEEP_TO = 0.85, 0.25  # of the largest HU of a table: between these it falls at its face
# Safety against metal taken for bone, whose inside is then 1 to 3 mm too deep (U).
METAL_HU = 2500.0  # anywhere over the width of the drill: cortical bone has up to 2000
# Safety against contrast or calcified dura taken for bone. Source: layers in slices of 0.5 to 1.5 mm.
WIDER_MM = 1.0  # a face that falls over so much more than the outer one is two


class SkullSection(NamedTuple):
    """Depths of the skull's faces behind the entry, along a trajectory.

    `further_mm` is its inside by another reading of the same CT, None where there is but one.
    """

    outside_mm: float
    inside_mm: float
    doubt: str = ""  # what else the CT shows on the way
    further_mm: float | None = None

    @property
    def furthest_mm(self) -> float:
        """Its inside by the reading that has it deepest."""
        return self.inside_mm if self.further_mm is None else self.further_mm


def measure_skull(volume: Volume, trajectory: Trajectory) -> SkullSection | None:
    """Measure the skull along a trajectory, at half the largest HU of each table.

    None if no bone with an inside is met within `INSIDE_MM` of the entry, if bone or metal is at the entry
    itself, or the CT ends before. Raises PLAN-035 for metal in the skull or near its inside.
    """
    steps_mm = np.arange(0.0, min(INSIDE_MM, trajectory.depth_mm), STEP_MM)
    across_hu = _hu_across(volume, trajectory, steps_mm)
    hu = across_hu.mean(axis=1)
    bone = np.flatnonzero(hu > BONE_HU)
    if not len(bone) or bone[0] == 0:
        return None
    doubts, gap = list[str](), ""
    first, last, again = int(bone[0]), int(bone[-1]), 0  # of the nearest bone, and of that behind a gap
    for end, begin in pairwise(bone.tolist()):
        if begin == end + 1:
            continue
        gap_mm = (begin - end) * STEP_MM
        gap = f"behind a gap of {gap_mm:.1f} mm at {steps_mm[end]:.1f} mm"
        if hu[end:begin].min() < AIR_HU and gap_mm <= AIR_CELL_MM:
            doubts.append(f"an air cell is in it, the bone goes on {gap}")
            continue
        last = end
        if gap_mm <= NEAR_MM:
            again = begin
        break
    _require_no_metal(steps_mm, across_hu.max(axis=1), max(last, again) + round(NEAR_MM / STEP_MM))
    if last + 1 == len(steps_mm):
        return None
    outside_mm = _face_mm(steps_mm[: last + 1], hu[: last + 1], first)
    inside_mm, further_mm = _inner_face_mm(steps_mm, hu, first, last), None
    if (faces := _blurred_faces_mm(steps_mm, hu, first, last)) is not None:
        inside_mm, further_mm = min(faces[0], inside_mm), faces[1]
        doubts.append(
            f"it does not end sharply, but between {inside_mm:.1f} and {further_mm:.1f} mm: contrast in a "
            "sinus or calcified dura close behind it, or weak bone"
        )
    if again:
        behind = bone[bone >= again]
        end = int(behind[np.flatnonzero(np.diff(behind, append=len(steps_mm) + 1) > 1)[0]])
        further_mm = _inner_face_mm(steps_mm, hu, again, min(end, len(steps_mm) - 2))
        doubts.append(
            f"bone goes on {gap}, to {further_mm:.1f} mm: the inner table behind a diploe of marrow, or "
            "calcified dura behind the skull"
        )
    return SkullSection(outside_mm, inside_mm, "; ".join(doubts), further_mm)


def _inner_face_mm(steps_mm: Array, hu: Array, first: int, last: int) -> float:
    """Return the inner face of the bone between two places, the first not the entry."""
    return _face_mm(steps_mm[:first:-1], hu[:first:-1], len(steps_mm) - 1 - last)


def _blurred_faces_mm(steps_mm: Array, hu: Array, first: int, last: int) -> tuple[float, float] | None:
    """Return where the inner table falls, and where that ends; None if it falls like the outer one."""
    from scipy import signal

    begin, end = max(first - 1, 0), last + 2
    tables = begin + signal.find_peaks(hu[begin:end], prominence=PROMINENT_HU)[0]
    if not len(tables):
        return None
    inner, outer = int(tables[min(1, len(tables) - 1)]), int(tables[0])
    rising = [
        _first_mm(steps_mm[outer::-1], hu[outer::-1], share * hu[outer]) for share in (STEEP_TO, STEEP_FROM)
    ]
    begins_mm = _first_mm(steps_mm[inner:], hu[inner:], STEEP_FROM * hu[inner])
    ends_mm = _first_mm(steps_mm[inner:], hu[inner:], STEEP_TO * hu[inner])
    width_mm = rising[1] - rising[0]
    if ends_mm - begins_mm <= width_mm + WIDER_MM:
        return None
    return begins_mm + width_mm / 2.0, ends_mm


def _first_mm(steps_mm: Array, hu: Array, below: float) -> float:
    """Return where the HU, which begin above a value, first fall below it, or the last place."""
    at = int(np.argmax(hu < below))
    if at == 0:
        return float(steps_mm[-1])
    share = (hu[at - 1] - below) / (hu[at - 1] - hu[at])
    return float(steps_mm[at - 1] + share * (steps_mm[at] - steps_mm[at - 1]))


def _require_no_metal(steps_mm: Array, largest_hu: Array, end: int) -> None:
    metal = np.flatnonzero(largest_hu[:end] > METAL_HU)
    if len(metal):
        raise MetalInSkull(
            f"the CT shows metal {steps_mm[metal[0]]:.1f} to {steps_mm[metal[-1]]:.1f} mm behind the entry: "
            "where the skull ends there is not known",
            limit=f"{METAL_HU:.0f} HU",
            got=f"{largest_hu[metal].max():.0f} HU",
        )


def _hu_across(volume: Volume, trajectory: Trajectory, steps_mm: Array) -> Array:
    """Return the HU (n, k) at each step in k places over the width of the drill, as air outside the CT."""
    from scipy import ndimage

    axis = np.asarray(trajectory.axis_ct, dtype=float)
    ring, _ = ring_around(axis)
    offsets = np.concatenate([np.zeros((1, 3)), BIT_RADIUS_MM * ring])
    places = np.asarray(trajectory.entry_mm) + steps_mm[:, None, None] * axis + offsets
    index = volume.geometry.to_index(places.reshape(-1, 3))
    sampled = ndimage.map_coordinates(volume.voxels, index.T, output=float, order=1, cval=-1000.0)
    return np.asarray(sampled.reshape(len(steps_mm), -1))


def _face_mm(steps_mm: Array, hu: Array, first: int) -> float:
    """Return where the HU, going inwards, reach half of the largest in the table that begins at `first`."""
    half = hu[first : first + round(TABLE_MM / STEP_MM)].max() / 2.0
    at = first + int(np.argmax(hu[first:] >= half))
    if at == 0 or hu[at - 1] >= half:  # back to where they fall below
        below = np.flatnonzero(hu[:at] < half)
        at = int(below[-1]) + 1 if len(below) else at
    share = (half - hu[at - 1]) / (hu[at] - hu[at - 1]) if at else 1.0
    return float(steps_mm[at - 1] + share * (steps_mm[at] - steps_mm[at - 1])) if at else float(steps_mm[0])
