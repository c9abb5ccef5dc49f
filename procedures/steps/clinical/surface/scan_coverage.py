"""Skin that a scan has covered so far, of what is planned, and the error to expect at the targets with it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from procedures.engine.events import ScanProgress
from procedures.registration.surface.errors import LITTLE_COVERAGE
from procedures.registration.surface.stations import PLANNED_POINTS, expect_error
from procedures.registration.surface.surface import Surface
from procedures.registration.surface.thinning import thin_points
from procedures.steps.clinical.surface.surface_paths import SEEN_MM
from ronna_hw.arrays import Array
from ronna_hw.errors import RonnaError, is_error

COVERED_MM = 5.0  # a place of the skin this near to a point is covered: half of the way to the next line

# Of the expected error, which is shown only below this.
# Safety against a figure of places that allow any pose (U).
DETERMINED_MM = 10.0


class ScanCoverage:
    """Places of the skin around the middles of looks (n, 3), and those covered; all in the CT, mm."""

    def __init__(self, skin: Surface, middles_mm: ArrayLike, targets_mm: ArrayLike) -> None:
        places_mm = skin.points_mm
        apart, _ = cKDTree(middles_mm).query(places_mm, distance_upper_bound=SEEN_MM)
        planned = np.isfinite(apart)
        self._places, self._normals = places_mm[planned], skin.normals[planned]
        self._covered = np.zeros(len(self._places), dtype=bool)
        self._targets = np.asarray(targets_mm, dtype=float)

    def add(self, points_mm: Array) -> None:
        """Add points (n, 3) of a look."""
        if len(points_mm) and len(self._places):
            apart, _ = cKDTree(points_mm).query(self._places, distance_upper_bound=COVERED_MM)
            self._covered |= np.isfinite(apart)

    def after(self, looks_done: int, looks_planned: int) -> ScanProgress:
        """Return the state of the scan after some of its looks."""
        return ScanProgress(
            looks_done=looks_done,
            looks_planned=looks_planned,
            covered_share=float(self._covered.mean()) if len(self._covered) else 0.0,
            predicted_error_mm=self._expect_error(),
        )

    def _expect_error(self) -> float | None:
        if not self._covered.any():
            return None
        places, normals = self._places[self._covered], self._normals[self._covered]
        rows = thin_points(places, PLANNED_POINTS)
        try:
            expected = expect_error(places[rows], normals[rows], self._targets)
        except RonnaError as problem:
            if not is_error(problem, LITTLE_COVERAGE):
                raise
            return None
        rms_mm = float(np.sqrt(np.mean([one.rms_mm**2 for one in expected])))
        return rms_mm if rms_mm < DETERMINED_MM else None


def describe_scan(state: ScanProgress) -> str:
    """Describe the state of a scan in one line."""
    expected = state.predicted_error_mm
    return (
        f"looked {state.looks_done} of {state.looks_planned} times at the skin, {state.covered_share:.0%} of "
        "what was planned"
        + ("" if expected is None else f", expected error {expected:.2f} mm without arm and guide")
    )
