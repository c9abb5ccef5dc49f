"""Skin that a scan has covered so far, of what is planned, and the error to expect at the targets with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from procedures.engine.events import ExpectedError, ScanProgress
from procedures.planning.fiducial_choice import SPHERE_SD_MM
from procedures.registration.surface.errors import LITTLE_COVERAGE
from procedures.registration.surface.stations import PLANNED_POINTS, ExpectedPose
from procedures.registration.surface.surface import Surface
from procedures.registration.surface.thinning import thin_points
from procedures.steps.clinical.surface.surface_paths import SEEN_MM
from ronna_hw.arrays import Array
from ronna_hw.errors import RonnaError, is_error

COVERED_MM = 5.0  # a place of the skin this near to a point is covered: half of the way to the next line

SHOWN_PLACES = 400  # most places that are published: 4 mm apart, as a picture shows them
DECIMALS = 1  # of their coordinates, mm

# Of the expected error, which is shown only below this.
# Safety against a figure of places that allow any pose (U).
DETERMINED_MM = 10.0


class ScanCoverage:
    """Places of the skin around the middles of looks (n, 3), and those covered; all in the CT, mm.

    `targets_mm` has the place of each target by its name. `spheres_mm` (m, 3) are looked at after the skin:
    the error to expect counts them from the start.
    """

    def __init__(
        self,
        skin: Surface,
        middles_mm: ArrayLike,
        targets_mm: Mapping[str, Sequence[float]],
        spheres_mm: ArrayLike = (),
    ) -> None:
        places_mm = skin.points_mm
        apart, _ = cKDTree(middles_mm).query(places_mm, distance_upper_bound=SEEN_MM)
        planned = np.isfinite(apart)
        self._places, self._normals = places_mm[planned], skin.normals[planned]
        self._shown = thin_points(self._places, SHOWN_PLACES)
        self._covered = np.zeros(len(self._places), dtype=bool)
        self._targets = targets_mm
        self._spheres = np.asarray(spheres_mm, dtype=float).reshape(-1, 3)
        self._expected: list[list[float]] = []  # mm rms at each target after each look

    def add(self, points_mm: Array) -> None:
        """Add a look by its points (n, 3), none of one that shows no line."""
        if len(points_mm) and len(self._places):
            apart, _ = cKDTree(points_mm).query(self._places, distance_upper_bound=COVERED_MM)
            self._covered |= np.isfinite(apart)
        self._expected.append(self._expect_errors())

    def after(self, looks_planned: int) -> ScanProgress:
        """Return the state of the scan after the looks that were added."""
        places, covered = np.round(self._places[self._shown], DECIMALS), self._covered[self._shown]
        latest = self._expected[-1] if self._expected else [np.inf]
        return ScanProgress(
            looks_done=len(self._expected),
            looks_planned=looks_planned,
            covered_share=float(self._covered.mean()) if len(self._covered) else 0.0,
            predicted_error_mm=_told(float(np.sqrt(np.mean(np.square(latest))))),
            expected=tuple(
                ExpectedError(target=target, rms_mm=tuple(_told(after[place]) for after in self._expected))
                for place, target in enumerate(self._targets)
            ),
            covered_mm=places[covered].tolist(),
            missing_mm=places[~covered].tolist(),
        )

    def _expect_errors(self) -> list[float]:
        """Return the rms error at each target, infinite without enough skin."""
        unknown = [np.inf] * len(self._targets)
        if not self._covered.any():
            return unknown
        places, normals = self._places[self._covered], self._normals[self._covered]
        rows = thin_points(places, PLANNED_POINTS)
        try:
            pose = ExpectedPose.of(places[rows], normals[rows])
        except RonnaError as problem:
            if not is_error(problem, LITTLE_COVERAGE):
                raise
            return unknown
        if len(self._spheres):
            pose = pose.with_spheres(self._spheres, SPHERE_SD_MM)
        return [pose.at(np.asarray(one, dtype=float)).rms_mm for one in self._targets.values()]


def _told(rms_mm: float) -> float | None:
    return rms_mm if rms_mm < DETERMINED_MM else None


def describe_scan(state: ScanProgress) -> str:
    """Describe the state of a scan in one line."""
    expected = state.predicted_error_mm
    return (
        f"looked {state.looks_done} of {state.looks_planned} times at the skin, {state.covered_share:.0%} of "
        f"the skin around the planned looks lies within {COVERED_MM:g} mm of a line"
        + ("" if expected is None else f", expected error {expected:.2f} mm without arm and guide")
    )
