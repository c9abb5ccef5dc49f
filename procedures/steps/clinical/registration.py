"""Registration of CT to robot, with a predicted error for every target it applies to.

The residual of the fit is never shown as accuracy; the operator accepts the predicted target error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, Scope, StepSpec
from procedures.journal.errors import GateFailed
from procedures.journal.results import FramedPose
from procedures.operator.margin import MarginVerdict
from procedures.operator.question import Picture, PredictedError, Question, Topic
from procedures.planning.guide import (
    direction_covariance_mm2,
    instrument_covariance_mm2,
)
from procedures.planning.plan_model import PlannedTrajectory
from procedures.planning.target_error import fusion_errors
from procedures.registration import Registration, RoomPoint, TwoWayTable, verify_two_way
from procedures.registration.arm_hypotheses import LARGEST_SHARE
from procedures.registration.arm_learning import LearnedTarget
from procedures.registration.error_sources import (
    CT,
    DIRECTION,
    GUIDE_TIP,
    INSTRUMENT,
    SEATING,
    STEREO,
    STEREO_HEAD,
)
from procedures.registration.error_theory import DEFAULT_CONFIDENCE
from procedures.registration.points import FEWEST_PAIRS
from procedures.registration.target_prediction import IndependentErrors
from procedures.steps.branches import BEYOND_MARGIN, LEAVE_OUT, MOVED_SPHERE
from procedures.steps.clinical import error_budget
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.followed_move import MeasuredMove, followed_move
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.plan_check import CheckedPlan, plan_picture
from procedures.steps.clinical.results import (
    NOT_PREDICTED,
    ErrorShare,
    LearnedArm,
    LeftOutSphere,
    Prediction,
    RegisteredRobot,
    Relocalization,
)
from procedures.steps.clinical.sphere_pairs import Pairs, pairs_of
from procedures.steps.clinical.unnoticed import expect_unnoticed
from procedures.workcell import MountedTool
from ronna_hw.frames import Frame
from ronna_hw.text import format_against_limit, format_count, format_distinct


def run(context: StepContext) -> Outcome[RegisteredRobot]:
    """Fit with all known covariances, gate the residual, and require acceptance of the predicted error.

    A repeat with the guide mounted means that the head has moved: the tracker measures the move.
    """
    plan = context.result(CheckedPlan)
    pairs, left_out_spheres = _select_agreeing_pairs(context, pairs_of(context))
    fit = pairs.fit
    fit.require_rotation()  # the residuals were judged before, with the errors that points share
    trajectories = [plan.trajectory(name) for name in context.served_trajectories]
    robot_from_ct, move = fit.between(Frame.ROBOT, Frame.CT), None
    if context.workcell.master.tool is MountedTool.UNKNOWN:  # after a fault of the arm
        context.workcell.master.mount.identify()
    if context.workcell.master.tool is MountedTool.GUIDE:
        move = followed_move(context, robot_from_ct.apply([one.target_mm for one in trajectories]))
    predicted_tips = [predict_tip_error(context, pairs, one, move) for one in trajectories]
    predictions = tuple(one for one, _ in predicted_tips)
    corrections = {one.target: correction for one, correction in predicted_tips}
    require_explained_corrections(corrections)
    if move is not None:
        robot_from_ct = move.record.robot_from_robot.transform @ robot_from_ct
    left_out = exclude_beyond_margin(context, plan, predictions)
    methods = context.clinical.methods.describe()
    learned = pairs.learned(corrections)
    two_way = _compare_both_ways(context, fit, pairs)
    for predicted in predictions:
        if predicted.target in left_out:
            continue
        against = against_margins(plan, predictions, predicted)
        if learned is not None:  # else one look at each sphere, whose residual shows a move at once
            _confirm_unmoved_spheres(context, predicted, against[0].margin_mm)
        question = Question(
            Topic.REGISTRATION,
            f"Accept the registration for {predicted.target}?",
            f"predicted target error {predicted.rms_mm:.2f} mm rms against a margin of "
            f"{against[0].margin_mm:g} mm, {predicted.limit_mm:.2f} mm at {predicted.confidence:.0%}"
            f"{against[0].remark}\nnot included: {predicted.excluded}"
            + "".join(
                f"\n{said}"
                for said in (tell_learned(learned, predicted.target), predicted.assumed, methods)
                if said
            ),
            trajectory=predicted.target,
            evidence=(error_budget.budget_table(predicted), error_budget.two_way_table(two_way)),
            predicted=against,
            pictures=picture_of(context, predicted.target),
        )
        context.require_yes(question)
    worst = max(predictions, key=lambda one: one.rms_mm)
    return Outcome(
        RegisteredRobot(
            robot_from_ct=FramedPose.of(robot_from_ct),
            pairs=fit.pairs,
            fre_mm=float(fit.fre_mm),
            residuals_mm=fit.residuals_mm.tolist(),
            leave_one_out_mm=tuple(fit.leave_one_out_mm),
            covariances_mm2=None if fit.covariance_mm2 is None else fit.covariance_mm2.tolist(),
            predictions=predictions,
            two_way=two_way,
            left_out_spheres=left_out_spheres,
            followed=None if move is None else move.record,
            learned=learned,
            left_out=left_out,
        ),
        summary=f"predicted target error {worst.rms_mm:.2f} mm rms"
        + (f"; {worst.assumed}" if worst.assumed else "")
        + "".join(f"; without sphere {one.fiducial + 1}" for one in left_out_spheres)
        + "".join(f"; without {name}" for name in left_out),
    )


def tell_learned(learned: LearnedArm | None, target: str, showing: str = "") -> str:
    """Return the correction that a learned arm is given for a target, in words; empty without one.

    `showing` says which looks count, where that is not all of them.
    """
    if learned is None:
        return ""
    sent_mm, most_mm = math.hypot(*learned.corrections_mm[target]), learned.correction_limits_mm[target]
    size = (
        ""
        if learned.share is None
        else f": {learned.share:.0%} of their stated size, at most {LARGEST_SHARE:.0%}"
    )
    looks = format_count(learned.looks, "look")
    return (
        f"by {looks}{showing} the arm's errors are estimated as well{size}; for them it is sent "
        f"{sent_mm:.2f} mm beside the target's place, at most {most_mm:.2f} mm"
    )


def require_explained_corrections(corrections: Mapping[str, LearnedTarget]) -> None:
    """Require that no target's correction is longer than the arm's errors explain. Raises PRO-007."""
    for target, one in corrections.items():
        require_explained(target, float(np.linalg.norm(one.shift_mm)), one.limit_mm)


def require_explained(target: str, length_mm: float, limit_mm: float) -> None:
    """Raise PRO-007 if a correction is longer than the arm's errors explain."""
    if length_mm > limit_mm:
        got, limit = format_distinct(length_mm, limit_mm, 2)
        raise GateFailed(
            f"the correction learned for {target} is longer than errors of this arm explain",
            limit=f"{limit} mm",
            got=f"{got} mm",
            action="Check whether a sphere or the head has moved, and whose calibrations arm, head and "
            "guide have, then localize again.",
        )


