"""Registration on the scanned skin, with a predicted error for every target.

The prediction is the mixture over all misfits of the skin that the scan allows, with the arm's errors at
looks and target; see `procedures.registration.surface`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, Scope, StepSpec
from procedures.journal.errors import GateFailed
from procedures.journal.results import FramedPose
from procedures.operator.question import Question, Topic
from procedures.planning.guide import direction_covariance_mm2, instrument_covariance_mm2
from procedures.planning.plan_model import PlannedTrajectory
from procedures.registration.error_sources import DIRECTION, FUSION, GUIDE_TIP, INSTRUMENT, STEREO_HEAD
from procedures.registration.error_theory import DEFAULT_CONFIDENCE
from procedures.registration.surface.surface_registration import SurfaceRegistration, register_surface
from procedures.registration.target_prediction import SharedErrors
from procedures.registration.verification import verify_two_way
from procedures.steps.clinical import error_budget
from procedures.steps.clinical.correspondence import SurfaceStart
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import SkinInCt
from procedures.steps.clinical.path_check import CheckedPaths, LocalizationPose
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.registration import against_margins, exclude_beyond_margin, picture_of
from procedures.steps.clinical.results import (
    NOT_PREDICTED,
    ErrorShare,
    Prediction,
    RegisteredBySurface,
    ScannedSurface,
    SkinRegion,
)
from procedures.steps.clinical.room import ROOM_READS
from procedures.steps.clinical.surface.skin_in_ct import bone_of, skin_of
from procedures.steps.clinical.unnoticed import expect_unnoticed
from procedures.workcell import MountedTool
from ronna_hw.arrays import Array

SKIN = "skin and its misfit, scan and arm"  # source of error: they are adjusted together
SLIPPING = "a head that slips in its clamp, of which the tracker sees the frame alone"
LEFT_AND_RIGHT = (
    "The scan cannot tell the skin of this head from its mirror image. Compare a sign on one side of the "
    "head, such as a scar or the site of the lesion, with the CT."
)


def run(context: StepContext) -> Outcome[RegisteredBySurface]:
    """Register the scan to the skin in the CT, and have the predicted error accepted.

    Raises SRF-001 to SRF-010, PRO-002, PRO-007.
    """
    if context.workcell.master.tool is MountedTool.GUIDE:
        raise GateFailed(
            "the head has moved since the skin was scanned, and the guide is mounted",
            expected="the stereo head",
            action="Localize with the tracker again: the stereo head is mounted, and the skin scanned again.",
        )
    for before in (ImportedCt, SkinInCt):
        context.result(before)
    plan, scanned = context.result(CheckedPlan), context.result(ScannedSurface)
    found = _register(context, scanned)
    planned = [plan.trajectory(name) for name in context.served_trajectories]
    predictions = tuple(_predict(context, scanned, found, one) for one in planned)
    left_out = exclude_beyond_margin(context, plan, predictions)
    side_proven = found.side_proven or context.result(SurfaceStart).site is not None
    _accept(context, plan, found, predictions, left_out, side_proven=side_proven)
    kept = found.residuals_mm[~found.excluded]
    worst = max(predictions, key=lambda one: one.rms_mm)
    changed = tuple(map(SkinRegion.of, found.changed))
    return Outcome(
        RegisteredBySurface(
            robot_from_ct=FramedPose.of(found.robot_from_ct),
            pairs=0,
            fre_mm=float(np.sqrt(np.mean(kept**2))),
            residuals_mm=(),
            leave_one_out_mm=(),
            predictions=predictions,
            two_way=verify_two_way(np.empty((0, 3)), np.empty((0, 3)), (), found.robot_from_ct),
            left_out=left_out,
            points=len(found.points_mm),
            excluded=float(np.mean(found.excluded)),
            coverage=found.coverage,
            misfit_mm=found.misfit_mm,
            misfit_length_mm=found.misfit_length_mm,
            side_proven=side_proven,
            changed=changed,
            doubted=tuple(map(SkinRegion.of, found.doubted)),
        ),
        summary=f"predicted target error {worst.rms_mm:.2f} mm rms; the skin differs by "
        f"{found.misfit_mm:.2f} mm"
        + "".join(f"; the skin moved {one.shift_mm:.1f} mm at {', '.join(one.parts)}" for one in changed)
        + "".join(f"; without {name}" for name in left_out),
    )


def _register(context: StepContext, scanned: ScannedSurface) -> SurfaceRegistration:
    looks, places_mm = _looks_of(context, scanned)
    targets = [context.result(CheckedPlan).trajectory(name).target_mm for name in context.served_trajectories]
    return register_surface(
        scanned.scan,
        skin_of(context),
        context.result(SurfaceStart).start,
        targets_ct_mm=np.array(targets),
        arm=(*error_budget.errors_at_looks(context, looks, places_mm), _head_errors(context, looks)),
        find_bone=lambda: bone_of(context),
    )


def _looks_of(context: StepContext, scanned: ScannedSurface) -> tuple[list[LocalizationPose], Array]:
    """Return the planned looks that showed the skin, and the places of their tool centre, robot frame."""
    planned = context.result(CheckedPaths).localizations_for(context.key.trajectory)
    looks = [planned[number] for number in scanned.looks_taken]
    return looks, np.array([one.tool_pose.transform.translation_mm for one in looks])


def _head_errors(context: StepContext, looks: list[LocalizationPose]) -> SharedErrors:
    """Return the errors of the stereo head's calibration: it measures alike in each look, turned with it."""
    size_mm = context.workcell.calibrations.stereo_head.stated_error_mm / np.sqrt(3.0)
    turns = np.array([one.tool_pose.transform.rotation_matrix for one in looks])
    return SharedErrors(STEREO_HEAD, size_mm * turns, np.zeros((3, 3)))


