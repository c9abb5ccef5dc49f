"""Registration by the skin, carried to where the clamp has moved, and corrected by a few looks.

The tracker sees how far the frame on the clamp has moved, and the head with it unless it slipped. A few looks
at skin that was scanned before tell how far the head is from there: what the CT lacks of the skin is the same
in both scans and cancels, so they need not cover the head. If they contradict, all of it is scanned again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome
from procedures.journal.results import FramedPose
from procedures.operator.question import Question, Topic
from procedures.registration.surface.compare_scans import compare_scans
from procedures.registration.surface.errors import CARRIED_DIFFERS, SCANS_APART
from procedures.registration.surface.prediction import SurfacePrediction
from procedures.registration.surface.scan import SurfaceScan
from procedures.registration.surface.surface import Surface
from procedures.steps.clinical.correspondence import MeasuredHead, SurfaceStart
from procedures.steps.clinical.fiducial_localization import SkinInCt
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.registration import against_margins, exclude_beyond_margin
from procedures.steps.clinical.results import ErrorShare, Prediction, RegisteredBySurface, ScannedSurface
from procedures.steps.clinical.surface.skin_in_ct import skin_of
from ronna_hw.arrays import Array
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Transform
from ronna_hw.text import format_count

# Of the former registration: the arm errs alike at its looks and at a target only if neither went far.
# Safety against a carried registration whose predicted error no longer holds (U).
MOST_CARRIED_MM, MOST_CARRIED_RAD = 30.0, math.radians(10.0)
# Of a target, from where the clamp has carried it.
# Safety against a head that slips in its clamp (U).
MOST_SLIPPED_MM = 2.0
# Of that movement at 95 %.
# Safety against looks that do not say where the head is (U).
LARGEST_LIMIT_MM = 1.0
TURN_SD_RAD, PLACE_SD_MM = math.radians(0.5), 1.0  # of a frame on the clamp, at the head (U)
LOOK_MM = 0.1  # per axis, of a look by a calibrated arm (U)
CARRYING = "head carried by its clamp"  # source of error

BESIDE_SPHERES = (
    "beside spheres the clamp carries no registration, since a few looks at the skin do not confirm where "
    "the spheres are"
)


@dataclass(frozen=True, eq=False)
class CarriedHead:
    """Former registration by a whole scan, both at the place to which the clamp's frame has moved."""

    name: str  # of its record
    former: RegisteredBySurface
    scan: SurfaceScan
    robot_from_ct: Transform
    way_mm: float


def find_carried(context: StepContext) -> CarriedHead | None:
    """Return the last registration by a whole scan if the clamp's frame can carry it, else None.

    It cannot for a head with spheres, after a large move, and once a few looks have contradicted it.
    """
    judged = _judge_former(context)
    return judged if isinstance(judged, CarriedHead) else None


def tell_whole_scan(context: StepContext) -> None:
    """Record as a finding why a head that was registered before is scanned as a whole again."""
    reason = _judge_former(context)
    if isinstance(reason, str) and reason:
        context.find(f"the whole skin is scanned again, and not a few places: {reason}")


def _judge_former(context: StepContext) -> CarriedHead | str:
    """Return the carried registration, or why there is none; '' without a former one."""
    now, skin = context.result(GlobalLocalization), context.result(SkinInCt)
    registered = context.former(RegisteredBySurface)
    whole = [one for one in registered if not one.result.carried]
    if not whole:
        return ""
    if skin.markers:
        return BESIDE_SPHERES
    last = whole[-1]
    carried = [one.record for one in registered if one.result.carried]
    for start in context.former(SurfaceStart):
        is_confirmed = any(start.record.identifier in one.parents for one in carried)
        if start.result.carried == last.record.identifier and not is_confirmed:
            return "a few looks contradicted what the clamp had carried"
    then = context.former_ancestor(last.record, GlobalLocalization).result
    same_ct = context.former_ancestor(last.record, SkinInCt).record.identifier == context.identifier(SkinInCt)
    if not same_ct:
        return "the skin has been read from the CT anew since the last registration"
    if then.tracker_from_patient is None or now.tracker_from_patient is None:
        return "the tracker did not see the frame on the clamp both then and now"
    motion = _frame_of(now) @ _frame_of(then).inverse()
    pose = last.result.robot_from_ct.transform
    middle_mm = np.asarray(pose.apply(skin_of(context).points_mm)).mean(axis=0)
    way_mm = float(np.linalg.norm(motion.apply(middle_mm) - middle_mm))
    turn_rad = motion.rigid.rotation.magnitude()
    if way_mm > MOST_CARRIED_MM or turn_rad > MOST_CARRIED_RAD:
        return (
            f"the clamp has moved by {way_mm:.0f} mm and {math.degrees(turn_rad):.0f} deg, and carries a "
            f"registration by at most {MOST_CARRIED_MM:g} mm and {math.degrees(MOST_CARRIED_RAD):.0f} deg"
        )
    scanned = context.former_ancestor(last.record, ScannedSurface).result
    return CarriedHead(
        last.record.identifier, last.result, scanned.scan.placed(motion), motion @ pose, way_mm
    )


