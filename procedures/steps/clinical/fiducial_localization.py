"""Sphere localization in the CT; its result, and that of a scan during the operation, which stands in for it.

Both results are defined here, so that all who read the spheres of a case find those that count in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.methods import NOT_CLINICAL
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.fusion.record import FusedPose
from procedures.imaging.dicom.slice_headers import hash_series
from procedures.imaging.localizers import LOCALIZERS, Localizer
from procedures.imaging.markers import Candidate, Marker, ScanDeformation
from procedures.imaging.pictures import draw_candidates, draw_markers
from procedures.imaging.scan_deformation import require_undeformed
from procedures.imaging.volume import Volume
from procedures.intraoperative.bone_pose import PoseEstimate
from procedures.journal.results import StepResult, Values
from procedures.planning.faced_head import face_bodies
from procedures.planning.head_in_ct import HeadEllipsoid, fit_head
from procedures.planning.plan_model import FiducialKind
from procedures.planning.scene import build_frame_bodies
from procedures.planning.target_error import scan_errors
from procedures.registration.error_sources import SCAN_PLACE
from procedures.registration.rigid_fit import pose_jacobian
from procedures.registration.target_prediction import SharedErrors
from procedures.steps.clinical.ct_import import ImportedCt, volume_of
from procedures.steps.conditions import needs_guide_unmounted
from ronna_hw.arm.clearance.bodies import Obstacle
from ronna_hw.arrays import Array
from ronna_hw.calibration import Numbers3
from ronna_hw.text import format_count

PICTURED_DOUBTFUL = 6  # the likeliest; more would hide the markers in the report
SixVectors = Annotated[tuple[Numbers3, ...], Field(min_length=6, max_length=6)]


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

    def head_in(self, volume: Volume) -> HeadEllipsoid:
        """Return the head in the CT as an obstacle. Raises PLAN-014."""
        return fit_head(volume)

    def bodies_on_head(self, fiducials: FiducialKind) -> tuple[Obstacle, ...]:
        """Return the obstacles on the head besides the spheres, CT frame. Raises REG-012."""
        return build_frame_bodies(fiducials, self.centres_mm)

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


class ScannedSphere(Values):
    """Sphere that the scan shows, and what became of it since the CT."""

    fiducial: int = Field(description="Its index in the CT; one that is new since then follows after those.")
    in_scan_mm: Numbers3 = Field(description="Centre in the scan, LPS.")
    sigma_mm: float = Field(description="Stated 3-D rms error of the centre.")
    is_cut: bool = Field(description="The field of the scan cuts it or its surroundings.")
    moved_mm: float | None = Field(description="Distance from its place at the CT; none if it is new.")
    agrees: bool = Field(description="It took part in the adjustment with the bone.")


class UnusedSphere(Values):
    """Sphere of the CT that the scan does not show well enough to be used."""

    fiducial: int = Field(description="Its index in the CT.")
    reason: str = Field(description="Why it is not used.")


class IntraoperativeSpheres(LocalizedFiducials, kind="intraoperative_scan", version=2):
    """Spheres found in a scan of the clamped head, in the coordinates of the planning CT.

    A sphere of the CT that it does not show keeps its index and its place in the CT, and is not measured.
    """

    ct_from_scan: FusedPose = Field(description="Pose planning CT <- scan.")
    ct_deformation: ScanDeformation | None = Field(
        default=None, description="Stretch and shear of the CT, which act on the targets; none if unknown."
    )
    files_sha256: str = Field(description="SHA-256 of the names and contents of the scan's DICOM files.")
    place_middle_mm: Numbers3 = Field(
        description="Point of the CT about which the pose's rotation is stated."
    )
    place_turns_rad: SixVectors = Field(
        description="Of six independent errors of the pose, of one standard deviation each, the rotation "
        "about that point, in the CT."
    )
    place_shifts_mm: SixVectors = Field(description="The shifts of the same six errors.")
    bone_agreement: float = Field(description="Correlation of the bone of both scans.")
    agreeing_starts: int = Field(description="Starting poses of the bone that led to this one.")
    starts: int = Field(description="Starting poses tried.")
    spheres: tuple[ScannedSphere, ...] = Field(description="Those that the scan shows, in their order.")
    unused: tuple[UnusedSphere, ...] = Field(
        default=(), description="Spheres of the CT that the scan does not show, or not whole."
    )
    expected_mm: Mapping[str, float] = Field(
        description="Expected rms error of the scan's place at each target, by trajectory, also if all "
        "spheres have moved together as far as passes unnoticed."
    )

    since: ClassVar[str] = "the scan during the operation"

    @property
    def shown(self) -> tuple[int, ...]:
        """Indices of the spheres that the scan shows."""
        return tuple(one.fiducial for one in self.spheres)

    def file_differences(self, series: Path) -> str:
        """Say how the files in `series` differ from the scan that was taken; empty if they do not.

        Raises CT-001, CT-005.
        """
        return "" if hash_series(series) == self.files_sha256 else "files changed, missing or added"

    def count_expected(self, implanted: int) -> int:
        """Return the number of spheres to match: those that the smaller field shows."""
        return min(implanted, len(self.shown))

    def seating_mm(self, stated_mm: float) -> float:
        """Return no error: the spheres were scanned as they sit."""
        return 0.0

    def scan_errors(self, spheres_mm: Array, target_mm: ArrayLike, rotation: Array) -> SharedErrors:
        """Return the errors of two stretched or sheared scans: of this one at spheres, of the CT at a target.

        The CT is placed by the spheres above all, so its error grows with the distance from them.
        """
        pose = self.ct_from_scan.rigid
        to_scan, turn = pose.inv(), pose.rotation.as_matrix()
        own = scan_errors(
            self.deformation,
            to_scan.apply(spheres_mm),
            to_scan.apply(np.asarray(target_mm, dtype=float)),
            rotation @ turn,
        )
        of_ct = scan_errors(self.ct_deformation, spheres_mm, target_mm, rotation)
        return SharedErrors(
            own.source,
            np.concatenate([own.at_spheres_mm, np.zeros_like(of_ct.at_spheres_mm)], axis=2),
            np.concatenate([np.zeros_like(own.at_target_mm), of_ct.at_target_mm], axis=1),
        )

    def place_errors(
        self, target_mm: Sequence[float], rotation: Array, spheres: int
    ) -> tuple[SharedErrors, ...]:
        """Return the error of the scan's place in the CT, which carries all spheres along."""
        pose = estimate_of(self)
        sizes = np.linalg.cholesky(pose.covariance)
        there_mm = rotation @ pose_jacobian(np.array(target_mm), pose.middle_mm) @ sizes
        return (SharedErrors(SCAN_PLACE, np.zeros((spheres, *there_mm.shape)), there_mm),)


