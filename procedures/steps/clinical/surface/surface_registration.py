"""Registration on the scanned skin, and on spheres if there are any, with a predicted error for every target.

The prediction is the mixture over all misfits of the skin that the scan allows, with the arm's errors at
looks and target; see `procedures.registration.surface`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, Scope, StepSpec
from procedures.guards.stability import tell_unseen_slip
from procedures.journal.errors import GateFailed
from procedures.journal.results import FramedPose
from procedures.operator.question import Evidence, Picture, Question, Topic
from procedures.planning.guide import direction_covariance_mm2, instrument_covariance_mm2
from procedures.planning.plan_model import PlannedTrajectory
from procedures.registration.error_sources import DIRECTION, FUSION, GUIDE_TIP, INSTRUMENT, STEREO_HEAD
from procedures.registration.error_theory import DEFAULT_CONFIDENCE
from procedures.registration.surface.errors import (
    FAR_FROM_START,
    HEAD_MOVED,
    LITTLE_COVERAGE,
    MUCH_EXCLUDED,
    OTHER_HEAD,
    POORLY_DETERMINED,
    SKIN_CHANGED,
    SPHERE_MOVED,
    TWO_POSES,
)
from procedures.registration.surface.shared_errors import Sources
from procedures.registration.surface.spheres import LookedSpheres
from procedures.registration.surface.surface_registration import SurfaceRegistration, register_surface
from procedures.registration.target_prediction import SharedErrors
from procedures.registration.verification import verify_two_way
from procedures.steps.clinical import error_budget
from procedures.steps.clinical.correspondence import MeasuredHead, SurfaceStart
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import SkinInCt
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.path_check import CheckedPaths, LocalizationPose
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.registration import (
    against_margins,
    exclude_beyond_margin,
    picture_of,
    require_explained,
    tell_learned,
)
from procedures.steps.clinical.results import (
    NOT_PREDICTED_OF_TOOL,
    ErrorShare,
    LearnedArm,
    Prediction,
    RegisteredBySurface,
    ScannedSurface,
    SkinRegion,
)
from procedures.steps.clinical.room import ROOM_READS
from procedures.steps.clinical.sphere_pairs import LookedPairs
from procedures.steps.clinical.surface.carried_head import register_carried
from procedures.steps.clinical.surface.repeated_work import Repeat, repeat_if_refused
from procedures.steps.clinical.surface.skin_in_ct import bone_of, skin_of
from procedures.steps.clinical.surface.skin_pictures import RESIDUALS_PICTURE, draw_residuals, tell_coverage
from procedures.steps.clinical.unnoticed import expect_unnoticed
from procedures.workcell import MountedTool
from ronna_hw.arrays import Array
from ronna_hw.text import format_count
from ronna_hw.vectors import Vector3, vector3

SIDES_COMPARED = "Have you compared left and right of the patient with the CT?"
LEFT_AND_RIGHT = (
    "The scan cannot tell the skin of this head from its mirror image. Compare a sign on one side of the "
    "head, such as a scar or the site of the lesion, with the CT."
)
GO_ON = "resume the run, or go on with the next step, and"
SCAN_AGAIN = Repeat(
    ScannedSurface,
    f"The scan is void: {GO_ON} the skin is scanned again.",
    (LITTLE_COVERAGE, POORLY_DETERMINED, OTHER_HEAD, HEAD_MOVED, SKIN_CHANGED, MUCH_EXCLUDED),
)
LOCALIZE_AGAIN = Repeat(
    GlobalLocalization,
    f"The localization is void: {GO_ON} the tracker localizes again, nose and ears are touched, and the skin "
    "is scanned again.",
    (SPHERE_MOVED,),
)


def run(context: StepContext) -> Outcome[RegisteredBySurface]:
    """Register the scan to the skin in the CT, and have the predicted error accepted.

    Raises SRF-001 to SRF-012, PRO-002, PRO-007; what has to be done again after a refusal is void then.
    """
    if context.workcell.master.tool is MountedTool.GUIDE:
        raise GateFailed(
            "the head has moved since the skin was scanned, and the guide is mounted",
            expected="the stereo head",
            action="Localize with the tracker again: the stereo head is mounted, and the skin scanned again.",
        )
    for before in (ImportedCt, SkinInCt):
        context.result(before)
    if context.result(SurfaceStart).carried:
        return register_carried(context)
    plan, scanned = context.result(CheckedPlan), context.result(ScannedSurface)
    looked = LookedPairs.of(context) if scanned.fiducials else None
    with repeat_if_refused(context, *repeats(context)):
        found = _register(context, scanned, looked)
    planned = [plan.trajectory(name) for name in context.served_trajectories]
    predictions = tuple(_predict(context, scanned, looked, found, one) for one in planned)
    left_out = exclude_beyond_margin(context, plan, predictions)
    side_proven = found.side_proven or context.result(SurfaceStart).site is not None
    picture = context.keep_picture(RESIDUALS_PICTURE, draw_residuals(skin_of(context), found))
    learned = _learn_arm(context, scanned, looked, found, planned)
    _accept(context, plan, found, predictions, left_out, learned, picture, side_proven=side_proven)
    kept = found.residuals_mm[~found.excluded]
    worst = max(predictions, key=lambda one: one.rms_mm)
    changed = () if found.changed is None else (SkinRegion.of(found.changed),)
    localized = context.result(SkinInCt)
    residuals_mm = {} if looked is None else _residuals_by_sphere(looked, found)
    return Outcome(
        RegisteredBySurface(
            robot_from_ct=FramedPose.of(found.robot_from_ct),
            pairs=len(found.spheres),
            fre_mm=float(np.sqrt(np.mean(kept**2))),
            residuals_mm=tuple(residuals_mm.values()),
            leave_one_out_mm=tuple(one.away_mm for one in found.spheres),
            predictions=predictions,
            two_way=verify_two_way(
                localized.centres_mm,
                context.result(GlobalLocalization).points_mm,
                context.result(SurfaceStart).pairs,
                found.robot_from_ct,
                ct_disagreement_mm=localized.disagreement_mm,
            ).beside_skin(
                {number: math.hypot(*left_mm) for number, left_mm in residuals_mm.items()},
                {one.number: one.away_mm for one in found.spheres},
            ),
            left_out=left_out,
            learned=learned,
            points=len(found.points_mm),
            excluded=float(np.mean(found.excluded)),
            coverage=found.coverage,
            misfit_mm=found.misfit_mm,
            misfit_length_mm=found.misfit_length_mm,
            side_proven=side_proven,
            changed=changed,
        ),
        summary=f"predicted target error {worst.rms_mm:.2f} mm rms; the skin differs by "
        f"{found.misfit_mm:.2f} mm"
        + "".join(
            f"; sphere {one.number + 1} {one.away_mm:.2f} mm from where the rest has it"
            for one in found.spheres
        )
        + "".join(f"; the skin moved {one.shift_mm:.1f} mm at {', '.join(one.parts)}" for one in changed)
        + "".join(f"; without {name}" for name in left_out),
    )


def repeats(context: StepContext) -> tuple[Repeat, ...]:
    """Return what each refusal of this registration voids: what its advice says is done again."""
    is_measured = context.stands(MeasuredHead)
    start_again = Repeat(
        MeasuredHead if is_measured else SurfaceStart,
        f"The start is void: {GO_ON} nose and ears are {'measured' if is_measured else 'touched'} and the "
        "skin is scanned again.",
        (TWO_POSES, FAR_FROM_START),
    )
    return SCAN_AGAIN, start_again, LOCALIZE_AGAIN


def _register(
    context: StepContext, scanned: ScannedSurface, looked: LookedPairs | None
) -> SurfaceRegistration:
    looks, places_mm = _looks_of(context, scanned, looked)
    targets = [context.result(CheckedPlan).trajectory(name).target_mm for name in context.served_trajectories]
    return register_surface(
        scanned.scan,
        skin_of(context),
        context.result(SurfaceStart).start,
        targets_ct_mm=np.array(targets),
        arm=(*error_budget.errors_at_looks(context, looks, places_mm), _head_errors(context, looks)),
        spheres=None if looked is None else _spheres_of(looked),
        find_bone=lambda: bone_of(context),
    )


def _spheres_of(looked: LookedPairs) -> LookedSpheres:
    """Return the looks at spheres with all of their errors but the arm's; several at one share the CT's."""
    numbers = np.array(looked.fiducials)
    at_sphere_mm2, at_look_mm2 = looked.ct_mm2 + looked.seating_mm2, looked.stereo_mm2 + looked.sides_mm2
    blocks = np.where((numbers[:, None] == numbers)[:, :, None, None], at_sphere_mm2[:, None], 0.0)
    blocks[np.diag_indices(len(numbers))] += at_look_mm2
    size = 3 * len(numbers)
    return LookedSpheres(
        numbers, looked.image_mm, looked.physical_mm, blocks.transpose(0, 2, 1, 3).reshape(size, size)
    )


def _looks_of(
    context: StepContext, scanned: ScannedSurface, looked: LookedPairs | None
) -> tuple[list[LocalizationPose], Array]:
    """Return the looks that showed the skin, then those at spheres, and the places looked at, robot frame."""
    planned = context.result(CheckedPaths).skin_looks
    looks = [planned[number] for number in scanned.looks_taken]
    places_mm = np.array([one.tool_pose.transform.translation_mm for one in looks])
    if looked is None:
        return looks, places_mm
    return [*looks, *looked.looks], np.vstack([places_mm, looked.physical_mm])


def _head_errors(context: StepContext, looks: list[LocalizationPose]) -> SharedErrors:
    """Return the errors of the stereo head's calibration: it measures alike in each look, turned with it."""
    size_mm = context.workcell.calibrations.stereo_head.stated_error_mm / np.sqrt(3.0)
    turns = np.array([one.tool_pose.transform.rotation_matrix for one in looks])
    return SharedErrors(STEREO_HEAD, size_mm * turns, np.zeros((3, 3)))


