"""Registration on the skin: what was scanned, what of it was used, and how the skin differs from the CT."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import PurePath
from typing import Self

import numpy as np

from procedures.operator.question import Topic
from procedures.reporting.run_reading import RunReading
from procedures.steps.clinical.correspondence import MeasuredHead, SurfaceStart
from procedures.steps.clinical.fiducial_localization import ExcludedSkin, SkinInCt
from procedures.steps.clinical.results import RegisteredBySurface, ScannedSurface
from procedures.steps.clinical.surface.landmark_reading import BY_POINTER, most_apart_mm
from procedures.steps.clinical.surface.skin_pictures import (
    COVERAGE_PICTURE,
    FULL_COLOUR_MM,
    colour_residuals,
    tell_coverage,
)
from procedures.steps.clinical.surface.surface_registration import SIDES_COMPARED
from procedures.steps.clinical.surface.surface_start import READ_MM
from ronna_hw.text import format_count

SURFACE_PICTURES = "surface-"  # names of pictures of the skin begin with it
LEAST_TOLD = 0.001  # of the boundary
# Skin while it is scanned and afterwards, in pictures and scene.
SCANNED_SKIN, MISSING_SKIN = "scanned", "planned, not covered"
THREE_SIDES = "Skin in the CT from the right, the front and the left"
COVERAGE_CAPTION = f"{THREE_SIDES}; green: {SCANNED_SKIN}; pink: {MISSING_SKIN}"


@dataclass(frozen=True)
class SurfaceSection:
    """Results of a case without markers, as far as it came."""

    skin: SkinInCt
    start: SurfaceStart | None
    scan: ScannedSurface | None
    registration: RegisteredBySurface | None
    sides_by_script: bool = False  # a script answered that left and right were compared
    full_colour_mm: float = FULL_COLOUR_MM

    def known_by(self, *, start: bool, scan: bool, registration: bool) -> Self:
        """Return the section at an earlier moment, at which these results were there."""
        return replace(
            self,
            start=self.start if start else None,
            scan=self.scan if scan else None,
            registration=self.registration if registration else None,
        )

    @property
    def told(self) -> tuple[ExcludedSkin, ...]:
        """Parts of the boundary that are not used, without those that are hardly there."""
        return tuple(one for one in self.skin.excluded if one.share >= LEAST_TOLD)

    @property
    def registered(self) -> str:
        """By what the case is registered, to go on in a sentence; '' before that."""
        if self.registration is None:
            return ""
        screws = self.registration.pairs
        return "registered on the skin" + (f" and {format_count(screws, 'screw')}" if screws else "")

    @property
    def carrying(self) -> str:
        """How the clamp carried a former registration, as a sentence; '' if it did not."""
        if self.registration is None or not self.registration.carried:
            return ""
        looks = format_count(self.registration.confirming_looks, "look")
        return (
            "The clamp carried a former registration to where the head is now, confirmed by "
            f"{looks}; points, misfit and the share left out are of the former scan."
        )

    @property
    def told_sides(self) -> str:
        """Say who has told left from right where neither skin nor mark does, as a sentence; else ''."""
        if self.registration is None or self.registration.side_proven:
            return ""
        compared = "the operator has compared them"
        if self.sides_by_script:
            compared = "a script answered that they were compared, and nobody has compared them"
        return f"Left and right cannot be told apart by the skin alone: {compared}."

    @property
    def landmark_limits(self) -> str:
        """Say how far landmarks, and the mark of an entry, may be from their places."""
        if self.start is None:
            return ""
        limits = []
        if self.start.landmarks:
            rms_mm = most_apart_mm(len(self.start.pairs), BY_POINTER.deviation_mm)
            beside = f" beside {format_count(len(self.start.pairs), 'sphere')}" if self.start.pairs else ""
            limits.append(f"the landmarks together by {rms_mm:.1f} mm rms at most{beside}")
        if self.start.site is not None:
            limits.append(f"the mark of an entry by {READ_MM:g} mm")
        return f"Accepted: {', '.join(limits)}." if limits else ""

    @property
    def points(self) -> int:
        """Points of the scan."""
        return 0 if self.scan is None else sum(len(line.points_mm) for line in self.scan.lines)

    @property
    def told_coverage(self) -> str:
        """How much of the head the points of the registration cover; before it, those of the scan.

        A carried registration has its points from a former scan.
        """
        if self.registration is not None and not self.registration.carried:
            return tell_coverage(self.registration.coverage, "the registration")
        return tell_coverage(0.0 if self.scan is None else self.scan.covered, self.placed_by)

    @property
    def told_progress(self) -> str:
        """Say what the operator saw of the scan at its end, as a sentence; nothing of an older record."""
        progress = None if self.scan is None else self.scan.progress
        if progress is None:
            return ""
        expected = progress.predicted_error_mm
        error = "" if expected is None else f", with {expected:.2f} mm rms expected without arm and guide"
        planned = format_count(progress.looks_planned, "look")
        covered = f"{progress.covered_share:.0%} of the skin around them was covered"
        return f" At the end of the scan {progress.looks_done} of {planned} were taken, and {covered}{error}."

    @property
    def placed_by(self) -> str:
        """Source of the pose by which the picture of the coverage places the points of the scan."""
        return "the landmarks" if self.start is None else self.start.placed_by

    @property
    def colour_scale(self) -> str:
        """The colours of the distances as a gradient of a style sheet, from inside to outside."""
        ends_mm = np.array([-self.full_colour_mm, 0.0, self.full_colour_mm])
        return ", ".join(f"rgb({r:.0f} {g:.0f} {b:.0f})" for b, g, r in colour_residuals(ends_mm))

    @property
    def coverage_caption(self) -> str:
        """What the picture of the coverage shows; scans of earlier versions have no place that is missing."""
        pink = f"; pink: {MISSING_SKIN}" if self.scan is not None and self.scan.progress is not None else ""
        return f"{THREE_SIDES}; green: {SCANNED_SKIN}, points placed by {self.placed_by}{pink}"


def read_surface(reading: RunReading) -> SurfaceSection | None:
    """Read the section; None for a case with markers."""
    skin = reading.find(SkinInCt)
    if skin is None:
        return None
    start, registration = reading.find(SurfaceStart), reading.find(RegisteredBySurface)
    asked = () if registration is None else registration.trajectories
    return SurfaceSection(
        skin,
        None if isinstance(start, MeasuredHead) else start,
        reading.find(ScannedSurface),
        registration,
        sides_by_script=any(
            reading.was_scripted(f"{Topic.REGISTRATION}:{one}", SIDES_COMPARED) for one in asked
        ),
    )


def caption_of_skin(name: str) -> str:
    """Describe a picture of the skin by its name."""
    if name.startswith(PurePath(COVERAGE_PICTURE).stem):
        return COVERAGE_CAPTION
    return (
        f"points by their distance to the skin in the CT: blue inside, red outside, full colour from "
        f"{FULL_COLOUR_MM:g} mm; rings are left out"
    )
