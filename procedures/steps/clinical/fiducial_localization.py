"""Localization of the spheres in the CT."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.imaging.localization import localize
from procedures.imaging.markers import Candidate, Marker
from procedures.imaging.pictures import marker_pictures
from procedures.journal.results import Matrix3, StepResult, Values
from procedures.steps.clinical.ct_import import ImportedCt, volume_of
from procedures.steps.conditions import localizable
from ronna_hw.calibration import Numbers3


class LocalizedMarker(Values):
    """One sphere in the CT."""

    centre_mm: Numbers3 = Field(description="Centre, LPS.")
    covariance_mm2: Matrix3 = Field(description="Covariance of the centre, LPS.")
    radius_mm: float = Field(description="Fitted radius.")
    quality: float = Field(
        description="Share of the surface used, 0 to 1, reduced by disagreement of the estimates."
    )
    agreement_mm: float = Field(description="Distance between the two estimates of the centre.")
    flags: tuple[str, ...] = Field(description="Reasons that make it less certain.")
    odds: float = Field(description="That it is a marker, 0 to 1, at least even.")

    @classmethod
    def of(cls, marker: Marker) -> LocalizedMarker:
        """Convert the localizer's marker to plain numbers."""
        return cls(
            centre_mm=marker.centre_mm.tolist(),
            covariance_mm2=marker.covariance_mm2.tolist(),
            radius_mm=float(marker.radius_mm),
            quality=float(marker.quality),
            agreement_mm=float(marker.agreement_mm),
            flags=tuple(marker.flags),
            odds=float(marker.odds),
        )


class DoubtfulSphere(Values):
    """A body of the right size that was not accepted as a sphere."""

    centre_mm: Numbers3 = Field(description="Centre, LPS.")
    reason: str = Field(description="Why it is doubtful.")
    odds: float = Field(description="That it is a marker, below even.")

    @classmethod
    def of(cls, candidate: Candidate) -> DoubtfulSphere:
        """Convert the localizer's candidate to plain numbers."""
        return cls(centre_mm=candidate.centre_mm, reason=candidate.reason, odds=float(candidate.odds))


class LocalizedFiducials(StepResult, kind="fiducial_localization", version=2):
    """The spheres of the CT, from superior to inferior."""

    series_instance_uid: str = Field(description="DICOM UID of the series they were found in.")
    diameter_mm: float = Field(description="Nominal diameter searched for.")
    markers: tuple[LocalizedMarker, ...] = Field(description="The spheres.")
    doubtful: tuple[DoubtfulSphere, ...] = Field(description="What may be a sphere, likeliest first.")
    warnings: tuple[str, ...] = Field((), description="What the spheres together say of the scan.")

    @property
    def centres_mm(self) -> NDArray[np.float64]:
        """Centres (n, 3), LPS mm."""
        return np.array([marker.centre_mm for marker in self.markers], dtype=float).reshape(-1, 3)

    @property
    def disagreement_mm(self) -> dict[int, float]:
        """Distance between the two estimates of each centre, by index."""
        return {index: marker.agreement_mm for index, marker in enumerate(self.markers)}


def run(context: StepContext) -> Outcome[LocalizedFiducials]:
    """Localize every sphere; their number is checked with the plan."""
    volume = volume_of(context)
    found = localize(volume, progress=lambda share: context.progress(share, "localizing the spheres"))
    for number, picture in enumerate(marker_pictures(volume, found), start=1):
        context.keep_picture(f"ct-{number}.png", picture)
    return Outcome(
        LocalizedFiducials(
            series_instance_uid=found.series_instance_uid,
            diameter_mm=found.diameter_mm,
            markers=tuple(LocalizedMarker.of(marker) for marker in found.markers),
            doubtful=tuple(DoubtfulSphere.of(candidate) for candidate in found.doubtful),
            warnings=found.warnings,
        ),
        summary=f"{len(found.markers)} spheres"
        + (f"; doubtful, not taken: {len(found.doubtful)}" if found.doubtful else "")
        + "".join(f"; {warning}" for warning in found.warnings),
    )


STEP = StepSpec(
    LocalizedFiducials,
    "Localize the spheres in the CT",
    Phase.PREOPERATIVE,
    run,
    reads=(ImportedCt,),
    preconditions=localizable,
)