def _arm_at(
    context: StepContext,
    scanned: ScannedSurface,
    looked: LookedPairs | None,
    held: error_budget.HeldGuide,
    planned: PlannedTrajectory,
) -> Sources:
    """Return the errors of arm and stereo head at all looks and at a target."""
    looks, places_mm = _looks_of(context, scanned, looked)
    of_arm = error_budget.arm_errors(context, looks, places_mm, planned.id, held)
    return (*of_arm, _head_errors(context, looks))


def _learn_arm(
    context: StepContext,
    scanned: ScannedSurface,
    looked: LookedPairs | None,
    found: SurfaceRegistration,
    planned: Sequence[PlannedTrajectory],
) -> LearnedArm:
    """Return what skin and spheres show of the arm, with a correction for each target. Raises PRO-007."""
    corrections_mm, limits_mm = {}, {}
    for one in planned:
        held = error_budget.predict_held_guide(context, one, found.robot_from_ct, None)
        shift_mm, limit_mm = found.correct(_arm_at(context, scanned, looked, held, one))
        require_explained(one.id, float(np.linalg.norm(shift_mm)), limit_mm)
        corrections_mm[one.id], limits_mm[one.id] = vector3(shift_mm), limit_mm
    by_skin = LearnedArm(
        looks=len(scanned.looks_taken),
        fiducials=(),
        spheres_robot_mm=(),
        corrections_mm=corrections_mm,
        correction_limits_mm=limits_mm,
    )
    if looked is None:
        return by_skin
    numbers, rows = np.unique(looked.fiducials, return_index=True)
    places_mm = looked.physical_mm + found.arm_at_spheres_mm
    return by_skin.model_copy(
        update={
            "looks": by_skin.looks + len(looked.looks),
            "fiducials": tuple(numbers.tolist()),
            "spheres_robot_mm": tuple(map(vector3, places_mm[rows])),
        }
    )


