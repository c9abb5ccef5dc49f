"""Watches the stereo head during a case: are both cameras still where their calibration says?

A camera that rotates in its mount shifts every sphere by the same vector, which neither the registration
residual nor the distances between spheres can reveal. Each image pair shows it in three ways:

- a rotation in the plane of both lines of sight moves their intersection towards one camera and away
  from the other, so the sphere's outlines have unequal sizes: 0.17 % for 0.2 degrees.
- both cameras rotated towards each other move it nearer, and the spheres appear too small: by 0.26 % and
  more for 0.2 degrees each, with equal outlines.
- a rotation out of that plane opens a gap between the lines of sight: 0.9 mm for 0.2 degrees.

All are medians over all spheres of a re-localization, so that blood or glare on one of them does not count.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from procedures.relocalization.errors import HeadTurned
from procedures.relocalization.triangulation import SPHERE_DIAMETER_MM
from ronna_hw.text import side_by_side

# Left minus right radius over the sphere's. Focal lengths known to 1e-4 each scatter it by 1.5e-4 from head
# to head (0.04e-2 at most over the scenes of seeds 0 to 19); 0.2 deg change it by 0.16e-2 to 0.20e-2.
LARGEST_UNLIKENESS = 0.0009
# Mean radius over the expected. The same focal lengths scatter it by 1.1e-4 (at most 2.2e-4 over 21 heads).
LARGEST_SIZE_ERROR = 0.0005
# Over the stated error of a point, to which cameras that are off by as much at random open a gap; those of a
# calibration leave 0.001 mm.
LARGEST_GAP_OVER_STATED = 5.0
LEAST_GAP_LIMIT_MM = 0.02  # rims measured to a few micrometres never meet better


def check_head(
    radii_mm: Sequence[tuple[float, float]],
    ray_gaps_mm: Sequence[float],
    stated_error_mm: float,
    sphere_diameter_mm: float = SPHERE_DIAMETER_MM,
) -> None:
    """Raise STE-014 when the spheres of one re-localization show that a camera has moved.

    `radii_mm` are the radii from the left and the right outline at the measured position, per sphere;
    `stated_error_mm` is from the head's calibration record, `sphere_diameter_mm` as its cameras see them.
    """
    unlikeness = median(2.0 * (left - right) / (left + right) for left, right in radii_mm)
    if abs(unlikeness) > LARGEST_UNLIKENESS:
        raise HeadTurned(
            "a camera of the stereo head has rotated: the spheres appear larger in one "
            "camera than in the other",
            limit=f"{LARGEST_UNLIKENESS:.2%}",
            got=f"{abs(unlikeness):.2%}",
        )
    radius_mm = median((left + right) / 2.0 for left, right in radii_mm)
    size_error = 2.0 * radius_mm / sphere_diameter_mm - 1.0
    if abs(size_error) > LARGEST_SIZE_ERROR:
        raise HeadTurned(
            "both cameras of the stereo head have rotated, or these are other spheres: their size is wrong",
            limit=f"{LARGEST_SIZE_ERROR:.2%} of {sphere_diameter_mm:g} mm (procedure.sphere_diameter_mm)",
            got=f"{abs(size_error):.2%}",
        )
    gap_mm = median(ray_gaps_mm)
    limit_mm = max(LEAST_GAP_LIMIT_MM, LARGEST_GAP_OVER_STATED * stated_error_mm)
    if gap_mm > limit_mm:
        gap, limit = side_by_side(gap_mm, limit_mm, 2)
        raise HeadTurned(
            "a camera of the stereo head has moved: the lines of sight do not meet",
            limit=f"{limit} mm",
            got=f"{gap} mm",
        )