def _confirm_unmoved_spheres(context: StepContext, predicted: Prediction, margin_mm: float) -> None:
    """Have the operator confirm that no sphere moved, where one could unnoticed by more than the margin.

    Raises PRO-002.
    """
    if predicted.moved_sphere_mm is None or predicted.moved_sphere_mm <= margin_mm:
        return
    text = (
        f"one moved sphere could put {predicted.target} off by {predicted.moved_sphere_mm:.2f} mm before "
        f"the fit shows it, beyond the margin of {margin_mm:g} mm"
    )
    context.find(text, [predicted.target])
    context.require_yes(
        Question(
            Topic.REGISTRATION,
            f"Have you checked that every sphere is where it was in the CT, for {predicted.target}?",
            text,
            trajectory=predicted.target,
        )
    )


def _select_agreeing_pairs(context: StepContext, pairs: Pairs) -> tuple[Pairs, tuple[LeftOutSphere, ...]]:
    """Return the pairs, without a single disagreeing sphere if the operator agrees to leave it out.

    Raises PRO-007 if no sphere explains it, or more than one would.
    """
    failed = next((one for one in pairs.checks if not one.passed), None)
    if failed is None:
        return pairs, ()
    moved = pairs.find_moved()
    names = " and ".join(context.served_trajectories)
    got, limit = failed.show(failed.decimals)
    refusal = GateFailed(
        f"{failed.failure} at {names}",
        limit=limit,
        got=got,
        action=_advise_on_moved(
            [[pairs.fiducials[one] for one in group] for group in moved], len(pairs.fiducials)
        ),
    )
    if len(moved) != 1 or len(moved[0]) != 1:
        raise refusal
    ((place,),) = moved
    fiducial, rest = pairs.fiducials[place], pairs.without(place)
    without = next(one for one in rest.checks if one.quantity == failed.quantity)
    shown, most = failed.show(min(failed.decimals, 2))
    question = MOVED_SPHERE.question(
        f"Sphere {fiducial + 1} disagrees with all others at {names}: it has moved, or is the wrong one.",
        f"{failed.quantity} {shown} with it, {without.show(min(failed.decimals, 2))[0]} with the other "
        f"{len(rest.fiducials)}, limit {most}",
        context.key.trajectory,
    )
    if context.choose(question) != LEAVE_OUT:
        raise refusal
    return rest, (LeftOutSphere(fiducial=fiducial, reason=refusal.summary),)