def _residuals_by_sphere(looked: LookedPairs, found: SurfaceRegistration) -> dict[int, Vector3]:
    """Return what is left at each sphere of the CT, on average over its looks, beside the arm's errors."""
    left_mm, numbers = found.sphere_residuals_mm + found.arm_at_spheres_mm, np.array(looked.fiducials)
    return {int(one): vector3(left_mm[numbers == one].mean(axis=0)) for one in np.unique(numbers)}


def _predict(
    context: StepContext,
    scanned: ScannedSurface,
    looked: LookedPairs | None,
    found: SurfaceRegistration,
    planned: PlannedTrajectory,
) -> Prediction:
    """Predict the tip's error at a target: of the registration with the arm, and what is added there."""
    held = error_budget.predict_held_guide(context, planned, found.robot_from_ct, None)
    arm = _arm_at(context, scanned, looked, held, planned)
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
    slip = tell_unseen_slip(len(context.result(SurfaceStart).pairs))
    total = replace(by_surface, covariances_mm2=by_surface.covariances_mm2 + sum(added_mm2.values()))
    shares_mm2 = found.split(planned.target_mm, arm) | {
        name: float(np.trace(one)) for name, one in added_mm2.items()
    }
    return Prediction(
        target=planned.id,
        rms_mm=total.rms_mm,
        limit_mm=total.limit_mm(DEFAULT_CONFIDENCE),
        confidence=DEFAULT_CONFIDENCE,
        formula="mixture over the misfits of the skin",
        excluded="; ".join(filter(None, (NOT_PREDICTED_OF_TOOL, "a patient who moved during the CT", slip))),
        budget=tuple(ErrorShare(source=name, rms_mm=mean_mm2**0.5) for name, mean_mm2 in shares_mm2.items()),
    )