def _frame_of(localized: GlobalLocalization) -> Transform:
    """Return the pose robot <- frame on the clamp, which was seen."""
    assert localized.tracker_from_patient is not None
    return localized.robot_from_tracker.transform @ localized.tracker_from_patient.transform


def start_carried(carried: CarriedHead) -> Outcome[SurfaceStart]:
    """Return a carried registration as the start of the next one: no landmark is touched."""
    return Outcome(
        SurfaceStart.without_spheres(
            carried.robot_from_ct,
            turn_sd_rad=TURN_SD_RAD,
            place_sd_mm=PLACE_SD_MM,
            carried=carried.name,
        ),
        summary=f"the clamp has moved by {carried.way_mm:.1f} mm, and carries the registration with it",
    )


def register_carried(context: StepContext) -> Outcome[RegisteredBySurface]:
    """Correct the carried registration by a few looks, and have it accepted.

    Raises SRF-035 and voids the start if they contradict it, PRO-002, PRO-007.
    """
    plan, scanned = context.result(CheckedPlan), context.result(ScannedSurface)
    try:
        carried = find_carried(context)
        if carried is None:
            raise CARRIED_DIFFERS("the registration that the clamp has carried is not to be found")
        former = {one.target: one for one in carried.former.predictions}
        names = context.served_trajectories
        if missing := [name for name in names if name not in former]:
            raise CARRIED_DIFFERS(f"the former registration predicts no error for {' and '.join(missing)}")
        targets_mm = np.array([plan.trajectory(name).target_mm for name in names])
        pose, errors = correct_carried(carried, scanned.scan, skin_of(context), targets_mm)
    except RonnaError as contradiction:
        context.void(MeasuredHead if context.stands(MeasuredHead) else SurfaceStart, contradiction)
        raise
    predictions = tuple(_widen(former[name], one) for name, one in zip(names, errors, strict=True))
    left_out = exclude_beyond_margin(context, plan, predictions)
    for predicted in (one for one in predictions if one.target not in left_out):
        against = against_margins(plan, predictions, predicted)
        context.require_yes(
            Question(
                Topic.REGISTRATION,
                f"Accept the registration on the skin for {predicted.target}, as carried by the clamp?",
                f"predicted target error {predicted.rms_mm:.2f} mm rms against a margin of "
                f"{against[0].margin_mm:g} mm, {predicted.limit_mm:.2f} mm at {predicted.confidence:.0%}"
                f"{against[0].remark}\nconfirmed by "
                f"{format_count(len(scanned.looks_taken), 'look')} at skin that was scanned before"
                f"\nnot included: {predicted.excluded}",
                trajectory=predicted.target,
                predicted=against,
            )
        )
    fields = {
        "robot_from_ct": FramedPose.of(pose),
        "predictions": predictions,
        "left_out": left_out,
        "carried": True,
        "confirming_looks": len(scanned.looks_taken),
    }
    worst = max(predictions, key=lambda one: one.rms_mm)
    return Outcome(
        carried.former.model_copy(update=fields),
        summary=f"carried by the clamp, predicted target error {worst.rms_mm:.2f} mm rms",
    )


def correct_carried(
    carried: CarriedHead, seen: SurfaceScan, skin: Surface, targets_mm: Array
) -> tuple[Transform, Sequence[SurfacePrediction]]:
    """Return the pose robot <- CT corrected by a scan of a few looks, and what it adds at targets (m, 3).

    Raises SRF-035 if the scan contradicts the carried pose, or does not say enough.
    """
    try:
        found = compare_scans(carried.scan, seen, skin, carried.robot_from_ct, LOOK_MM)
    except RonnaError as problem:
        if problem.code != SCANS_APART.code:
            raise
        raise CARRIED_DIFFERS(problem.summary) from problem
    if found.changed is not None:
        moved = f"{found.changed.shift_mm:+.1f} mm at {', '.join(found.changed.parts)}"
        raise CARRIED_DIFFERS("the skin has moved on the head", got=moved)
    movements = [found.movement_at(target) for target in targets_mm]
    slipped_mm = max(float(np.linalg.norm(way)) for way, _ in movements)
    if slipped_mm > MOST_SLIPPED_MM:
        raise CARRIED_DIFFERS(
            "the head is not where its clamp has carried it",
            limit=f"{MOST_SLIPPED_MM:g} mm at a target",
            got=f"{slipped_mm:.2f} mm",
        )
    unsure_mm = max(error.limit_mm() for _, error in movements)
    if unsure_mm > LARGEST_LIMIT_MM:
        raise CARRIED_DIFFERS(
            "few looks do not say well enough where the head is",
            limit=f"{LARGEST_LIMIT_MM:g} mm with 95 %",
            got=f"{unsure_mm:.2f} mm",
        )
    return found.moved_robot_from_ct, [error for _, error in movements]


def _widen(former: Prediction, carrying: SurfacePrediction) -> Prediction:
    """Return a former prediction with the error of carrying it."""
    return former.model_copy(
        update={
            "rms_mm": math.hypot(former.rms_mm, carrying.rms_mm),
            "limit_mm": math.hypot(former.limit_mm, carrying.limit_mm(former.confidence)),
            "budget": (*former.budget, ErrorShare(source=CARRYING, rms_mm=carrying.rms_mm)),
        }
    )