def exclude_beyond_margin(
    context: StepContext, plan: CheckedPlan, predictions: tuple[Prediction, ...]
) -> dict[str, str]:
    """Return trajectories to leave out, with reasons. Raises PRO-007 unless agreed and others remain."""
    left_out: dict[str, str] = {}
    for predicted in predictions:
        trajectory = plan.trajectory(predicted.target)
        if predicted.against(trajectory.margin_mm).verdict is not MarginVerdict.PREDICTED_BEYOND:
            continue
        refusal = GateFailed(
            f"the predicted error at {trajectory.id} exceeds the plan's margin (margin_mm in plan.toml)",
            limit=f"{trajectory.margin_mm:g} mm",
            got=f"{format_against_limit(predicted.rms_mm, trajectory.margin_mm, 2)} mm",
            action="Measure the head again, by its spheres or its skin. A plan with another margin needs a "
            "new run.",
        )
        others = [name for name in context.remaining if name not in (trajectory.id, *left_out)]
        if not others:
            raise refusal
        question = BEYOND_MARGIN.question(
            refusal.what, f"{refusal.summary}; {', '.join(others)} would remain without it", trajectory.id
        )
        shown = replace(
            question,
            predicted=against_margins(plan, predictions, predicted),
            pictures=picture_of(context, trajectory.id),
        )
        if context.choose(shown) != LEAVE_OUT:
            raise refusal
        left_out[trajectory.id] = refusal.summary
    return left_out


def against_margins(
    plan: CheckedPlan, predictions: tuple[Prediction, ...], first: Prediction
) -> tuple[PredictedError, ...]:
    """Set the predictions of a registration against the plan's margins, the one that is decided on first."""
    return tuple(
        one.against(plan.trajectory(one.target).margin_mm)
        for one in sorted(predictions, key=lambda one: one is not first)
    )


def picture_of(context: StepContext, trajectory: str) -> tuple[Picture, ...]:
    """Return the cuts of a trajectory, if the plan's check has kept them."""
    found = context.find_picture(
        plan_picture(trajectory), [plan_picture(one) for one in context.trajectories]
    )
    return () if found is None else (found.model_copy(update={"trajectory": trajectory}),)


