"""Detects patient motion during the scan: everything jumps sideways from one slice to the next.

A head's outline changes smoothly from slice to slice. The deviation of each change from those before and
after it is compared with the effect of a shift on these slices, using profiles along rows and columns.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.volume import VoxelGeometry

Array = NDArray[np.float64]

BODY_HU = (-700, 300)  # from air to dense tissue: skin counts, metal and its streaks hardly more
JUMP_MM = 0.4
THICKEST_MM = 3.0  # between thicker slices a head changes too much
LIKE_A_SHIFT = 0.55  # share of a change's square that a shift explains; up to 0.26 without motion


def motion_warnings(voxels: NDArray[np.int16], geometry: VoxelGeometry) -> tuple[str, ...]:
    """A sentence if one slice is shifted sideways against its neighbours; else nothing."""
    if len(voxels) < 4 or geometry.spacing_mm[0] > THICKEST_MM:
        return ()
    jumps_mm = np.zeros(len(voxels) - 3)
    for profiles, step_mm in zip(_profiles(voxels), geometry.spacing_mm[1:].tolist(), strict=True):
        jumps_mm = np.hypot(jumps_mm, _jumps(profiles) * step_mm)
    worst = int(jumps_mm.argmax())
    if jumps_mm[worst] < JUMP_MM:
        return ()
    height_mm = float(geometry.to_patient_mm((worst + 1.5, 0.0, 0.0))[2])
    return (
        f"the patient seems to have moved by {jumps_mm[worst]:.1f} mm at S {height_mm:.0f} mm, between "
        f"slices {worst + 2} and {worst + 3}: markers above and below are inconsistent",
    )


def _profiles(voxels: NDArray[np.int16]) -> tuple[Array, Array]:
    """Mean intensity of each row and of each column of every slice, (slices, n)."""
    by_row = np.empty((voxels.shape[0], voxels.shape[1]))
    by_column = np.empty((voxels.shape[0], voxels.shape[2]))
    for number, plane in enumerate(voxels):
        body = np.clip(plane, *BODY_HU)
        by_row[number], by_column[number] = body.mean(axis=1), body.mean(axis=0)
    return by_row, by_column


def _jumps(profiles: Array) -> Array:
    """Shift in samples of each inner slice relative to the one before, (slices - 3,).

    0 where the change is not a shift. Simultaneous motion along the table masks a sideways one.
    """
    changes = np.diff(profiles, axis=0)
    sudden = changes[1:-1] - 0.5 * (changes[:-2] + changes[2:])
    slope = np.gradient(0.5 * (profiles[1:-2] + profiles[2:-1]), axis=1)
    power, common = (slope**2).sum(axis=1), -(sudden * slope).sum(axis=1)
    explained = common**2 > LIKE_A_SHIFT * power * (sudden**2).sum(axis=1)
    shifts = np.divide(common, power, out=np.zeros(len(power)), where=explained & (power > 0.0))
    return np.asarray(shifts)
