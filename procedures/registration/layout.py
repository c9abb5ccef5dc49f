"""Finds a known layout of spheres among the spheres of a scan, or refuses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import pdist
from scipy.spatial.transform import RigidTransform

from procedures.registration.correspondence import MatchStatus
from procedures.registration.errors import LayoutNotFound
from procedures.registration.matching import MOST_POINTS, match
from procedures.registration.points import checked_points
from procedures.registration.template import TEMPLATE_SIGMA_MM

# Per axis: a scanner's scale and table feed over the width of a frame (0.1 % of 100 mm), plus noise.
SCAN_SIGMA_MM = 0.12
TOO_MANY = "Check --diameter-mm; or list the spheres of the layout in a file for --pick."


@dataclass(frozen=True, eq=False)
class FoundLayout:
    """The layout as found: `order` (k,) is, for each of its spheres, the index of the scan's sphere."""

    order: NDArray[np.intp]
    scan_from_layout: RigidTransform
    residual_rms_mm: float
    others: tuple[int, ...]


def find_layout(layout_mm: ArrayLike, spheres_mm: ArrayLike) -> FoundLayout:
    """Find a layout (k, 3), k at least 3, among the spheres (n, 3) of a scan, both in mm.

    Every sphere of the layout must be present, in exactly one way, each where the others predict it to within
    the scanner's accuracy. Raises REG-012, REG-001.
    """
    layout, spheres = checked_points(layout_mm, "layout"), checked_points(spheres_mm, "scan")
    if len(spheres) > MOST_POINTS:
        raise LayoutNotFound(
            "the scan shows too many spheres to search it for a layout",
            expected=f"at most {MOST_POINTS}",
            got=str(len(spheres)),
            action=TOO_MANY,
        )
    found = match(
        layout,
        spheres,
        sigma_image_mm=TEMPLATE_SIGMA_MM,
        sigma_physical_mm=SCAN_SIGMA_MM,
        expected=len(layout),
    )
    if found.transform is None or found.status is not MatchStatus.UNIQUE:
        ambiguous = found.status is MatchStatus.AMBIGUOUS
        raise LayoutNotFound(
            "the layout fits the scan in more than one way"
            if ambiguous
            else "the scan does not show the whole layout",
            expected=f"all {len(layout)} spheres of the layout, up to {_width_mm(layout):.1f} mm apart",
            got=f"{len(spheres)} spheres, up to {_width_mm(spheres):.1f} mm apart",
        )
    order = found.pairs[np.argsort(found.pairs[:, 0]), 1]
    residuals_mm = np.linalg.norm(found.transform.apply(layout) - spheres[order], axis=1)
    return FoundLayout(
        order, found.transform, float(np.sqrt(np.mean(np.square(residuals_mm)))), found.unmatched_physical
    )


def _width_mm(points_mm: NDArray[np.float64]) -> float:
    """The largest distance between two points; a wrong unit shows at a glance."""
    return float(pdist(points_mm).max(initial=0.0))
