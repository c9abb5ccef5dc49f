"""Whether the layout of the fiducials makes them distinguishable, before they are localized in the room."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.registration import MatchStatus, match
from ronna_hw.marker_template import IMPLANTED_SIGMA_MM

LEAST_SIDE_DIFFERENCE_MM = 6.0  # in a triangle of fiducials: below it three points are often ambiguous
CT_SIGMA_MM = 0.10  # per axis: what the localizer achieves on a poor series, with margin
ROOM_SIGMA_MM = 0.56  # per axis: the coarsest tracker used in the correspondence study


def least_side_difference_mm(triangle_mm: ArrayLike) -> float:
    """The smallest difference between two sides of a triangle of fiducials (3, 3) in mm."""
    points = np.asarray(triangle_mm, dtype=float)
    sides = np.sort([np.linalg.norm(points[a] - points[b]) for a, b in combinations(range(3), 2)])
    return float(np.diff(sides).min())


def shows_template(template_mm: ArrayLike, fiducials_mm: ArrayLike) -> bool:
    """Whether fiducials (n, 3) of a CT contain those of a template (k, 3), in one way only; both in mm."""
    found = match(
        template_mm,
        fiducials_mm,
        sigma_image_mm=IMPLANTED_SIGMA_MM,
        sigma_physical_mm=CT_SIGMA_MM,
        expected=len(np.asarray(template_mm)),
    )
    return found.status is MatchStatus.UNIQUE


def layout_warnings(fiducials_mm: NDArray[np.float64]) -> list[str]:
    """What may make the correspondence of fiducials (n, 3) in mm ambiguous; empty if nothing does."""
    if len(fiducials_mm) == 3:
        smallest = least_side_difference_mm(fiducials_mm)
        if smallest >= LEAST_SIDE_DIFFERENCE_MM:
            return []
        return [
            f"two sides of the fiducial triangle differ by {smallest:.1f} mm (at least "
            f"{LEAST_SIDE_DIFFERENCE_MM:g} mm are needed to tell them apart)"
        ]
    alike = match(fiducials_mm, fiducials_mm, sigma_image_mm=0.0, sigma_physical_mm=ROOM_SIGMA_MM)
    if alike.status is not MatchStatus.AMBIGUOUS or alike.runner_up is None:
        return []
    taken = [f"{i + 1} for {j + 1}" for i, j in alike.runner_up.pairs.tolist() if i != j]
    return [f"the fiducials look alike from another side: {', '.join(taken)} could be mistaken"]
