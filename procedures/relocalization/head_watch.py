"""Watches the stereo head during a case: do both cameras still sit where their calibration says?

A camera that turns in its mount moves every sphere by the same vector, which neither the fit of the
registration nor the distances between spheres can show. Two things in each pair do show it:

- turned in the plane of both lines of sight, it moves the place where they meet towards one camera and away
  from the other: the sphere's outlines then have unequal sizes. 0.2 degrees make 0.17 %.
- turned out of that plane, it opens a gap between the lines of sight: 0.2 degrees make 0.9 mm.

Both are medians over all spheres of a re-localization: blood or glare on one of them is not the head's.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from procedures.relocalization.errors import HeadTurned
from ronna_hw.text.beyond import told_apart

# Left minus right radius over the sphere's. Focal lengths known to 1e-4 each scatter it by 1.5e-4 from head
# to head (0.04e-2 at most over the scenes of seeds 0 to 19); 0.2 deg make it 0.16e-2 to 0.20e-2.
LARGEST_UNLIKENESS = 0.0009
# Over the stated error of the head, which is about the gap's own standard deviation from head to head.
LARGEST_GAP_OVER_STATED = 5.0
LEAST_GAP_LIMIT_MM = 0.02  # rims that are measured to a few micrometres never meet better


def check_head(
    radii_mm: Sequence[tuple[float, float]], ray_gaps_mm: Sequence[float], stated_error_mm: float
) -> None:
    """Raise STE-014 when the spheres of one re-localization show that a camera has moved.

    `radii_mm` are those that the left and the right outline give at the measured place, sphere by sphere;
    `stated_error_mm` is that of the head's calibration record.
    """
    unlikeness = median(2.0 * (left - right) / (left + right) for left, right in radii_mm)
    if abs(unlikeness) > LARGEST_UNLIKENESS:
        raise HeadTurned(
            "a camera of the stereo head has rotated: the spheres appear larger in one "
            "camera than in the other",
            limit=f"{LARGEST_UNLIKENESS:.2%}",
            got=f"{abs(unlikeness):.2%}",
        )
    gap_mm = median(ray_gaps_mm)
    limit_mm = max(LEAST_GAP_LIMIT_MM, LARGEST_GAP_OVER_STATED * stated_error_mm)
    if gap_mm > limit_mm:
        gap, limit = told_apart(gap_mm, limit_mm, 2)
        raise HeadTurned(
            "a camera of the stereo head has moved: the lines of sight do not meet",
            limit=f"{limit} mm",
            got=f"{gap} mm",
        )
