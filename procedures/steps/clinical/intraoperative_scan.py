"""Scan during the operation: places of the spheres on the clamped head, in the planning CT's coordinates.

Its spheres stand in for those of the CT in all later steps, so what was refitted or has moved since the CT
no longer counts; the plan stays in the CT. What counts instead is the error of the scan's place in the CT.
A sphere keeps its number in the CT; one that is new since then has a number after those.
"""

from __future__ import annotations

from itertools import count
from math import dist
from pathlib import Path

import numpy as np

from procedures.engine.case import Case
from procedures.engine.context import StepContext
from procedures.engine.methods import NOT_CLINICAL
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.fusion.record import FusedPose
from procedures.imaging.dicom.scan_moment import ScanMoment, read_moments, read_stated_date
from procedures.imaging.dicom.slice_headers import hash_series, list_dicom_files, read_scan_identity
from procedures.imaging.errors import MarkerCountWrong
from procedures.imaging.localizers import LOCALIZERS
from procedures.imaging.markers import CUT_BY_FIELD, Localization, Marker
from procedures.imaging.pictures import draw_markers
from procedures.imaging.scan_deformation import require_undeformed
from procedures.imaging.series import read_series
from procedures.imaging.volume import AIR_HU, OUTSIDE_FIELD_HU, Volume
from procedures.intraoperative.bone_pose import BonePose, register_bone
from procedures.intraoperative.errors import NOT_LATER, OTHER_PATIENT, SCAN_MISSING, TooFewWhole
from procedures.intraoperative.placement import (
    SAME_SPHERE_MM,
    PlacedScan,
    ScannedSpheres,
    are_unmoved,
    place_scan,
    require_certain,
)
from procedures.operator.question import Question, Task, Topic
from procedures.registration.points import FEWEST_PAIRS
from procedures.steps.clinical.ct_import import ImportedCt, volume_of
from procedures.steps.clinical.fiducial_localization import (
    IntraoperativeSpheres,
    LocalizedFiducials,
    ScannedSphere,
    UnusedSphere,
)
from procedures.steps.clinical.head_clamp import ClampedHead
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.conditions import needs_arm_home
from ronna_hw.text import format_count
from ronna_hw.vectors import vector3
from ronna_hw.wire.room_tasks import SCAN

CUT = "is cut off by the field of view"  # as the localizer says of a sphere that it refuses for that
READING, LOCALIZING, PLACING = 0.2, 0.4, 0.5  # shares of the work done before


def run(context: StepContext) -> Outcome[IntraoperativeSpheres]:
    """Have the head scanned, localize the spheres in the scan and place it in the CT by bone and spheres.

    Raises CBCT-001 to CBCT-007, CT-016, CT-024, PRO-002.
    """
    context.result(ClampedHead)
    context.result(ImportedCt)
    plan, before = context.result(CheckedPlan), context.result(LocalizedFiducials)
    context.workcell.rest()
    series = context.clinical.scan_series
    was_there = series.is_dir()
    context.perform_task(
        Task(SCAN, f"scan the clamped head with its spheres, and put the series into {series.absolute()}")
    )
    context.require_yes(
        Question(
            Topic.SCANNED,
            "Was this scan made of the head as it is clamped now?",
            f"{describe_scan(series)} in {series.absolute()}"
            + ("; it was there before this step began" if was_there else ""),
        )
    )
    require_scan_of_operation(context.clinical.series, series)
    files_sha256 = hash_series(series)
    volume = read_series(
        series, progress=lambda share: context.progress(READING * share, "reading the scan of the operation")
    )
    if volume.series_instance_uid == before.series_instance_uid:
        raise NOT_LATER("the scan is the planning CT itself", got=volume.series_instance_uid)
    context.note_inputs(*list_dicom_files(series))
    described = LOCALIZERS[before.localizer]
    found = localize_whole(context, volume)
    require_undeformed(found.deformation)
    bone = register_bone(
        volume_of(context),
        volume,
        lambda share: context.progress(
            PLACING + (1.0 - PLACING) * share, "comparing the bone of scan and CT"
        ),
    )
    stated_mm = context.setting.settings.seating_error_mm
    placed = place_scan(bone.pose, _scanned(found.markers), _scanned(before.markers), stated_mm)
    if are_unmoved(placed, stated_mm):
        farthest_mm = max(pair.moved_mm for pair in placed.pairs)
        context.require_yes(
            Question(
                Topic.SCANNED,
                "All spheres sit as in the planning CT: is this surely another scan, of the clamped head?",
                f"within {farthest_mm:.3f} mm, less than refitted spheres do ({stated_mm:g} mm per axis)",
            )
        )
    targets_mm = np.array([one.target_mm for one in plan.plan.trajectories])
    require_certain(placed.pose, targets_mm)
    numbers = number_spheres(placed, len(found.markers), len(before.markers))
    for number, picture in zip(numbers, draw_markers(volume, found, numbers), strict=True):
        context.keep_picture(f"scan-{number}.png", picture)
    context.setting.memory.drop(Volume)
    unused = find_unused(before, volume, found, placed)
    result = _record(before, found, files_sha256, bone, placed, plan, unused)
    moved = [one for one in result.spheres if not one.agrees and one.moved_mm is not None]
    for one in moved:
        context.find(f"sphere {one.fiducial + 1} has moved by {one.moved_mm:.2f} mm since the CT")
    for gone in result.unused:
        context.find(f"sphere {gone.fiducial + 1} is not used: in the scan it {gone.reason}")
    for new in (one.fiducial + 1 for one in result.spheres if one.moved_mm is None):
        context.find(f"sphere {new} is new since the CT, which has {len(before.markers)}")
    cut = sum(one.is_cut for one in result.spheres)
    return Outcome(
        result,
        summary=f"{format_count(len(result.spheres), 'sphere')}, {placed.agreeing} where the CT has them"
        + (f"; moved since the CT: {len(moved)}" if moved else "")
        + (f"; at the end of the field: {cut}" if cut else "")
        + "".join(f"; sphere {one.fiducial + 1} {one.reason}" for one in result.unused)
        + f"; expected error of its place in the CT {max(result.expected_mm.values()):.2f} mm rms"
        + ("" if described.is_clinical else f"; by {before.localizer}: {NOT_CLINICAL}"),
    )


