"""Did the patient move while the scan ran? Then everything jumps sideways from one slice to the next.

A head changes its outline smoothly from slice to slice. By what one change differs from those before and
after it is compared with what a shift would make of these slices, on profiles along rows and columns.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.volume import VoxelGeometry

Array = NDArray[np.float64]

BODY_HU = (-700, 300)  # from air to dense matter: skin counts, metal and its streaks hardly more
JUMP_MM = 0.4
THICKEST_MM = 3.0  # between thicker slices a head changes too much
LIKE_A_SHIFT = 0.55  # of the square of a change that a shift explains; up to 0.26 where nothing moves


def motion_warnings(voxels: NDArray[np.int16], geometry: VoxelGeometry) -> tuple[str, ...]:
    """A sentence when one slice lies sideways of what its neighbours let expect; else none."""
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
    """Samples by which each slice but the outer ones is shifted against the one before, (slices - 3,).

    0 where something else changes. A move along the table at the same time hides one to the side.
    """
    changes = np.diff(profiles, axis=0)
    sudden = changes[1:-1] - 0.5 * (changes[:-2] + changes[2:])
    slope = np.gradient(0.5 * (profiles[1:-2] + profiles[2:-1]), axis=1)
    power, common = (slope**2).sum(axis=1), -(sudden * slope).sum(axis=1)
    explained = common**2 > LIKE_A_SHIFT * power * (sudden**2).sum(axis=1)
    shifts = np.divide(common, power, out=np.zeros(len(power)), where=explained & (power > 0.0))
    return np.asarray(shifts)