def predict_tip_error(
    context: StepContext, pairs: Pairs, planned: PlannedTrajectory, move: MeasuredMove | None = None
) -> tuple[Prediction, LearnedTarget]:
    """Predict the tip's error at a target from the errors of spheres, arm, guide, instrument and fusion.

    Also returns how far, in the robot frame now, its commanded place is off that by the fit and a followed
    `move`, for what was learned of the arm.

    Of errors common to spheres and target, only the remainder counts. A followed move adds its own error.
    If the spheres disagree by more than all of it states, the limit is widened.
    """
    target, fit, looked = planned.id, pairs.fit, pairs.looked
    tip_mm = np.asarray(fit.transform.apply(np.asarray(planned.target_mm, dtype=float)), dtype=float)
    moved = None if move is None else move.record.robot_from_robot.transform
    robot_from_ct = fit.between(Frame.ROBOT, Frame.CT)
    held = error_budget.predict_held_guide(context, planned, robot_from_ct, moved)
    plan, bore = context.result(CheckedPlan).plan, context.workcell.tools.guide.bore
    calibrations = context.workcell.calibrations
    at_target_mm = {
        STEREO_HEAD: calibrations.stereo_head.stated_error_mm,
        GUIDE_TIP: calibrations.tool_tip.stated_error_mm,
        **({} if move is None else move.shares_mm(tip_mm)),
    }
    stated_rad = calibrations.tool_tip.stated_direction_error_rad
    nothing = np.zeros_like(looked.ct_mm2)
    unnoticed = expect_unnoticed(context, tip_mm, held.joints_rad, held.sides)
    turn, rotation, localized = (
        held.rotation,
        robot_from_ct.rotation_matrix,
        context.result(LocalizedFiducials),
    )
    sources = (
        IndependentErrors(CT, looked.ct_mm2, np.zeros((3, 3))),
        held.turn_with_head(localized.scan_errors(looked.image_mm, planned.target_mm, rotation)),
        IndependentErrors(SEATING, looked.seating_mm2, np.zeros((3, 3))),
        *map(held.turn_with_head, localized.place_errors(planned.target_mm, rotation, len(looked.ct_mm2))),
        *fusion_errors(planned.fusion_error_mm, len(looked.ct_mm2)),
        IndependentErrors(STEREO, looked.stereo_mm2, np.zeros((3, 3))),
        *error_budget.arm_errors(context, looked.looks, looked.physical_mm, target, held),
        IndependentErrors(INSTRUMENT, nothing, instrument_covariance_mm2(plan, planned, bore, turn)),
        IndependentErrors(
            DIRECTION, nothing, direction_covariance_mm2(plan, planned, bore, stated_rad, turn)
        ),
        *(IndependentErrors(name, nothing, np.eye(3) * rms**2 / 3.0) for name, rms in at_target_mm.items()),
        *(IndependentErrors(name, nothing, part, rare=True) for name, part in unnoticed.items()),
    )
    by_head = [held.turn_errors_back(one) for one in sources]
    worst, learned = pairs.find_unnoticed(tip_mm, by_head), pairs.predict(tip_mm, by_head)
    predicted = learned.prediction
    prediction = Prediction(
        target=target,
        rms_mm=predicted.rms_mm,
        limit_mm=predicted.limit_mm(DEFAULT_CONFIDENCE),
        confidence=DEFAULT_CONFIDENCE,
        widening=predicted.widening,
        formula="covariance propagation, joint by joint",
        excluded=f"{NOT_PREDICTED}; one sphere moved since {localized.since}: {worst.at_target_mm:.2f} mm "
        f"(sphere {pairs.fiducials[worst.index] + 1}, by {worst.displaced_mm:.1f} mm) until the fit shows",
        moved_sphere_mm=worst.at_target_mm,
        assumed=localized.assumed_error,
        budget=tuple(ErrorShare(source=name, rms_mm=rms) for name, rms in predicted.budget_mm.items()),
    )
    return prediction, replace(learned, shift_mm=held.turn_correction(learned.shift_mm))


def _advise_on_moved(moved: list[list[int]], spheres: int) -> str:
    """Return advice on the spheres (CT indices), alone or two alike, that could explain the disagreement."""
    if spheres <= FEWEST_PAIRS:
        return "With three spheres it cannot be told which one has moved: check all, then localize again."
    if not moved:
        return "More than one sphere has moved, or the error budget is wrong; localize again."
    named = [" with ".join(str(one + 1) for one in group) for group in moved]
    if len(named) > 1:
        which = f"{', '.join(named[:-1])} or {named[-1]}"
        return f"One of these has moved: sphere {which}. Check them, then localize again."
    if len(moved[0]) > 1:
        return f"Sphere {named[0]} has moved. Check both, then localize again."
    return f"Without sphere {named[0]} the others agree: it has moved. Localize again or leave it out."


def _compare_both_ways(context: StepContext, fit: Registration, pairs: Pairs) -> TwoWayTable:
    """Compare every CT sphere with the measurements of tracker and stereo head, and the reverse."""
    localization = context.result(LocalizedFiducials)
    correspondence = context.result(Correspondence)
    return verify_two_way(
        localization.centres_mm,
        context.result(GlobalLocalization).points_mm,
        correspondence.pairs,
        correspondence.robot_from_ct.transform.rigid,
        fine=fit,
        stereo=[
            RoomPoint(index, point)
            for index, point in zip(pairs.fiducials, fit.physical_mm.tolist(), strict=True)
        ],
        ct_disagreement_mm=localization.disagreement_mm,
    )


STEP = StepSpec(
    RegisteredRobot,
    "Register the CT to the robot",
    Phase.OPERATION,
    run,
    asks=(Topic.REGISTRATION,),
    scope=Scope.LOCALIZATION,
    reads=(Relocalization, Correspondence, LocalizedFiducials, GlobalLocalization, CheckedPlan, CheckedPaths),
    preconditions=lambda context: (
        context.workcell.master.place.hold_reasons
    ),  # a mounted guide looks from home
)