def describe_scan(series: Path) -> str:
    """Return how many files a scan has, and its date and time, for the question; never the patient."""
    files = list_dicom_files(series) if series.is_dir() else []
    if not files:
        return "no scan yet"
    moments = read_moments(series)
    made = f"of {moments[0].describe()}" if moments else "without a date"
    return f"{format_count(len(files), 'file')} {made}"


def used_spheres(case: Case) -> LocalizedFiducials:
    """Return the spheres that count in a case: of the scan during the operation, else of the CT."""
    scanned = case.find(IntraoperativeSpheres, None)
    return case.get(LocalizedFiducials).result if scanned is None else scanned.result


def require_scan_of_operation(ct: Path, scan: Path) -> None:
    """Raise CBCT-001 without a scan, CBCT-002 unless it is of this patient, CBCT-003 unless it is later.

    Neither a scan in the CT's frame of reference nor one without a date is known to be later.
    """
    if not scan.is_dir():
        raise SCAN_MISSING(f"there is no scan in {scan}")
    before, now = read_scan_identity(ct), read_scan_identity(scan)
    if before.patient.identifier != now.patient.identifier:  # messages never name patients
        raise OTHER_PATIENT("the scan and the planning CT have different patient identifiers")
    if not now.patient.identifier:
        raise OTHER_PATIENT("neither the scan nor the planning CT has a patient identifier")
    if before.frame_of_reference_uid == now.frame_of_reference_uid:
        raise NOT_LATER(
            "the scan is in the frame of reference of the planning CT, as that reconstructed again would be",
            expected="another FrameOfReferenceUID",
            got=now.frame_of_reference_uid or "none in both",
        )
    of_scan, of_ct = _earliest(scan, "scan"), _earliest(ct, "planning CT")
    if of_scan.is_before(of_ct):
        raise NOT_LATER(
            "the scan is older than the planning CT",
            expected=f"later than {of_ct.describe()}",
            got=of_scan.describe(),
        )


def _earliest(series: Path, what: str) -> ScanMoment:
    """Return when the first slice of a scan was acquired. Raises CBCT-003 without a date."""
    if moments := read_moments(series):
        return moments[0]
    stated = read_stated_date(series)
    raise NOT_LATER(
        f"the {what} has no readable date, so the scan is not known to be the later one",
        expected="such as 20180602",
        got=repr(stated) if stated else "none",
    )


def localize_whole(context: StepContext, volume: Volume) -> Localization:
    """Localize the spheres of the scan. Raises CBCT-007 for too few, naming those that the field cuts."""
    localize = LOCALIZERS[context.clinical.methods.localizer].load()

    def show(share: float) -> None:
        context.progress(LOCALIZING + (PLACING - LOCALIZING) * share, "localizing the spheres of the scan")

    try:
        found = localize(volume, progress=show)
        markers, candidates = found.markers, found.candidates
    except MarkerCountWrong as none:
        markers, candidates, found = (), none.candidates, None
    if found is not None and len(markers) >= FEWEST_PAIRS:
        return found
    cut = [one.describe() for one in candidates if CUT in one.reason]
    raise TooFewWhole(
        "the scan shows too few whole spheres" + (f"; perhaps others: {', '.join(cut)}" if cut else ""),
        limit=f"at least {FEWEST_PAIRS}",
        got=str(len(markers)),
    )