def _predict(
    context: StepContext, scanned: ScannedSurface, found: SurfaceRegistration, planned: PlannedTrajectory
) -> Prediction:
    """Predict the tip's error at a target: of the registration with the arm, and what is added there."""
    looks, places_mm = _looks_of(context, scanned)
    held = error_budget.predict_held_guide(context, planned, found.robot_from_ct, None)
    arm = (
        *error_budget.arm_errors(context, looks, places_mm, planned.id, held),
        _head_errors(context, looks),
    )
    by_surface = found.predict(planned.target_mm, arm)
    plan, bore = context.result(CheckedPlan).plan, context.workcell.tools.guide.bore
    tip = context.workcell.calibrations.tool_tip
    added_mm2 = {
        INSTRUMENT: instrument_covariance_mm2(plan, planned, bore, held.rotation),
        DIRECTION: direction_covariance_mm2(
            plan, planned, bore, tip.stated_direction_error_rad, held.rotation
        ),
        GUIDE_TIP: np.eye(3) * tip.stated_error_mm**2 / 3.0,
        **expect_unnoticed(context, held.tip_mm, held.joints_rad, held.sides),
    }
    if planned.fusion_error_mm is not None:
        added_mm2[FUSION] = np.eye(3) * planned.fusion_error_mm**2 / 3.0
    total = replace(by_surface, covariances_mm2=by_surface.covariances_mm2 + sum(added_mm2.values()))
    shares = {SKIN: by_surface.rms_mm} | {
        name: float(np.sqrt(np.trace(one))) for name, one in added_mm2.items()
    }
    return Prediction(
        target=planned.id,
        rms_mm=total.rms_mm,
        limit_mm=total.limit_mm(DEFAULT_CONFIDENCE),
        confidence=DEFAULT_CONFIDENCE,
        formula="mixture over the misfits of the skin",
        excluded=f"{NOT_PREDICTED}; {SLIPPING}",
        budget=tuple(ErrorShare(source=name, rms_mm=rms) for name, rms in shares.items()),
    )


def _accept(
    context: StepContext,
    plan: CheckedPlan,
    found: SurfaceRegistration,
    predictions: tuple[Prediction, ...],
    left_out: Mapping[str, str],
    *,
    side_proven: bool,
) -> None:
    """Have the operator accept the registration for each target. Raises PRO-002."""
    if not side_proven:
        context.find(LEFT_AND_RIGHT)
        context.require_yes(
            Question(
                Topic.REGISTRATION,
                "Have you compared left and right of the patient with the CT?",
                LEFT_AND_RIGHT,
                trajectory=predictions[0].target,
            )
        )
    for predicted in predictions:
        if predicted.target in left_out:
            continue
        against = against_margins(plan, predictions, predicted)
        context.require_yes(
            Question(
                Topic.REGISTRATION,
                f"Accept the registration on the skin for {predicted.target}?",
                f"predicted target error {predicted.rms_mm:.2f} mm rms against a margin of "
                f"{against[0].margin_mm:g} mm, {predicted.limit_mm:.2f} mm at {predicted.confidence:.0%}"
                f"{against[0].caution}\nthe skin differs from the CT by {found.misfit_mm:.2f} mm over "
                f"{found.misfit_length_mm:.0f} mm; {found.coverage:.0%} of it was scanned"
                f"\nnot included: {predicted.excluded}",
                trajectory=predicted.target,
                evidence=(error_budget.budget_table(predicted),),
                predicted=against,
                pictures=picture_of(context, predicted.target),
            )
        )


STEP = StepSpec(
    RegisteredBySurface,
    "Register the CT to the robot by the skin",
    Phase.OPERATION,
    run,
    asks=(Topic.REGISTRATION,),
    scope=Scope.LOCALIZATION,
    reads=(ImportedCt, SkinInCt, ScannedSurface, SurfaceStart, *ROOM_READS, CheckedPaths),
    preconditions=lambda context: context.workcell.master.place.hold_reasons,
)