def _accept(
    context: StepContext,
    plan: CheckedPlan,
    found: SurfaceRegistration,
    predictions: tuple[Prediction, ...],
    left_out: Mapping[str, str],
    learned: LearnedArm,
    residuals: Picture,
    *,
    side_proven: bool,
) -> None:
    """Have the operator accept the registration for each target. Raises PRO-002."""
    if not side_proven:
        context.find(LEFT_AND_RIGHT)
        context.require_yes(
            Question(
                Topic.REGISTRATION,
                SIDES_COMPARED,
                LEFT_AND_RIGHT,
                trajectory=predictions[0].target,
            )
        )
    showing = f" with {'lines or spheres' if found.spheres else 'lines'}"
    for predicted in predictions:
        if predicted.target in left_out:
            continue
        against = against_margins(plan, predictions, predicted)
        context.require_yes(
            Question(
                Topic.REGISTRATION,
                f"Accept the registration on {format_fit(found)} for {predicted.target}?",
                f"predicted target error {predicted.rms_mm:.2f} mm rms against a margin of "
                f"{against[0].margin_mm:g} mm, {predicted.limit_mm:.2f} mm at {predicted.confidence:.0%}"
                f"{against[0].remark}\nthe skin differs from the CT by {found.misfit_mm:.2f} mm over "
                f"{found.misfit_length_mm:.0f} mm; "
                f"{tell_coverage(found.coverage, 'the registration')}"
                + "".join(
                    f"\nsphere {one.number + 1} is {one.away_mm:.2f} mm from where everything else has it, "
                    f"about {one.rms_mm:.2f} mm are expected"
                    for one in found.spheres
                )
                + f"\nnot included: {predicted.excluded}"
                + f"\n{tell_learned(learned, predicted.target, showing)}",
                trajectory=predicted.target,
                evidence=(error_budget.budget_table(predicted), *_tabulate_changed(found)),
                predicted=against,
                pictures=(*picture_of(context, predicted.target), residuals),
            )
        )


def _tabulate_changed(found: SurfaceRegistration) -> tuple[Evidence, ...]:
    """Tabulate the skin that has probably moved."""
    if found.changed is None:
        return ()
    row = (", ".join(found.changed.parts), f"{found.changed.shift_mm:.2f}")
    head = ("skin", "moved outwards, mm")
    return (Evidence(title="Skin that has probably moved since the CT", head=head, rows=(row,)),)


def format_fit(found: SurfaceRegistration) -> str:
    """Say what was registered: the skin, with spheres if there are any."""
    return "the skin" + (f" and {format_count(len(found.spheres), 'sphere')}" if found.spheres else "")


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
