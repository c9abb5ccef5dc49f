"""Detection of a drilled hole near a planned trajectory, as bone missing from the second scan.

A blurred cylinder is fitted where bone was lost. A hole has an entry and a direction, but no tip.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform
from scipy.special import erfc

from procedures.imaging.volume import Volume
from procedures.postoperative.bone_registration import (
    BONE_HU,
    COMPACT_HU,
    SOFT_HU,
    sample_bone,
    sample_bone_spline,
)
from procedures.postoperative.planned_line import (
    STEP_MM,
    ExpectedFit,
    FitQuality,
    FittedAxis,
    PlannedLine,
    mark_at_bound,
    sample_along,
    select_voxels,
)
from ronna_hw.arrays import Array
from ronna_hw.robust_scale import robust_sigma

LOST_HU = 300.0  # by which it is darker than the bone before
MOST_PIECES = 3  # of lost bone examined per trajectory
LEAST_VOLUME_MM3 = 8.0  # in one piece: a 1.5 mm drill through 5 mm of bone
AROUND_MM = 6.0
BEFORE_MM, BEHIND_MM = 10.0, 25.0  # of the entry: a skull cut at a slant
FIRST_RADIUS_MM, FIRST_SPREAD_MM = 1.5, 0.6
NOISE_HU = 60.0  # of both scans, and of the remaining registration error


# u and v at the middle, their slopes, radius, HU of the filling, edge blur
PLACED = 5  # number of parameters that give the position; the filling may be darker than soft tissue
LOW = np.array([-3.0, -3.0, -0.5, -0.5, 0.4, SOFT_HU - 1.0, 0.2])
HIGH = np.array([3.0, 3.0, 0.5, 0.5, 5.0, BONE_HU, 1.5])
# noise of both scans and bone edges left by the registration; from the thinnest to the thickest drill
USUAL_HOLE = ExpectedFit(residual_hu=150.0, radius_mm=(0.5, 4.0))


def find_holes(
    pre: Volume, post: Volume, line: PlannedLine, post_from_pre: RigidTransform
) -> tuple[FittedAxis, ...]:
    """Find holes near a planned trajectory of the first scan, largest first.

    Positions are in the second scan's coordinates.
    """
    back = post_from_pre.inv()
    post_line = line.apply_pose(post_from_pre)
    seen = sample_along(post, post_line, -BEFORE_MM, BEHIND_MM)
    before = sample_bone(pre, back.apply(post_line.to_patient_mm(seen.places_mm)))
    is_lost = (before > BONE_HU) & (before - np.clip(seen.values, SOFT_HU, COMPACT_HU) > LOST_HU)
    labels, count = ndimage.label(is_lost)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    largest = [1 + int(number) for number in np.argsort(-sizes)[:MOST_PIECES]]
    pieces = [number for number in largest if sizes[number - 1] * STEP_MM**3 >= LEAST_VOLUME_MM3]
    middles = [seen.places_mm[labels == number].mean(axis=0) for number in pieces]
    return tuple(_fit_hole(pre, post, post_line, back, middle) for middle in middles)


def _fit_hole(
    pre: Volume, post: Volume, post_line: PlannedLine, back: RigidTransform, middle: Array
) -> FittedAxis:
    """Fit a blurred cylinder to the second scan's voxels around the centre of the missing bone."""
    coarse = PlannedLine(
        post_line.to_patient_mm(middle), post_line.to_patient_mm(middle + np.array([1.0, 0.0, 0.0]))
    )
    local, values = select_voxels(post, coarse, (-BEFORE_MM, BEFORE_MM), AROUND_MM)
    before = sample_bone_spline(pre, back.apply(coarse.to_patient_mm(local)))
    bone = before > BONE_HU
    scanned = bone & np.isfinite(values)
    is_whole = bool(scanned[bone].all())
    local, before, after = local[scanned], before[scanned], np.clip(values[scanned], SOFT_HU, COMPACT_HU)

    def residuals(unknown: Array) -> Array:
        u0, v0, du, dv, radius_mm, fluid, spread_mm = unknown
        across = np.hypot(local[:, 1] - u0 - du * local[:, 0], local[:, 2] - v0 - dv * local[:, 0])
        share = 0.5 * erfc((across - radius_mm) / (np.sqrt(2.0) * spread_mm))
        return np.asarray(before + (fluid - before) * share - after)

    start = np.array([0.0, 0.0, 0.0, 0.0, FIRST_RADIUS_MM, 20.0, FIRST_SPREAD_MM])
    found = least_squares(residuals, start, bounds=(LOW, HIGH), loss="soft_l1", f_scale=NOISE_HU)
    u0, v0, du, dv, radius_mm = found.x[:PLACED]
    middle_mm = coarse.to_patient_mm(np.array([0.0, u0, v0]))
    inwards = coarse.axes @ np.array([1.0, du, dv])
    quality = FitQuality(
        is_whole,
        found.success,
        not mark_at_bound(found.x, LOW, HIGH)[:PLACED].any(),
        robust_sigma(residuals(found.x)),
        float(radius_mm),
    )
    return FittedAxis(middle_mm, -inwards / np.linalg.norm(inwards), quality)