def find_unused(
    before: LocalizedFiducials, volume: Volume, found: Localization, placed: PlacedScan
) -> tuple[UnusedSphere, ...]:
    """List the spheres of the CT that no sphere of the scan is paired with, and what the scan shows there."""
    paired = {pair.ct for pair in placed.pairs}
    scan_from_ct = placed.pose.ct_from_scan.inv()
    unused = []
    for index, place_ct_mm in enumerate(before.centres_mm):
        if index in paired:
            continue
        place_mm = scan_from_ct.apply(place_ct_mm)
        near = [one for one in found.candidates if dist(one.centre_mm, place_mm) < SAME_SPHERE_MM]
        if near:
            reason = near[0].reason
        elif volume.sample(place_mm[None], AIR_HU + OUTSIDE_FIELD_HU)[0] < OUTSIDE_FIELD_HU:
            reason = "is outside the field of view"
        else:
            reason = "is not there"
        unused.append(UnusedSphere(fiducial=index, reason=reason))
    return tuple(unused)


def number_spheres(placed: PlacedScan, shown: int, in_ct: int) -> tuple[int, ...]:
    """Return the numbers, from 1, of as many spheres as a scan shows: as in the CT, new ones after those."""
    of_ct = {pair.scan: pair.ct + 1 for pair in placed.pairs}
    new = count(in_ct + 1)
    return tuple(of_ct[one] if one in of_ct else next(new) for one in range(shown))


def _scanned(markers: tuple[Marker, ...]) -> ScannedSpheres:
    return ScannedSpheres(
        np.array([one.centre_mm for one in markers]), np.array([one.covariance_mm2 for one in markers])
    )


def _record(
    before: LocalizedFiducials,
    found: Localization,
    files_sha256: str,
    bone: BonePose,
    placed: PlacedScan,
    plan: CheckedPlan,
    unused: tuple[UnusedSphere, ...],
) -> IntraoperativeSpheres:
    """Return the spheres in the coordinates of the CT: those of the CT at their indices, then new ones."""
    pose, pairs = placed.pose, {pair.scan: pair for pair in placed.pairs}
    numbers = number_spheres(placed, len(found.markers), len(before.markers))
    rotation = pose.ct_from_scan.rotation.as_matrix()
    markers, spheres = dict(enumerate(before.markers)), []
    for number, index in sorted(zip(numbers, range(len(numbers)), strict=True)):
        marker, pair = found.markers[index], pairs.get(index)
        covariance = rotation @ np.array(marker.covariance_mm2) @ rotation.T
        markers[number - 1] = marker.model_copy(
            update={
                "centre_mm": vector3(pose.ct_from_scan.apply(np.array(marker.centre_mm))),
                "covariance_mm2": tuple(map(vector3, covariance)),
            }
        )
        spheres.append(
            ScannedSphere(
                fiducial=number - 1,
                in_scan_mm=marker.centre_mm,
                sigma_mm=marker.sigma_mm,
                is_cut=CUT_BY_FIELD in marker.flags,
                moved_mm=None if pair is None else pair.moved_mm,
                agrees=pair is not None and pair.agrees,
            )
        )
    targets_mm = np.array([one.target_mm for one in plan.plan.trajectories])
    errors = np.linalg.cholesky(placed.stated_pose.covariance).T
    expected_mm = np.sqrt(np.trace(placed.stated_pose.covariances_mm2(targets_mm), axis1=1, axis2=2))
    return IntraoperativeSpheres(
        series_instance_uid=found.series_instance_uid,
        diameter_mm=found.diameter_mm,
        markers=tuple(markers.values()),
        doubtful=(),
        deformation=found.deformation,
        ct_deformation=before.deformation,
        localizer=before.localizer,
        ct_from_scan=FusedPose.of(pose.ct_from_scan),
        files_sha256=files_sha256,
        place_middle_mm=vector3(pose.middle_mm),
        place_turns_rad=tuple(map(vector3, errors[:, :3])),
        place_shifts_mm=tuple(map(vector3, errors[:, 3:])),
        bone_agreement=bone.agreement,
        agreeing_starts=bone.agreeing_starts,
        starts=bone.starts,
        spheres=tuple(spheres),
        unused=unused,
        expected_mm={
            one.id: float(error_mm) for one, error_mm in zip(plan.plan.trajectories, expected_mm, strict=True)
        },
    )


STEP = StepSpec(
    IntraoperativeSpheres,
    "Scan the clamped head",
    Phase.PREPARATION,
    run,
    asks=(Topic.SCANNED,),
    reads=(ImportedCt, LocalizedFiducials, CheckedPlan, ClampedHead),
    preconditions=needs_arm_home,
)