class ExcludedSkin(Values):
    """Part of the boundary in the CT that is no skin to register on."""

    reason: str = Field(description="Why.")
    share: float = Field(description="Of the whole boundary.")
    middle_mm: Numbers3 = Field(description="Middle of these places, LPS.")


class SkinInCt(LocalizedFiducials, kind="skin_in_ct"):
    """The skin in the CT of a head without markers, or with few."""

    samples: int = Field(description="Places on the skin that the scan may be registered to.")
    excluded: tuple[ExcludedSkin, ...] = Field(description="Parts that it may not.")
    cranium: HeadEllipsoid = Field(description="Ellipsoid around the cranium.")
    face: HeadEllipsoid = Field(description="Ellipsoid around what is below it.")

    def head_in(self, volume: Volume) -> HeadEllipsoid:
        return self.cranium

    def bodies_on_head(self, fiducials: FiducialKind) -> tuple[Obstacle, ...]:
        return face_bodies(self.face)


def estimate_of(result: IntraoperativeSpheres) -> PoseEstimate:
    """Return the place of the scan in the CT, as recorded."""
    errors = np.hstack([result.place_turns_rad, result.place_shifts_mm])
    return PoseEstimate(result.ct_from_scan.rigid, np.array(result.place_middle_mm), errors.T @ errors)


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
        summary=format_count(len(found.markers), "sphere")
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
