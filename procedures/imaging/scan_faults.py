"""Detection of patient motion, which the headers do not show.

Outlines in a head change steadily from slice to slice. Any change in excess of those around it is compared
with a shift of the outlines across the slice. If a change runs against those around it, slices repeat: the
patient moved back along the table. Neither shows near the vertex, where there is little outline; a move along
the table by less than a slice, or one that hides in missing slices, shows nowhere. For a stretched or sheared
scan see `scan_deformation`.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from procedures.imaging.errors import PatientMoved
from procedures.imaging.volume import VoxelGeometry
from ronna_hw.arrays import Array
from ronna_hw.text import format_against_limit

Plane = NDArray[np.float32]

BODY_HU = (-700, 300)  # from air to dense tissue: skin counts, metal and its streaks hardly more
PIXEL_MM = 2.0  # to which slices are reduced, against noise
SMOOTH_PIXELS = 1.0  # sigma, then: slopes over two pixels are right to a tenth
OUTLINE_HU_PER_MM = 40.0  # slope from which a pixel belongs to an outline
LEAST_OUTLINE = 0.25  # of the most that a slice of the series shows: those with less are not judged
LIKE_A_SHIFT = 0.1  # share of a sudden change's square that a shift explains
STEADY = 0.3  # correlation of the change before with the one after
BACKWARDS = -0.7  # correlation of a change with those around it: slices that repeat have -0.74 to -1
THICKEST_MM = 3.0  # between thicker slices a head changes too much
AROUND = 6  # slices: three changes in a row, with one between them and those compared

# Values without motion are on the reference page of scanner faults. A move of 1 mm costs 0.8 mm rms at the
# markers, and 0.3 mm after a rigid fit.
WARNED_MM, REFUSED_MM = 0.4, 1.0


def check_motion(voxels: NDArray[np.int16], geometry: VoxelGeometry) -> tuple[str, ...]:
    """Warn of a jump between slices, sideways or back along the table; raise CT-023 if it exceeds 1 mm."""
    if len(voxels) < AROUND or geometry.spacing_mm[0] > THICKEST_MM:
        return ()
    found = estimate_jumps(voxels, geometry)
    across_mm = np.where(found.shares > LIKE_A_SHIFT, found.across_mm, 0.0)
    back_mm = np.where(found.runs < BACKWARDS, found.back_mm, 0.0)
    return (
        *_warn_of_jump("sideways", across_mm, geometry),
        *_warn_of_jump("back along the table", back_mm, geometry),
    )


def _warn_of_jump(way: str, jumps_mm: Array, geometry: VoxelGeometry) -> tuple[str, ...]:
    worst = int(jumps_mm.argmax())
    jump_mm, before = float(jumps_mm[worst]), worst + AROUND // 2  # slices are counted from one
    if jump_mm <= WARNED_MM:
        return ()
    height_mm = float(geometry.to_patient_mm((before - 0.5, 0.0, 0.0))[2])
    where = f"{way} at S {height_mm:.0f} mm, between slices {before} and {before + 1}"
    if jump_mm > REFUSED_MM:
        raise PatientMoved(
            f"the head jumps {where}",
            limit=f"{REFUSED_MM:.1f} mm",
            got=f"{format_against_limit(jump_mm, REFUSED_MM, 1)} mm",
        )
    return (
        f"the patient seems to have moved by {jump_mm:.1f} mm {where}: "
        "markers above and below are inconsistent",
    )


@dataclass(frozen=True, eq=False)
class Jumps:
    """Jump of each inner slice relative to the previous one, (slices - 5,); 0 where it cannot be judged.

    `across_mm` across the slice, with the share of the sudden change that such a shift explains; `back_mm`
    along the table, with the correlation of the change with those around it.
    """

    across_mm: Array
    shares: Array
    back_mm: Array
    runs: Array


def estimate_jumps(voxels: NDArray[np.int16], geometry: VoxelGeometry) -> Jumps:
    """Estimate the apparent jump at each inner slice; small values are noise."""
    _, rows, columns = geometry.shape
    down_mm, across_mm = geometry.spacing_mm[1:].tolist()
    size = (max(round(columns * across_mm / PIXEL_MM), 3), max(round(rows * down_mm / PIXEL_MM), 3))
    steps_mm = (rows * down_mm / size[1], columns * across_mm / size[0])
    planes = [_reduce_slice(plane, size) for plane in voxels[: AROUND - 1]]
    found = np.zeros((len(voxels) - AROUND + 1, 5))
    for number, plane in enumerate(voxels[AROUND - 1 :]):
        planes = [*planes[1 - AROUND :], _reduce_slice(plane, size)]
        found[number] = _estimate_jump(planes, steps_mm, float(geometry.spacing_mm[0]))
    judged = found[:, 4] > LEAST_OUTLINE * found[:, 4].max()
    return Jumps(*np.where(judged, found[:, :4].T, 0.0))


def _reduce_slice(plane: NDArray[np.int16], size: tuple[int, int]) -> Plane:
    body = np.clip(plane, *BODY_HU).astype(np.float32)
    small = cv2.resize(body, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(small, (0, 0), SMOOTH_PIXELS), dtype=np.float32)


def _estimate_jump(planes: list[Plane], steps_mm: tuple[float, float], slice_mm: float) -> tuple[float, ...]:
    """Estimate the jump between the middle two of six slices: fields of `Jumps`, then outline strength."""
    middle = 0.5 * (planes[2] + planes[3])
    slopes = np.gradient(middle, *steps_mm)
    outline = np.hypot(*slopes) > OUTLINE_HU_PER_MM
    outline_slopes = np.column_stack([slope[outline] for slope in slopes]).astype(np.float64)
    power = outline_slopes.T @ outline_slopes
    least = float(np.linalg.eigvalsh(power)[0])
    changes = np.diff([plane[outline] for plane in planes], axis=0).astype(np.float64)
    if least <= 0.0 or not changes.any(axis=1).all():
        return 0.0, 0.0, 0.0, 0.0, max(least, 0.0)
    sudden = changes[2] - 0.5 * (changes[1] + changes[3])
    common = outline_slopes.T @ -sudden
    shift_mm = np.linalg.solve(power, common)
    share = float(shift_mm @ common) / max(float(sudden @ sudden), np.finfo(float).tiny)
    return float(np.linalg.norm(shift_mm)), share, *_estimate_return(changes, slice_mm), least


def _estimate_return(changes: Array, slice_mm: float) -> tuple[float, float]:
    """Estimate how far the table apparently moved back, mm, and the correlation with nearby changes.

    Those have no slice in common with the middle one, whose noise would otherwise count.
    """
    before, middle, after = changes[0], changes[2], changes[4]
    if _correlation(before, after) < STEADY:
        return 0.0, 0.0
    usual = 0.5 * (before + after)
    return (1.0 - float(middle @ usual / (usual @ usual))) * slice_mm, _correlation(middle, usual)


def _correlation(one: Array, other: Array) -> float:
    return float(one @ other) / float(np.linalg.norm(one) * np.linalg.norm(other))
