"""Sphere localization in the CT."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.methods import NOT_CLINICAL
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.imaging.localizers import LOCALIZERS, Localizer
from procedures.imaging.markers import Candidate, Marker, ScanDeformation
from procedures.imaging.pictures import draw_candidates, draw_markers
from procedures.imaging.scan_deformation import require_undeformed
from procedures.journal.results import StepResult, Values
from procedures.planning.target_error import scan_errors
from procedures.registration.target_prediction import SharedErrors
from procedures.steps.clinical.ct_import import ImportedCt, volume_of
from procedures.steps.conditions import needs_guide_unmounted
from ronna_hw.arrays import Array
from ronna_hw.calibration import Numbers3

PICTURED_DOUBTFUL = 6  # the likeliest; more would hide the markers in the report


class DoubtfulSphere(Values):
    """Object of the right size that was not accepted as a sphere."""

    centre_mm: Numbers3 = Field(description="Centre, LPS.")
    reason: str = Field(description="Why it is doubtful.")
    odds: float = Field(description="That it is a marker, below even.")

    @classmethod
    def of(cls, candidate: Candidate) -> DoubtfulSphere:
        """Take centre, reason and odds of a candidate."""
        return cls(centre_mm=candidate.centre_mm, reason=candidate.reason, odds=candidate.odds)


class LocalizedFiducials(StepResult, kind="fiducial_localization", version=2):
    """Spheres found in the CT, from superior to inferior."""

    series_instance_uid: str = Field(description="DICOM UID of the series they were found in.")
    diameter_mm: float = Field(description="Nominal diameter searched for.")
    markers: tuple[Marker, ...] = Field(description="The spheres.")
    doubtful: tuple[DoubtfulSphere, ...] = Field(description="What may be a sphere, likeliest first.")
    warnings: tuple[str, ...] = Field(default=(), description="What they said of the scan; none any more.")
    deformation: ScanDeformation | None = Field(
        default=None, description="Stretch and shear of the scan, as they show it; none if unknown."
    )
    localizer: Localizer = Field(default=Localizer.OURS, description="Method that found them.")

    since: ClassVar[str] = "the CT"  # since when a sphere may have moved

    @property
    def centres_mm(self) -> Array:
        """Centres (n, 3), LPS mm."""
        return np.array([marker.centre_mm for marker in self.markers], dtype=float).reshape(-1, 3)

    @property
    def shown(self) -> tuple[int, ...]:
        """Indices of the spheres that may be measured: their scan shows them."""
        return tuple(range(len(self.markers)))

    @property
    def numbered(self) -> dict[int, Marker]:
        """The spheres that may be measured, by their number for people: counted from 1, as in the CT."""
        return {index + 1: self.markers[index] for index in self.shown}

    def count_expected(self, implanted: int) -> int:
        """Return the number of spheres to match in the room, of as many as the plan has `implanted`."""
        return implanted

    def seating_mm(self, stated_mm: float) -> float:
        """Return the error per axis with which the spheres were refitted since, as the theatre states it."""
        return stated_mm

    def scan_errors(self, spheres_mm: Array, target_mm: ArrayLike, rotation: Array) -> SharedErrors:
        """Return the errors of stretched or sheared scans at these spheres (n, 3) and a target, CT mm.

        `rotation` (3, 3) is robot <- CT.
        """
        return scan_errors(self.deformation, spheres_mm, target_mm, rotation)

    def place_errors(
        self, target_mm: Sequence[float], rotation: Array, spheres: int
    ) -> tuple[SharedErrors, ...]:
        """Return the errors of the spheres' scan against the plan's CT, at a target; none, it is that CT.

        `rotation` (3, 3) is robot <- CT, `spheres` their number.
        """
        return ()

    @property
    def disagreement_mm(self) -> dict[int, float]:
        """Distance (mm) between the two estimates of each centre, by index."""
        return {index: self.markers[index].agreement_mm for index in self.shown}

    @property
    def assumed_error(self) -> str:
        """Say whose error stands for that of a localizer that states none; empty for one that does."""
        published_mm = LOCALIZERS[self.localizer].published_mm
        if published_mm is None:
            return ""
        return (
            f"{self.localizer} states no error: its share CT is the {published_mm:.3f} mm published for it, "
            "equal on all axes"
        )


def run(context: StepContext) -> Outcome[LocalizedFiducials]:
    """Localize every sphere; refuse a scan that they show to be deformed (CT-024).

    The plan check compares their number with the plan.
    """
    volume = volume_of(context)
    localizer = context.clinical.methods.localizer
    described = LOCALIZERS[localizer]
    found = described.load()(volume, progress=lambda share: context.progress(share, "localizing the spheres"))
    require_undeformed(found.deformation)
    for number, picture in enumerate(draw_markers(volume, found), start=1):
        context.keep_picture(f"ct-{number}.png", picture)
    doubtful = found.doubtful[:PICTURED_DOUBTFUL]
    for number, picture in enumerate(draw_candidates(volume, doubtful), start=1):
        context.keep_picture(f"ct-doubtful-{number}.png", picture)
    return Outcome(
        LocalizedFiducials(
            series_instance_uid=found.series_instance_uid,
            diameter_mm=found.diameter_mm,
            markers=found.markers,
            doubtful=tuple(map(DoubtfulSphere.of, found.doubtful)),
            deformation=found.deformation,
            localizer=localizer,
        ),
        summary=f"{len(found.markers)} spheres"
        + (f"; doubtful, not taken: {len(found.doubtful)}" if found.doubtful else "")
        + ("" if described.is_clinical else f"; by {localizer}: {NOT_CLINICAL}"),
    )


STEP = StepSpec(
    LocalizedFiducials,
    "Localize the spheres in the CT",
    Phase.PREOPERATIVE,
    run,
    reads=(ImportedCt,),
    preconditions=needs_guide_unmounted,
)
